"""What tells a refinement when to stop."""

from __future__ import annotations

import time
from typing import Protocol

from tominpmp.solution import IterationRecord, Status


class Monitor(Protocol):
    """Time limit and callback; see :class:`~tominpmp.attempts.Watch`.

    Attributes:
        start: Number of the initial guess that is worked on.
    """

    start: int

    @property
    def over(self) -> bool:
        """Whether the planning time is used up."""

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record; a status ends the iteration."""


class Clock:
    """A monitor that also ends a refinement after some time of its own.

    That is time of the processor: what comes out shall not depend on what else it does.

    Args:
        watch: Time limit and callback of the planning.
        patience: Time that a refinement has, unless the planning time ends before [s].

    Attributes:
        stopped: How the callback or the time limit ended the planning, if they did.
    """

    def __init__(self, watch: Monitor, patience: float) -> None:
        self.stopped: Status | None = None
        self._watch = watch
        self._end = time.process_time() + patience

    @property
    def first(self) -> bool:
        """Whether this is the first initial guess."""
        return self._watch.start == 0

    @property
    def over(self) -> bool:
        """Whether to stop."""
        if self.stopped is None and self._watch.over:
            self.stopped = Status.TIME_LIMIT
        return self.stopped is not None or time.process_time() > self._end

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record; a status ends the iteration."""
        status = self._watch(record)
        if status is not None:
            self.stopped = status
            return status
        return Status.TIME_LIMIT if self.over else None
