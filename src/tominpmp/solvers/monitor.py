"""What tells a refinement when to stop."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from tominpmp.solvers.iterate import Iterate
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import check
from tominpmp.transcription.base import Program

# Evaluations of the dynamics for one start at most: some seconds for a small arm.
EVALUATIONS = 300_000


class Monitor(Protocol):
    """Time limit and callback; see :class:`~tominpmp.planner.watch.Watch`.

    Attributes:
        start: Number of the initial guess that is worked on.
    """

    start: int

    @property
    def over(self) -> bool:
        """Whether the planning time is used up."""

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record of the motion; a status ends the iteration."""

    def see(self, record: IterationRecord) -> Status | None:
        """See a record of something on the side; a status ends the iteration."""

    def keep(self, program: Program, iterate: Iterate) -> None:
        """Keep a motion, should the rest be cut short."""


class Clock:
    """A monitor that also ends a refinement after some time of its own.

    That is time of the processor: what comes out shall not depend on what else it does.

    Args:
        watch: Time limit and callback of the planning.
        patience: Time that a refinement has, unless planning ends before [s].
    """

    def __init__(self, watch: Monitor, patience: float) -> None:
        self._watch = watch
        self._end = time.process_time() + patience

    @property
    def first(self) -> bool:
        """Whether this is the first initial guess."""
        return self._watch.start == 0

    @property
    def over(self) -> bool:
        """Whether to stop."""
        check()
        return time.process_time() > self._end

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record; a status ends the iteration."""
        status = self._watch.see(record)
        return status or (Status.TIME_LIMIT if self.over else None)

    def keep(self, program: Program, iterate: Iterate) -> None:
        """Keep a motion, should the rest be cut short."""
        self._watch.keep(program, iterate)


class Budget:
    """How much may still be spent.

    Args:
        evaluations: Number of states at which the dynamics may be evaluated.
        stop: Tells whether to stop at once.
    """

    def __init__(
        self, evaluations: int = EVALUATIONS, stop: Callable[[], bool] = lambda: False
    ) -> None:
        self.left = self._first = evaluations
        self._stop = stop

    @property
    def spent(self) -> bool:
        """Whether there is nothing left."""
        return self.left <= 0 or self._stop()

    def part(self, evaluations: int) -> Budget:
        """A part of it, to be taken off when it is used."""
        return Budget(min(evaluations, self.left), self._stop)

    def take(self, part: Budget) -> None:
        """Take off what was used of a part."""
        self.left -= part._first - part.left

    def pay(self, evaluations: int) -> None:
        """Pay for evaluations.

        Raises:
            StopIteration: If there is nothing left.
        """
        self.left -= evaluations
        if self.spent:
            raise StopIteration
