"""The state of a plan: its time, its candidates, and the candidate in progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.lower_bound import lower_bound
from tominpmp.bounds.result import LowerBound
from tominpmp.constraints.base import USABLE
from tominpmp.initial_guess.rrt import PathSearches
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate, KeptIterate, best_of
from tominpmp.problem.problem import Problem
from tominpmp.solvers.exchange import RowExchange
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.solvers.loop import solve
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import Deadline, Stop
from tominpmp.transcription.base import ProgramInterface
from tominpmp.transcription.program import NonlinearProgram

# Iterates kept per candidate in addition to the newest.
MOST_KEPT = 4
# Time reserved for the last replay: REPLAYS times the longest replay so far, up to the
# share MOST_RESERVE of the time limit. The first replay is assumed to take as long as
# AS_ITERATIONS iterations of the descent before it, but no less than END_SECONDS: on
# six arms it took 2 to 9 of them, with and without dry friction.
MOST_RESERVE, REPLAYS, AS_ITERATIONS = 0.25, 1.5, 5
# Overrun allowed for one step, and for the conclusion: share of the limit, and [s].
STEP_SHARE, STEP_SECONDS = 0.02, 0.08
END_SHARE, END_SECONDS = 0.08, 0.15
# Grace period to save the best motion once planning was interrupted, in total [s].
SAVING = 3.0


def start_key(problem: Problem, *start: Array) -> int:
    """Key of a start of a plan: the goal of a problem, and a guess or torques.

    Args:
        problem: The problem of the plan with one of its goals.
        *start: The arrays of the guess, or of the initial iterate.
    """
    return hash((id(problem.goal), *(numbers.tobytes() for numbers in start)))


class PlanState:
    """Time, callback and candidates of a plan.

    It is the callback of the solvers, and raises :class:`~tominpmp.stopping.Stop` when
    planning is to end. Iterates of the candidate in progress are kept, so that its best
    motion survives the stop.

    Args:
        problem: The problem.
        options: Options of the plan.
        stop_requested: Predicate: whether the parent process has requested a stop.

    Attributes:
        problem: The problem.
        options: Options of the plan.
        candidates: The candidates so far.
        T_to_beat: In a worker process, T of the incumbent of the plan for which the
            process works [s]; infinite without one.
        deadline: When to stop.
        start: Number of the candidate in progress, from 0.
        records: Records of the candidate in progress, one per iteration.
        kept_iterates: Iterates of the candidate in progress, those that are feasible
            after the others, and the newest one last.
        cut_short: How the candidate in progress was stopped; None if it was not.
        fallbacks: Last iterates and first guesses of candidates that are not confirmed,
            the best one first, which may become the solution if slowed down; beside an
            incumbent the best one only.
        paths: For each goal, by the identity of its problem, a function that returns
            the first path around the obstacles as an iterate; they are ranked with the
            fallbacks that are not feasible.
        complete: Whether all stages of a plan with less effort are done. The thorough
            search that follows is open-ended: a time limit then is its regular end.
        callback_error: Error that the callback has raised; None without one.
        impossible: Proof that no motion exists, in sentences; empty without one.
        failures: Errors of candidates that have led to no motion.
        history: Records of all iterations, with the numbers of their candidates.
        searches: Success of the searches for paths around obstacles.
        reached: Configurations found for goals that leave them open, see
            :class:`~tominpmp.initial_guess.guess.GuessRequest`.
        former: A warm start that has the ends of the problem, not replayed before it is
            recalled; None without one.
        tried: Keys of the starts from which descents on coarse grids and shooting
            began, see :func:`start_key`.
    """

    def __init__(
        self,
        problem: Problem,
        options: Options,
        *,
        stop_requested: Callable[[], bool] | None = None,
    ) -> None:
        self.problem, self.options = problem, options
        self.candidates: list[Candidate] = []
        self.T_to_beat = np.inf
        self.deadline = Deadline(stop_requested)
        self.start = -1
        self.records: list[IterationRecord] = []
        self.kept_iterates: list[KeptIterate] = []
        self.cut_short: Status | None = None
        self.fallbacks: list[KeptIterate] = []
        self.paths: dict[int, Callable[[], KeptIterate]] = {}
        self.complete = False
        self.callback_error: Exception | None = None
        self.impossible = ""
        self.failures: list[Exception] = []
        self.history: list[IterationRecord] = []
        self.searches = PathSearches()
        self.reached: dict[Hashable, tuple[list[Array], bool]] = {}
        self.former: Candidate | None = None
        self.tried: set[int] = set()
        self._bounds: dict[tuple[int, ...], tuple[Problem, LowerBound]] = {}
        self._begin = time.perf_counter()
        # Ends of the plan and of its next candidate, in seconds from its beginning.
        self._limit = self._until = options.time_limit
        self._longest_replay = 0.0
        self._grace_end: float | None = None  # end of the grace period
        self._set_deadline()

    # -- candidates --------------------------------------------------------------------

    @property
    def incumbent(self) -> Candidate | None:
        """The fastest candidate whose replay keeps all limits; None without one."""
        best = best_of(self.candidates)
        return best if best is not None and best.confirmed else None

    @property
    def best_duration(self) -> float:
        """Duration of the incumbent [s]; infinite without an incumbent."""
        return min([self.T_to_beat, *(each.duration for each in self.candidates)])

    @property
    def satisfied(self) -> bool:
        """Whether any feasible motion will do, and the plan has found one."""
        return self.options.objective == "feasible" and self.incumbent is not None

    def amend(self, candidate: Candidate, **changes: Any) -> None:
        """Change attributes of a candidate by appending a changed copy.

        Among equally fast candidates the last one counts.

        Args:
            candidate: The candidate.
            changes: New values of its attributes.
        """
        self.candidates.append(replace(candidate, **changes))

    def recall_former(self, status: Status) -> None:
        """Keep the warm start as a candidate, if its replay keeps all limits.

        It is left out if the incumbent is faster. It may exceed the limits by what the
        rows of a program leave between them, and not by all that a replay tolerates:
        the limits may be lower than those that it was planned for.

        Args:
            status: Status of the candidate.

        Raises:
            Stop: If it is time to stop.
        """
        former = self.former
        if former is None or self.best_duration < former.trajectory.duration:
            return
        if former.verification is None:
            tolerance = min(self.options.limit_tolerance, USABLE)
            strict = replace(self.options, limit_tolerance=tolerance)
            self.former = former = former.verified(self.problem, strict)
        if former.confirmed:
            self.amend(former, status=status)

    def begin(self) -> None:
        """Begin the next candidate."""
        self.start, self.cut_short = self.start + 1, None
        self.records, self.kept_iterates = [], []
        self._set_deadline()

    def keep(self, program: ProgramInterface, iterate: Iterate) -> None:
        """Keep an iterate of the candidate in progress, in case it is cut short."""
        feasible = iterate.violation <= self.options.feasibility
        last = self.kept_iterates[-1] if self.kept_iterates else None
        initial = last and (last.initial or last)
        new = KeptIterate(program, iterate, feasible, initial)
        kept = [item for item in self.kept_iterates if item.iterate.z is not iterate.z]
        # Once rows have joined, many iterates may follow that are not feasible.
        kept.sort(key=lambda item: item.feasible)
        self.kept_iterates = [*kept[-MOST_KEPT:], new]
        self._set_deadline()

    @property
    def solve(self) -> Callable[..., SlpResult[NonlinearProgram]]:
        """:func:`~tominpmp.solvers.loop.solve` with row exchange, seen by the plan."""
        return partial(solve, exchange=RowExchange(), callback=self, keep=self.keep)

    def lower_bound(self, problem: Problem) -> LowerBound:
        """Lower bound of the duration, computed once per combination of goals.

        Raises:
            Stop: If it is time to stop.
        """
        goals = tuple(id(phase.goal) for phase in problem.phases)
        if goals not in self._bounds:
            # The problem is kept, as the goals of another one could take their places.
            self._bounds[goals] = problem, lower_bound(problem)
        return self._bounds[goals][1]

    def exceeds_bound(self, factor: float, problem: Problem) -> bool:
        """Whether the incumbent takes longer than a multiple of the lower bound.

        Args:
            factor: The multiple.
            problem: The problem of the bound.

        Raises:
            Stop: If it is time to stop.
        """
        return bool(self.best_duration > factor * self.lower_bound(problem).T)

    # -- time --------------------------------------------------------------------------

    @property
    def seconds(self) -> float:
        """Time since planning began [s]."""
        return time.perf_counter() - self._begin

    @property
    def remaining_time(self) -> float:
        """Planning time left for the next candidate [s], always positive."""
        return max(self._until - self.seconds, 1e-3)

    @property
    def time_advice(self) -> str:
        """How much planning time was allowed, and what allows more, in a clause."""
        limit, effort = self.options.time_limit, self.options.effort
        advice = f"{limit:.3g} s were allowed; max_planning_time allows more"
        if self.options.max_planning_time is None and effort != "thorough":
            advice += f" than effort {effort!r} does"
        return advice

    @property
    def ended(self) -> Status | None:
        """How planning ends after the candidate in progress; None to continue."""
        used_up = self._until == self._limit or self.seconds >= self._limit
        goes_on = self.cut_short is Status.TIME_LIMIT and not used_up
        return None if goes_on else self.cut_short

    def share_time(self, parts: int) -> None:
        """Give the next candidate 1 / ``parts`` of the remaining time.

        If there is an incumbent, the candidate gets all of the remaining time.
        """
        self._until = self._limit
        if self.best_duration == np.inf and parts > 1:
            self._until = self.seconds + (self._limit - self.seconds) / parts
        self._set_deadline()

    def reset_limit(self, limit: float) -> None:
        """Replace the time limit, counted from the beginning of the plan [s]."""
        self._limit = self._until = limit
        self.records, self.kept_iterates = [], []
        self._set_deadline()

    def replayed(self, seconds: float) -> None:
        """Record how long the replay of a motion took [s]."""
        self._longest_replay = max(self._longest_replay, seconds)

    def stopped(self, cause: BaseException) -> Status:
        """Note that an exception has stopped planning; its status."""
        prevented = getattr(cause, "prevented", "")
        self.searches.impasse = self.searches.impasse or prevented
        self.cut_short = Status.TIME_LIMIT
        if not isinstance(cause, Stop) or cause.requested:
            self.deadline.requested = True
            self.cut_short = Status.INTERRUPTED
        return self.cut_short

    @contextmanager
    def saving(self) -> Iterator[None]:
        """Grace period: save the motions found after the deadline has passed."""
        until = self._end()
        if self.deadline.requested:
            self._grace_end = self._grace_end or time.perf_counter() + SAVING
            until = self._grace_end
        with self.deadline.grace(until):
            yield

    def _end(self) -> float:
        """When the plan must end, by ``time.perf_counter`` [s]."""
        return self._begin + (1.0 + END_SHARE) * self._limit + END_SECONDS

    def _reserve(self) -> float:
        """Time reserved for the replay of the motions found [s]."""
        limit, kept = self._limit, self.kept_iterates
        # Without an incumbent a motion that breaks limits may have to be slowed down.
        slowed = self.best_duration == np.inf
        if limit == np.inf or not any(slowed or item.feasible for item in kept):
            return 0.0
        replay = REPLAYS * (self._longest_replay or self._first_replay())
        return min(replay, MOST_RESERVE * limit)

    def _first_replay(self) -> float:
        """Estimate of the time that a replay takes before one was timed [s]."""
        times = [record.seconds for record in self.records] or [0.0]
        iteration = (times[-1] - times[0]) / max(len(times) - 1, 1)
        return max(END_SECONDS, AS_ITERATIONS * iteration)

    def _candidate_end(self) -> float:
        """Time from the beginning of the plan to the end of the candidate [s].

        The reserve for the last replay remains after it.
        """
        return min(self._until, self._limit - self._reserve())

    def _set_deadline(self) -> None:
        more = STEP_SHARE * self._limit + STEP_SECONDS
        self.deadline.end = self._begin + self._candidate_end() + more
        self.deadline.last = self._end()

    # -- the callback ------------------------------------------------------------------

    def __call__(self, record: IterationRecord) -> None:
        """Add a record of the candidate in progress.

        Raises:
            Stop: If planning is to end.
        """
        record = replace(record, iteration=len(self.records), seconds=self.seconds)
        self.records.append(record)
        self.show(record)
        if self.seconds >= self._candidate_end():
            raise Stop(requested=False)

    def show(self, record: IterationRecord) -> None:
        """Add a record to the history, and show it to the callback of the options.

        An error of the callback ends the plan, and is raised at its end.

        Raises:
            Stop: If the callback says so, or raises an error.
        """
        record = replace(record, start=self.start, seconds=self.seconds)
        self.history.append(record)
        callback = self.options.callback
        try:
            stops = callback is not None and bool(callback(record))
        except Exception as error:
            self.callback_error, stops = error, True
        if stops:
            self.deadline.requested = self.deadline.heeded = True
            raise Stop(requested=True)
