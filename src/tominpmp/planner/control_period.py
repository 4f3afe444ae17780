"""Motions on the clock of a controller: the last stage of a plan with a period.

The motion that was found freely lasts so many periods and a bit. Its knots are moved to
ticks, and a few linear programs find a motion on these knots that lasts one period
more at most, or a few where that cannot be. What a controller makes of its samples is
this motion itself, see :mod:`~tominpmp.transcription.grid`, and so its replay judges
what the controller will do.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exceptions import OptionsError
from tominpmp.initial_guess.segments import SegmentedGuess
from tominpmp.initial_guess.warm_start import WarmStart
from tominpmp.motion.trajectory import MAX_SAMPLES, Trajectory
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.control_period_outcome import (
    Clocked,
    failed,
    status_on_clock,
    succeeded,
)
from tominpmp.planner.control_period_segments import Course, Knots
from tominpmp.planner.descent import SMOOTHING_SHARE, near_to_it
from tominpmp.planner.first_program import rested
from tominpmp.planner.plan_state import PlanState
from tominpmp.problem import Problem
from tominpmp.solution import Solution
from tominpmp.solvers.exchange import FAR, RowExchange
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.loop import solve
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import STOPPED, IterationRecord, Status
from tominpmp.stopping import Deadline, Stop
from tominpmp.transcription.grid import Ticks, ticks_of
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import TRACE, NonlinearProgram
from tominpmp.verification.verification import Verification, verify

logger = logging.getLogger(__name__)

# Share of the planning time after which a motion without a clock is made do.
SEARCH_SHARE = 0.7
# Time for this stage once planning was interrupted [s].
PATIENCE = 1.0
# The motion is near to what it comes from: share of the usual trust region, iterations.
RADIUS = 0.1
ITERATIONS = 15
# Numbers of periods that are tried, and by how much more of them the next try has
# where nothing tells: by one, and by shares of the number later on.
TRIES = 12
LONGER = (0.0, 0.0, 0.005, 0.01, 0.02, 0.04)
# An iteration goes on while its last step has promised this share of what is missing,
# and the duration still changes by that share.
HOPE = 0.5
MOVING = 0.1
# Gap of its linear programs, as a share of T: what they leave of that above the
# duration that is wanted must be a trace.
EXACT = 0.1 * TRACE
# Intervals are halved where it takes more periods than so many more, by their share.
DEAR = 0.01
# They are as well where the replay of a motion is not all right, up to so many.
MOST_INTERVALS = 400


def searching(options: Options) -> Options:
    """Options for the search without a clock, which leaves some of the time."""
    if options.control_period is None:
        return options
    return replace(options, max_planning_time=SEARCH_SHARE * options.time_limit)


def on_clock(
    solution: Solution, candidates: Sequence[Candidate], progress: PlanState
) -> Solution:
    """Bring the motion of a solution to the clock of its options.

    Args:
        solution: What planning without the clock has led to.
        candidates: All that it has tried: where the fastest motion cannot be brought to
            the clock, another one may.
        progress: Time that was spent.

    Returns:
        The solution on the clock; what was given where there is no motion. Where none
        on the clock is found, it is no success, and the message says so.

    Raises:
        OptionsError: If the period does not suit the duration of the motion.
    """
    options, period = solution.options, solution.options.control_period
    if period is None or not solution.success:
        return solution
    assert solution.trajectory is not None  # noqa: S101
    check_period(period, solution.trajectory.duration)
    callback = ClockCallback.of(options, solution.status, progress)
    found = sorted((a for a in candidates if a.found), key=lambda a: a.duration)
    outcome = Clocked(Status.INFEASIBLE)
    history, remark = list(solution.history), ""
    try:
        for candidate in found:
            outcome = _bring(solution.problem, options, candidate.trajectory, callback)
            remark = candidate.remark
            history += _numbered(
                outcome.history, candidates.index(candidate), candidate
            )
            if outcome.trajectory is not None or outcome.status in STOPPED:
                break
    except (Stop, KeyboardInterrupt) as stop:
        outcome = Clocked(progress.stopped(stop))
    solution = replace(solution, history=tuple(history), planning_time=progress.seconds)
    if outcome.trajectory is None:
        return failed(solution, outcome, period)
    try:
        status, promise = status_on_clock(solution, outcome, period)
    except (Stop, KeyboardInterrupt) as stop:
        status, promise = progress.stopped(stop), ""
    solution = replace(solution, planning_time=progress.seconds)
    better = status is Status.CONVERGED and solution.status is not status
    remark = "" if better else f"{remark} {promise}".strip()
    return succeeded(solution, outcome, remark, period, status)


def _numbered(
    records: Sequence[IterationRecord], start: int, former: Candidate
) -> list[IterationRecord]:
    """Records of this stage as those of the candidate that it goes on from."""
    first = len(former.history)
    return [
        replace(record, start=start, iteration=first + number)
        for number, record in enumerate(records)
    ]


def check_period(period: float, duration: float) -> None:
    """Refuse a period that is far too short for a motion.

    Raises:
        OptionsError: If it is.
    """
    if not duration / period <= MAX_SAMPLES:
        raise OptionsError(
            f"control_period is {period:g} s, too short for a motion of "
            f"{duration:.4g} s: more than {MAX_SAMPLES} samples",
            "control_period",
        )


@dataclass
class ClockCallback:
    """Callback of this stage: ends it in time, or when no more is to be had.

    Attributes:
        options: The user's callback, and feasibility.
        progress: Time that was spent.
        deadline: When this stage ends.
        goal: Duration that need not be improved [s].
        last: Duration after the last iteration [s]; infinite before the first.
    """

    options: Options
    progress: PlanState
    deadline: Deadline
    goal: float = 0.0
    last: float = np.inf

    @classmethod
    def of(cls, options: Options, status: Status, progress: PlanState) -> ClockCallback:
        """That of a stage that follows a search which has ended with a status."""
        deadline, now = Deadline(), time.perf_counter()
        deadline.end = now - progress.seconds + options.time_limit
        if status is Status.INTERRUPTED:
            # Who interrupts wants the motion soon; without a clock it is none.
            deadline.end = min(now + PATIENCE, deadline.end)
            options = replace(options, callback=None)
        return cls(options, progress, deadline)

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record; a status ends the iteration."""
        callback = self.options.callback
        seen = replace(record, start=self.progress.start, seconds=self.progress.seconds)
        if callback is not None and callback(seen):
            return Status.INTERRUPTED
        there = record.duration <= self.goal * (1.0 + TRACE)
        if there and record.violation <= self.options.feasibility:
            return Status.FEASIBLE
        if self.deadline.due:
            return Status.TIME_LIMIT
        # Nearly admissible, slower, and no hope of more: it takes another period.
        missing, last = record.duration - self.goal, self.last
        self.last = record.duration
        settled = abs(last - record.duration) < MOVING * missing
        stop_if_hopeless = settled or record.predicted < HOPE * missing
        stop_if_hopeless = stop_if_hopeless and record.violation <= FAR
        return Status.STALLED if not there and stop_if_hopeless else None


@dataclass(frozen=True, eq=False)
class Try:
    """What is tried.

    Attributes:
        periods: Number of periods of each segment, without its stay.
        intervals: Number of intervals that are wanted at least.
        guess: The motion to begin with.
        fewest: Number of periods of the first try.
        finer: Whether intervals were halved to need fewer periods.
        fruitless: Number of tries that told nothing about how many it takes.
    """

    periods: tuple[int, ...]
    intervals: int
    guess: WarmStart | SegmentedGuess
    fewest: int
    finer: bool = False
    fruitless: int = 0

    @property
    def count(self) -> int:
        """Number of periods of all segments."""
        return sum(self.periods)

    def after(
        self,
        course: Course,
        program: NonlinearProgram,
        ticks: Ticks,
        result: SlpResult,
    ) -> Try:
        """What to try after a motion that is slower, not admissible or not all right.

        Args:
            course: What is brought to the clock.
            program: The program of this try.
            ticks: Its knots.
            result: Its outcome.
        """
        reached, near = result.iterate, result.iterate.violation <= FAR
        needed = ticks_of(program.timed(reached.z)[-1], ticks.period)
        if near and needed > self.count:
            guess = course.guess(program.trajectory(reached.z))
            dear = needed > self.fewest + max(1.0, DEAR * self.fewest)
            if dear and not self.finer and ticks.intervals < needed:
                twice = 2 * self.intervals
                return replace(self, guess=guess, intervals=twice, finer=True)
            return replace(self, periods=self._longer(course, needed), guess=guess)
        longer = 1 + int(LONGER[min(self.fruitless, len(LONGER) - 1)] * self.count)
        intervals = min(2 * self.intervals, max(self.intervals, MOST_INTERVALS))
        return replace(
            self,
            periods=self._longer(course, self.count + longer),
            intervals=intervals,
            fruitless=self.fruitless + 1,
        )

    def _longer(self, course: Course, count: int) -> tuple[int, ...]:
        """Periods of the segments, so many in all as far as their windows allow.

        What is more is spread over them by their lengths.
        """
        ends = np.rint(np.cumsum(self.periods) * (count / self.count))
        longer = np.maximum(np.diff(ends, prepend=0.0), self.periods)
        return course.on_time(longer.astype(np.int64).tolist())


def _bring(
    problem: Problem, options: Options, motion: Trajectory, callback: ClockCallback
) -> Clocked:
    """Look for a motion on the clock near one without."""
    period = options.control_period
    assert period is not None  # noqa: S101
    course = Course.of(problem, motion, period)
    complete, progress = course.system, callback.progress
    system = complete if progress.links_touched else complete.without_self_collision
    periods = course.periods
    now = Try(periods, course.intervals, course.guess(motion), sum(periods))
    last = Clocked(Status.INFEASIBLE)
    for _ in range(TRIES):
        knots = course.knots(now.periods, now.intervals, now.guess)
        program, z, result = _solve(system, options, knots, callback)
        last = replace(
            last, status=result.status, history=(*last.history, *result.history)
        )
        logger.info("%s: %s", knots.ticks, result.status.value)
        if z is not None:
            trajectory = knots.timed(program.trajectory(z))
            verification = verify(
                problem, trajectory, options.tolerances, checker=problem.checker
            )
            last = replace(last, verification=verification)
            if verification.ok:
                return replace(last, trajectory=trajectory)
            last = replace(last, status=Status.UNVERIFIED)
        if result.status in STOPPED or callback.deadline.due:
            stopped = result.status if result.status in STOPPED else Status.TIME_LIMIT
            return replace(last, status=stopped)
        if z is not None and system is not complete and _touches(verification):
            # As many periods, with rows for the links.
            system, progress.links_touched = complete, True
            continue
        former, now = now, now.after(course, program, knots.ticks, result)
        if (now.periods, now.intervals) == (former.periods, former.intervals):
            break  # times of arrival leave no other choice
    return last


def _touches(verification: Verification) -> bool:
    return any(item.kind == "clearance" for item in verification.violations)


def _solve(
    system: ProblemFunctions,
    options: Options,
    knots: Knots,
    callback: ClockCallback,
) -> tuple[NonlinearProgram, Array | None, SlpResult]:
    """Look for a motion on given knots.

    Returns:
        Program, an iterate that keeps all constraints and lasts as long as the ticks,
        if there is one, and the last outcome.
    """
    ticks = knots.ticks
    near = near_to_it(replace(options, objective="time"), RADIUS, ITERATIONS)
    tv_weight = options.smoothing
    if tv_weight is None:
        tv_weight = SMOOTHING_SHARE * ticks.duration
    callback.goal, callback.last = ticks.duration, np.inf
    begun, z = rested(*knots.program(system))
    result = solve(
        begun,
        MinimumTime.of(near, tv_weight),
        z,
        *trust_regions(near, accuracy=EXACT),
        exchange=RowExchange(level=0.0),
        callback=callback,
    )
    program = result.program
    assert isinstance(program, NonlinearProgram)  # noqa: S101
    if result.best is None:
        return program, None, result
    # What has room on its rows may be above that duration by more than a trace.
    kept = np.append(result.best.z[:-1], ticks.duration)
    worst = program.rows.largest_violation(program.evaluate(kept))
    return program, kept if worst <= options.feasibility else None, result
