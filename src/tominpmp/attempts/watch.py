"""Planning time, progress and the callback, watched while a problem is solved."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from tominpmp.options import Options
from tominpmp.solution import IterationRecord, Status


class Watch:
    """Time limit, callback and interruption of a planning, as a monitor of solvers.

    Attributes:
        start: Number of the initial guess that is worked on.
        best: Duration of the best motion so far [s]; infinite if there is none.
        links_touched: Whether links of an arm that is alone have touched each other.
    """

    def __init__(self, options: Options) -> None:
        self.start = 0
        self.best = np.inf
        self.links_touched = False
        self._starts = 0
        self._begin = time.perf_counter()
        self._limit = options.max_planning_time
        self._until = self._limit
        self._callback = options.callback
        # A violation that is good enough to stop, where any motion will do.
        self._enough = options.feasibility if options.objective == "feasible" else -1.0

    @property
    def seconds(self) -> float:
        """Time since planning began [s]."""
        return time.perf_counter() - self._begin

    def begin(self, count: int = 1) -> int:
        """Begin with one or several new guesses; returns the number of the first."""
        self.start = self._starts
        self._starts += count
        return self.start

    def share(self, parts: int) -> None:
        """Allow the next start one of so many parts of the time that is left.

        All of it once there is a motion: what comes after it can only be better.
        """
        self._until = self._limit
        if self._limit is not None and self.best == np.inf:
            self._until = self.seconds + (self._limit - self.seconds) / max(parts, 1)

    def ended(self, status: Status) -> bool:
        """Whether planning ends when a start has ended with a status."""
        used_up = self._until is self._limit or self.over
        return status is Status.INTERRUPTED or (status is Status.TIME_LIMIT and used_up)

    @property
    def deadline(self) -> float | None:
        """When the planning time is used up, on the clock of perf_counter [s]."""
        return None if self._limit is None else self._begin + self._limit

    @property
    def left(self) -> float | None:
        """Planning time that is left [s], a little at least; None without a limit."""
        return None if self._until is None else max(self._until - self.seconds, 1e-3)

    @property
    def over(self) -> bool:
        """Whether the planning time is used up."""
        return self._limit is not None and self.seconds >= self._limit

    def replay(self, history: tuple[IterationRecord, ...]) -> Status | None:
        """Show records that were made in another process to the callback."""
        for record in history:
            if self._callback is not None:
                record = replace(record, start=self.start, seconds=self.seconds)
                if self._callback(record):
                    return Status.INTERRUPTED
        return None

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record; a status ends the iteration."""
        record = replace(record, start=self.start, seconds=self.seconds)
        if self._callback is not None and self._callback(record):
            return Status.INTERRUPTED
        if record.violation <= self._enough:
            return Status.FEASIBLE
        late = self._until is not None and self.seconds >= self._until
        return Status.TIME_LIMIT if late else None
