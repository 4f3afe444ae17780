"""A clock for tests, whose times do not depend on the speed of the machine."""

from __future__ import annotations


class Clock:
    """Stands still, or advances by a tick at each reading.

    It replaces ``time.perf_counter``. Time limits in tests with this clock are long, as
    native code watches its limit by the clock of the machine, and must not reach it.

    Attributes:
        now: Time that the clock shows [s].
        tick: Advance at each reading [s].
    """

    def __init__(self, tick: float = 0.0) -> None:
        self.now, self.tick = 1e5, tick

    def __call__(self) -> float:
        """Advance by the tick, and return the time [s]."""
        self.now += self.tick
        return self.now

    def advance(self, seconds: float) -> None:
        """Advance by a time [s]."""
        self.now += seconds
