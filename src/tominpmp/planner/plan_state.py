"""The state of a plan: its time, its candidates, and the motion it is working on."""

from __future__ import annotations

import operator
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from tominpmp.bounds.lower_bound import lower_bound
from tominpmp.bounds.result import LowerBound
from tominpmp.goals.base import Goal
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate, Fallback, Kept, best_of
from tominpmp.problem.problem import Problem
from tominpmp.solvers.iterate import Iterate
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import Deadline, Stop
from tominpmp.transcription.base import Solved

# Iterates kept per candidate, one a program, besides its newest.
KEPT = 4
# Time reserved for the last replay: REPLAYS times the longest replay so far, within
# these shares of the limit; before the first, END_SECONDS stand for it.
RESERVE, MOST_RESERVE, REPLAYS = 0.03, 0.25, 1.5
# The same while there is no incumbent, and no replay has been timed.
FIRST_RESERVE = 0.06
# Overrun allowed to one step, and to the conclusion: share of the limit, and [s].
STEP_SHARE, STEP_SECONDS = 0.02, 0.08
END_SHARE, END_SECONDS = 0.08, 0.15
# Time of grace in all for the best motion once planning was interrupted [s].
SAVING = 3.0


class PlanState:
    """Time, callback and candidates of a plan.

    It is the callback of the solvers, and raises :class:`~tominpmp.stopping.Stop` when
    planning is to end. By then it has kept the best motions of the present candidate.

    Args:
        problem: The problem.
        options: Options of the plan.
        asked: Predicate: whether the parent process has requested a stop.

    Attributes:
        problem: The problem.
        options: Options of the plan.
        candidates: The candidates so far.
        deadline: When to stop.
        start: Number of the present candidate.
        records: One record an iteration of the present candidate.
        kept: Motions of the present candidate, the newest last.
        begun: The motion that the present candidate began with.
        cut_short: How the present candidate was stopped; None if it was not.
        fallback: The best candidate of a coarse grid, whose last iterate becomes the
            solution if there is no incumbent in the end.
        first_guesses: The first guess for each goal, by its name and with the problem,
            which serve where that fails.
        complete: Whether all is done that a plan has to do: the end of its time is the
            end of a search that would never end by itself.
        failures: Errors of candidates that have led to no motion.
    """

    def __init__(
        self,
        problem: Problem,
        options: Options,
        *,
        asked: Callable[[], bool] | None = None,
    ) -> None:
        self.problem, self.options = problem, options
        self.candidates: list[Candidate] = []
        self.deadline = Deadline(asked)
        self.start = -1
        self.records: list[IterationRecord] = []
        self.kept: list[Kept] = []
        self.begun: Kept | None = None
        self.cut_short: Status | None = None
        self.fallback: Fallback | None = None
        self.first_guesses: list[tuple[str, Kept, Problem]] = []
        self.complete = False
        self.failures: list[Exception] = []
        self._bounds: list[tuple[list[Goal], LowerBound]] = []
        self._begin = time.perf_counter()
        self._limit = self._until = options.time_limit
        self._replay = 0.0
        self._saved: float | None = None  # when the time of grace ends
        # A violation that is good enough to stop, where any motion will do.
        self._enough = options.feasibility if options.objective == "feasible" else -1.0
        self._set_deadline()

    # -- candidates --------------------------------------------------------------------

    @property
    def incumbent(self) -> Candidate | None:
        """The incumbent: the fastest candidate whose replay holds, or None."""
        best = best_of(self.candidates)
        return best if best is not None and best.found else None

    @property
    def best_duration(self) -> float:
        """Duration of the incumbent [s]; infinite without an incumbent."""
        return min((one.duration for one in self.candidates), default=np.inf)

    @property
    def satisfied(self) -> bool:
        """Whether any motion will do, and there is one."""
        return self.options.objective == "feasible" and self.incumbent is not None

    def amend(self, candidate: Candidate, **changes: Any) -> None:
        """Have a candidate say more of itself: among equally fast ones the last counts.

        Args:
            candidate: The candidate.
            changes: Other values of its attributes.
        """
        self.candidates.append(replace(candidate, history=(), **changes))

    def begin(self) -> None:
        """Begin with another candidate."""
        self.start += 1
        self.records, self.kept, self.begun = [], [], None
        self.cut_short = None
        self._set_deadline()

    def keep(self, program: Solved, iterate: Iterate) -> None:
        """Keep a motion of the present candidate, should it be cut short."""
        feasible = iterate.violation <= self.options.feasibility
        new = Kept(program, iterate, feasible)
        self.begun = self.begun or new
        if self.kept and self.kept[-1].program is program:
            if self.kept[-1].feasible and not new.feasible:
                return
            self.kept[-1] = new
        else:
            self.kept = [*self.kept[-KEPT:], new]
        self._set_deadline()

    def lower_bound(self, problem: Problem) -> LowerBound:
        """Time that no motion can beat, found once for the goals of all segments.

        Raises:
            Stop: If it is time to stop.
        """
        goals = [phase.goal for phase in problem.phases]
        for known, bound in self._bounds:
            if all(map(operator.is_, known, goals)):
                return bound
        self._bounds.append((goals, lower_bound(problem)))
        return self._bounds[-1][1]

    # -- time --------------------------------------------------------------------------

    @property
    def seconds(self) -> float:
        """Time since planning began [s]."""
        return time.perf_counter() - self._begin

    @property
    def ends(self) -> float:
        """When the planning time is used up, on the clock of perf_counter [s]."""
        return self._begin + self._limit

    @property
    def left(self) -> float:
        """Planning time that is left [s], a little at least."""
        return max(self._until - self.seconds, 1e-3)

    @property
    def ended(self) -> Status | None:
        """How planning ends with the present candidate; None if it goes on."""
        used_up = self._until == self._limit or self.seconds >= self._limit
        goes_on = self.cut_short is Status.TIME_LIMIT and not used_up
        return None if goes_on else self.cut_short

    def share(self, parts: int) -> None:
        """Give the next candidate 1 / ``parts`` of the remaining time.

        With an incumbent it gets all of the remaining time.
        """
        self._until = self._limit
        if self.best_duration == np.inf:
            self._until = self.seconds + (self._limit - self.seconds) / max(parts, 1)
        self._set_deadline()

    def extend(self, limit: float) -> None:
        """Set another time limit, counted from the beginning of the plan [s]."""
        self._limit = self._until = limit
        self.records, self.kept = [], []
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
        """Time of grace, to save the motions found although it is time to stop."""
        until = self._end()
        if self.deadline.requested:
            self._saved = self._saved or time.perf_counter() + SAVING
            until = self._saved
        with self.deadline.grace(until):
            yield

    def _end(self) -> float:
        return self._begin + (1.0 + END_SHARE) * self._limit + END_SECONDS

    def _reserve(self) -> float:
        """Time to be left for the replay of the motions found [s]."""
        limit = self._limit
        if limit == np.inf:
            return 0.0
        if not any(item.feasible for item in self.kept):
            # Without any motion the initial guess of the candidate is time-scaled.
            nothing = self.best_duration == np.inf and self.begun is not None
            return FIRST_RESERVE * limit if nothing else 0.0
        replay = REPLAYS * (self._replay or END_SECONDS)
        return min(max(RESERVE * limit, replay), MOST_RESERVE * limit)

    def _set_deadline(self) -> None:
        more = STEP_SHARE * self._limit + STEP_SECONDS - self._reserve()
        self.deadline.end = self._begin + self._until + more
        self.deadline.last = self._end()

    # -- the callback ------------------------------------------------------------------

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record of the present candidate; a status ends the iteration.

        Raises:
            Stop: If planning is to end.
        """
        self.records.append(replace(record, iteration=len(self.records)))
        return self.see(record)

    def see(self, record: IterationRecord) -> Status | None:
        """Check the deadline on a record that stays out of the history.

        Raises:
            Stop: If planning is to end.
        """
        self.show(record)
        if record.violation <= self._enough:
            return Status.FEASIBLE
        if self.seconds >= self._until - self._reserve():
            raise Stop(requested=False)
        return None

    def show(self, record: IterationRecord) -> None:
        """Show a record to the callback of the options.

        Raises:
            Stop: If the callback says so.
        """
        record = replace(record, start=self.start, seconds=self.seconds)
        callback = self.options.callback
        if callback is not None and callback(record):
            self.deadline.requested = self.deadline.heeded = True
            raise Stop(requested=True)
