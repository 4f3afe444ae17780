"""A clock for tests: what they say of time does not depend on the machine's speed."""

from __future__ import annotations


class Clock:
    """Stands still, or goes on by as much each time that somebody looks at it.

    In place of ``time.perf_counter``. Limits in such tests are long: what native code
    is given to watch by itself is never used up by the machine.

    Attributes:
        now: What it shows [s].
        tick: By how much it goes on when it is looked at [s].
    """

    def __init__(self, tick: float = 0.0) -> None:
        self.now, self.tick = 1e5, tick

    def __call__(self) -> float:
        """What it shows [s]."""
        self.now += self.tick
        return self.now

    def advance(self, seconds: float) -> None:
        """Let time go by."""
        self.now += seconds
