"""Planning time, progress and the callback; and what has been found at any moment."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tominpmp.bounds import LowerBound, lower_bound
from tominpmp.options import Options
from tominpmp.problem import Problem
from tominpmp.solvers.iterate import Iterate
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import Deadline, Stop
from tominpmp.transcription.base import Program

# Of what a candidate has found so many motions are kept, should it be cut short.
KEPT = 4
# Time that is left for the replay of a motion, as shares of the limit: at least, and at
# most; and how many times what the last replay took.
RESERVE, MOST_RESERVE, REPLAYS = 0.03, 0.25, 1.5
# The same while there is no motion, and nobody knows what a replay takes.
FIRST_RESERVE = 0.06
# What a step may take beyond the limit, and what the end may: shares of it, and [s].
STEP_SHARE, STEP_SECONDS = 0.02, 0.08
END_SHARE, END_SECONDS = 0.08, 0.15
# Time for the replay of the best motion once planning was interrupted [s].
SAVING = 3.0


Judge = Callable[[IterationRecord], Status | None]


class Kept(NamedTuple):
    """A motion on the way.

    Attributes:
        program: Its program.
        iterate: The motion.
        feasible: Whether it keeps all constraints of the program.
    """

    program: Program
    iterate: Iterate
    feasible: bool


class PlanState:
    """Time limit, callback and interruption of a planning, as a callback of solvers.

    It raises :class:`~tominpmp.stopping.Stop` when planning is to end, and has kept the
    best that the present candidate has found by then.

    Args:
        options: Time limit, callback, and what is enough.
        first: Number of the first start.
        asked: Tells whether another process asks to stop.

    Attributes:
        start: Number of the initial guess that is worked on.
        best: Duration of the best motion so far [s]; infinite if there is none.
        links_touched: Whether links of an arm that is alone have touched each other in
            the present candidate.
        deadline: When to stop.
        records: One record an iteration of the present candidate.
        kept: Motions of the present candidate, the newest last.
        begun: What the present candidate began with.
        dropped: Whether the judge of the present candidate has ended it for good.
        cut_short: How the present candidate was stopped; None if it was not.
        failures: What went wrong with candidates that have led to nothing.
    """

    def __init__(
        self,
        options: Options,
        *,
        first: int = 0,
        asked: Callable[[], bool] | None = None,
    ) -> None:
        self.start = first
        self.best = np.inf
        self.links_touched = False
        self.deadline = Deadline(asked)
        self.records: list[IterationRecord] = []
        self.kept: list[Kept] = []
        self.begun: Kept | None = None
        self.dropped = False
        self.cut_short: Status | None = None
        self.failures: list[Exception] = []
        self._judges: list[Judge] = []
        self._bounds: list[tuple[Problem, LowerBound]] = []
        self._starts = first
        self._begin = time.perf_counter()
        self._limit = options.time_limit
        self._until = self._limit
        self._replay = 0.0
        self._callback = options.callback
        self._feasibility = options.feasibility
        # A violation that is good enough to stop, where any motion will do.
        self._enough = options.feasibility if options.objective == "feasible" else -1.0
        self._set_deadline()

    @property
    def seconds(self) -> float:
        """Time since planning began [s]."""
        return time.perf_counter() - self._begin

    def begin(self, count: int = 1) -> int:
        """Begin with one or several new guesses; returns the number of the first."""
        self.start = self._starts
        self._starts += count
        self.links_touched = False
        self.records, self.kept, self.begun = [], [], None
        self.dropped, self.cut_short = False, None
        self._set_deadline()
        return self.start

    def share(self, parts: int) -> None:
        """Allow the next start one of so many parts of the time that is left.

        All of it once there is a motion: what comes after it can only be better.
        """
        self._until = self._limit
        if self.best == np.inf:
            self._until = self.seconds + (self._limit - self.seconds) / max(parts, 1)
        self._set_deadline()

    def ended(self, status: Status) -> bool:
        """Whether planning ends when a start has ended with a status."""
        used_up = self._until == self._limit or self.over
        return status is Status.INTERRUPTED or (status is Status.TIME_LIMIT and used_up)

    @property
    def ends(self) -> float:
        """When the planning time is used up, on the clock of perf_counter [s]."""
        return self._begin + self._limit

    @property
    def left(self) -> float:
        """Planning time that is left [s], a little at least."""
        return max(self._until - self.seconds, 1e-3)

    @property
    def over(self) -> bool:
        """Whether the planning time is used up."""
        return self.seconds >= self._limit

    def lower_bound(self, problem: Problem) -> LowerBound:
        """Time that no motion can beat, found once for each goal and start.

        Raises:
            Stop: If it is time to stop.
        """
        for known, bound in self._bounds:
            same = np.array_equal(known.q_start, problem.q_start)
            if same and known.goal is problem.goal:
                return bound
        self._bounds.append((problem, lower_bound(problem)))
        return self._bounds[-1][1]

    # -- what was found ----------------------------------------------------------------

    def keep(self, program: Program, iterate: Iterate) -> None:
        """Keep a motion of the present candidate, should it be cut short."""
        new = Kept(program, iterate, iterate.violation <= self._feasibility)
        self.begun = self.begun or new
        if self.kept and self.kept[-1].program is program:
            if self.kept[-1].feasible and not new.feasible:
                return
            self.kept[-1] = new
        else:
            # What it began with stays: it is told of.
            self.kept = [*self.kept[:1], *self.kept[1:][-KEPT:], new]
        self._set_deadline()

    def replayed(self, seconds: float) -> None:
        """Learn how long the replay of a motion takes [s]."""
        self._replay = max(self._replay, seconds)

    def stopped(self, cause: BaseException) -> Status:
        """How planning ends that was stopped by an exception."""
        self.cut_short = Status.TIME_LIMIT
        if not isinstance(cause, Stop) or cause.requested:
            self.deadline.requested = True
            self.cut_short = Status.INTERRUPTED
        return self.cut_short

    @contextmanager
    def saving(self) -> Iterator[None]:
        """Go on for a little, to save what was found although it is time to stop."""
        now = time.perf_counter()
        until = now + SAVING
        if not self.deadline.requested:
            until = self._end(self._limit)
        with self.deadline.grace(until):
            yield

    @contextmanager
    def judged(self, judge: Judge | None) -> Iterator[None]:
        """Let somebody end iterations that promise nothing, for a while.

        Args:
            judge: Sees every record after it was shown, and after those who judge it
                already; a status ends the iteration. None for nobody else.
        """
        if judge is None:
            yield
            return
        self._judges.append(judge)
        try:
            yield
        finally:
            self._judges.pop()

    def extend(self, limit: float) -> None:
        """Set another limit for what is still to be done, from the beginning on [s]."""
        self._limit = self._until = limit
        self.records, self.kept = [], []
        self._set_deadline()

    def _end(self, limit: float) -> float:
        return self._begin + (1.0 + END_SHARE) * limit + END_SECONDS

    def _reserve(self) -> float:
        """Time to be left for the replay of what was found [s]."""
        limit = self._limit
        if limit == np.inf:
            return 0.0
        if not any(item.feasible for item in self.kept):
            # If there is nothing at all, what the candidate began with is slowed down.
            nothing = self.best == np.inf and self.begun is not None
            return FIRST_RESERVE * limit if nothing else 0.0
        return min(max(RESERVE * limit, REPLAYS * self._replay), MOST_RESERVE * limit)

    def _set_deadline(self) -> None:
        more = STEP_SHARE * self._limit + STEP_SECONDS - self._reserve()
        self.deadline.end = self._begin + self._until + more
        self.deadline.last = self._end(self._limit)

    # -- the callback ------------------------------------------------------------------

    def replay(self, history: tuple[IterationRecord, ...]) -> None:
        """Show records that were made in another process to the callback.

        Raises:
            Stop: If the callback says so.
        """
        for record in history:
            self._show(record)

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record of the present candidate; a status ends the iteration.

        Raises:
            Stop: If planning is to end.
        """
        self.records.append(replace(record, iteration=len(self.records)))
        status = self.see(record)
        if status is None and self._judges:
            found = (judge(record) for judge in self._judges)
            status = next((status for status in found if status is not None), None)
            # One that has had its iterations still gets the rows that it lacks.
            self.dropped = status is Status.STALLED
        return status

    def see(self, record: IterationRecord) -> Status | None:
        """See a record of something on the side.

        Raises:
            Stop: If planning is to end.
        """
        self._show(record)
        if record.violation <= self._enough:
            return Status.FEASIBLE
        if self.seconds >= self._until - self._reserve():
            raise Stop(requested=False)
        return None

    def _show(self, record: IterationRecord) -> None:
        record = replace(record, start=self.start, seconds=self.seconds)
        if self._callback is not None and self._callback(record):
            self.deadline.requested = self.deadline.heeded = True
            raise Stop(requested=True)
