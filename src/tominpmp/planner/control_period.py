"""Motions on the clock of a controller: the last stage of a plan with a period.

The motion that was found freely lasts a number of periods and a bit. Its knots are
moved to ticks, and a few linear programs find a motion on these knots that lasts one
period more at most, or a few where that cannot be. Each segment takes a whole number of
periods, and so does each dwell, which is as long as was asked for or longer by less
than a period; a motion without segments is one segment. What a controller makes of its
samples is this motion itself, see :mod:`~tominpmp.transcription.grid`, and so its
replay judges what the controller will do.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from tominpmp.certificate.allowances import clock_share
from tominpmp.certificate.minimum_principle import TOLERANCE, certify
from tominpmp.certificate.stays import stays_where_it_moves, with_stays
from tominpmp.exceptions import OptionsError
from tominpmp.motion.samples import multiples
from tominpmp.motion.trajectory import MAX_SAMPLES, Trajectory
from tominpmp.options import FEWEST_PERIODS, Options
from tominpmp.planner.automatic_options import least_time, near_to_it
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.first_program import rested
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import NUMERICAL, Work, made
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment, Span, spans_of
from tominpmp.solution import Solution
from tominpmp.solvers.exchange import FAR, RowExchange
from tominpmp.solvers.loop import Callback, Loop, solve
from tominpmp.solvers.stop import first_of
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import STOPPED, IterationRecord, Status
from tominpmp.stopping import Stop
from tominpmp.transcription.grid import at_ticks, knots_near, ticks_of, whole_periods
from tominpmp.transcription.layout import QUADRATIC, Layout
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import TRACE, NonlinearProgram
from tominpmp.verification.verification import Verification

logger = logging.getLogger(__name__)

# Share of the planning time for the search without a clock.
SEARCH_SHARE = 0.7
# The motion is near to what it comes from: share of the usual trust region, iterations.
RADIUS = 0.1
ITERATIONS = 15
# Most trials. After a trial that does not tell how many periods are needed the next one
# has one period more, and this share of its periods.
TRIALS = 12
LONGER = (0.0, 0.0, 0.005, 0.01, 0.02, 0.04)
# Violations of rows below this are left to the replay, which lets pass far more: one
# more period is no cure for what rounding has left.
SLIGHT = 1e-5
# An iteration goes on while its last step has promised this share of what is missing,
# and the duration still changes by that share.
HOPE = 0.5
MOVING = 0.1
# Gap of its linear programs as a share of T, small beside TRACE: the duration reaches
# the ticks.
EXACT = 0.1 * TRACE
# Intervals are halved where a motion needs more periods than the trial has, by this
# share.
MANY_MORE = 0.01
# Intervals at most, where a trial does not tell how many periods are needed.
MOST_INTERVALS = 400
# A motion on the clock that takes this share of the tolerance more than rounding is
# put to the test again.
TESTED_AGAIN = 0.5


def searching(options: Options) -> Options:
    """Options for the search without a clock, which leaves some of the time."""
    if options.control_period is None:
        return options
    return replace(options, max_planning_time=SEARCH_SHARE * options.time_limit)


def on_clock(solution: Solution, state: PlanState) -> Solution:
    """Bring the motion of a solution to the clock of its options.

    Args:
        solution: What planning without the clock has led to.
        state: The plan: where its fastest candidate cannot be brought to the clock,
            another one may.

    Returns:
        The solution on the clock; the solution itself where it has no motion, or no
        clock. Where no motion on the clock is found, it is no success, and the message
        says so.

    Raises:
        OptionsError: If the period does not suit the duration of the motion.
    """
    period = solution.options.control_period
    if period is None or not solution.success:
        return solution
    if not solution.T / period <= MAX_SAMPLES:
        raise OptionsError(
            f"control_period is {period:g} s, too short for a motion of "
            f"{solution.T:.4g} s: more than {MAX_SAMPLES} samples",
            "control_period",
        )
    history, clocked, status = list(solution.history), None, None
    bring = partial(_fastest_on_clock, solution, period, state, history)
    try:
        clocked = bring()
    except (Stop, KeyboardInterrupt) as stop:
        status = state.stopped(stop)
        if status is Status.INTERRUPTED and solution.status is not status:
            # A motion that is not on the clock is no motion: there is time of grace.
            with state.saving(), contextlib.suppress(Stop, KeyboardInterrupt):
                clocked = bring()
    except NUMERICAL as error:
        logger.warning("the motion could not be brought to the clock: %r", error)
    solution = replace(solution, history=tuple(history), planning_time=state.seconds)
    if clocked is None or not clocked.found:
        return _without_clock(solution, period, clocked, status)
    return _with_clock(solution, period, clocked, state)


def _fastest_on_clock(
    solution: Solution, period: float, state: PlanState, history: list[IterationRecord]
) -> Candidate | None:
    """The fastest candidate that can be brought to the clock, as a motion on it.

    Args:
        solution: What planning without the clock has led to.
        period: The period [s].
        state: The plan.
        history: Gets the records of all trials.

    Returns:
        The motion; where there is none, the last one that was tried.
    """
    # Of candidates with one motion the last says the most of it.
    motions = {id(one.trajectory): one for one in state.candidates if one.found}
    clocked = None
    for former in sorted(motions.values(), key=lambda one: one.duration):
        clocked = _brought(solution, period, former, state)
        number, before = state.candidates.index(former), len(former.history)
        history.extend(replace(r, start=number) for r in clocked.history[before:])
        if clocked.found:
            break
    return clocked


def _with_clock(
    solution: Solution, period: float, clocked: Candidate, state: PlanState
) -> Solution:
    """The solution with a motion on the clock, and the status that it deserves."""
    motion, judged = clocked.trajectory, clocked.verification
    try:
        status, promise = status_on_clock(solution, motion, judged, period)
    except (Stop, KeyboardInterrupt) as stop:
        status, promise = state.stopped(stop), ""
    T, bound = motion.duration, solution.lower_bound
    message = (
        f"{status.value} T = {T:.4f} s, {ticks_of(T, period)} periods of "
        f"{period:g} s, {100 * (T / solution.T - 1.0):.2f} % above the motion "
        "without such a clock"
    )
    near = "" if bound is None else bound.comparison(T)
    if near:
        message += f" and {near}"
    better = status is Status.CONVERGED and solution.status is not status
    remark = "" if better else f"{clocked.remark} {promise}".strip()
    return replace(
        solution,
        status=status,
        message=f"{message}. {remark}".rstrip(),
        trajectory=motion,
        verification=judged,
        violations={},
        planning_time=state.seconds,
    )


def _without_clock(
    solution: Solution, period: float, last: Candidate | None, status: Status | None
) -> Solution:
    """The solution as a failure: the motion that it keeps knows no clock.

    Args:
        solution: The solution.
        period: The period [s].
        last: The last motion that was tried; None where planning was stopped.
        status: How planning was stopped; None if it was not.
    """
    replay = solution.verification
    if status is Status.TIME_LIMIT:
        reason = "the planning time was used up"
    elif status is Status.INTERRUPTED:
        reason = "the planning was interrupted"
    elif last is not None and last.verification is not None:
        status, reason = Status.UNVERIFIED, last.verification.message.rstrip(".")
    else:
        status = Status.INFEASIBLE
        reason = "none of the numbers of periods tried would do"
    rest = "keeps all else, but its knots are not on the clock"
    if replay is None:
        rest = "is not on the clock, and there was no time to verify it"
    elif not replay.ok:
        rest = f"is not on the clock, nor right: {replay.message.rstrip('.')}"
    message = (
        f"{status.value} No motion on a clock of {period:g} s was found: {reason}. The "
        f"motion that is kept, T = {solution.T:.4f} s, {rest}."
    )
    return replace(solution, status=status, message=message, feasible=False)


def status_on_clock(
    solution: Solution, motion: Trajectory, judged: Verification | None, period: float
) -> tuple[Status, str]:
    """The status of a motion on the clock, and a remark on it.

    A motion that was locally optimal without a clock stays so if T has grown by less
    than a period and a share of the tolerance of the certificate; else it is certified
    again, a period being no gain. A motion of the fewest possible periods is optimal.

    Args:
        solution: The motion without a clock.
        motion: The motion on the clock.
        judged: Its replay.
        period: The period [s].
    """
    status, problem, bound = solution.status, solution.problem, solution.lower_bound
    share = clock_share(motion, period)
    if share == 1.0 and status not in STOPPED:
        return Status.CONVERGED, ""
    if status is not Status.CONVERGED or stays_where_it_moves(problem):
        return status, ""
    if (1.0 - share - TESTED_AGAIN * TOLERANCE) * motion.duration <= solution.T:
        return status, ""
    if bound is not None and (1.0 - share - TOLERANCE) * motion.duration <= bound.T:
        return status, ""
    found = certify(problem, motion, verification=judged, control_period=period)
    if found.ok:
        return status, ""
    return Status.STALLED, (
        f"Small changes promise {100.0 * found.stationarity:.2g} % of T, of which "
        f"{100.0 * share:.2g} % is the rounding of the clock."
    )


def _brought(
    solution: Solution, period: float, former: Candidate, state: PlanState
) -> Candidate:
    """The motion of a candidate on the clock; the last that was tried if there is none.

    Args:
        solution: What planning without the clock has led to.
        period: The period [s].
        former: The candidate.
        state: Time and callback.
    """
    candidate, trial = former, Trial.of(solution.problem, former.trajectory, period)
    apart = former.clearance_rows
    for _ in range(TRIALS):
        found, knots = trial.candidate(solution, state, apart), trial.layout.shares
        apart = found.clearance_rows
        logger.info("%d periods of %g s: %s", trial.count, period, found.status.value)
        candidate, trial = found.after(candidate), trial.after(found)
        if found.found or np.array_equal(trial.layout.shares, knots):
            break  # times of arrival leave no other choice
    return replace(candidate, remark=former.remark)


@dataclass(frozen=True, eq=False)
class Trial:
    """A motion, and how many periods it is to take on a clock.

    Attributes:
        system: The functions of its problem, with dwells of whole periods.
        motion: The motion.
        spans: When its segments begin, meet their goals, and end.
        period: The period [s].
        periods: Number of periods of each segment, without its dwell.
        halvings: How often intervals of the motion are halved.
        finer: Whether they were halved to need fewer periods.
    """

    system: ProblemFunctions
    motion: Trajectory
    spans: Sequence[Span]
    period: float
    periods: tuple[int, ...]
    halvings: int = 0
    finer: bool = False

    @classmethod
    def of(cls, problem: Problem, motion: Trajectory, period: float) -> Trial:
        """A motion in as many periods as it takes.

        A segment that takes as long as it does since it may not arrive earlier takes as
        many as that asks for.

        Args:
            problem: What it solves.
            motion: The motion, without a clock.
            period: The period [s].
        """
        spans, wanted = spans_of(motion, problem.segments), []
        dwells = [whole_periods(one.dwell, period) for one in problem.segments]
        own = with_stays(problem.alternative_of(motion), dwells)
        trial = cls(ProblemFunctions.of(own), motion, spans, period, ())
        for span, segment in zip(spans, trial.segments, strict=True):
            earliest = 0.0 if segment.arrival is None else segment.arrival[0]
            waits = span.arrival <= (1.0 + TRACE) * earliest
            wanted.append(ticks_of(0.0 if waits else span.arrival - span.begin, period))
        return replace(trial, periods=trial.on_time(wanted))

    @property
    def segments(self) -> Sequence[Segment]:
        """The segments; one where the problem has none."""
        problem = self.system.problem
        return problem.segments or (Segment(problem.goal),)

    @cached_property
    def layout(self) -> Layout:
        """Knots near the nodes of the motion."""
        grid = self.motion, self.spans, self.period, self.periods
        return layout_on_clock(*grid, self.halvings)

    @property
    def count(self) -> int:
        """Number of periods of all segments."""
        return sum(self.periods)

    def on_time(self, periods: Sequence[int]) -> tuple[int, ...]:
        """Periods of the segments, no fewer than they need and within their windows.

        Args:
            periods: How many are wanted.
        """
        found: list[int] = []
        now = since = 0
        for count, segment in zip(periods, self.segments, strict=True):
            tick, rests = now + count, len(found) == len(periods) - 1 or segment.stop
            if segment.arrival is not None:
                earliest, latest = segment.arrival
                tick = max(tick, ticks_of(earliest, self.period))
                if latest < np.inf:
                    tick = min(tick, -ticks_of(-latest, self.period))
            # A segment whose goal is passed needs no more than one period, but from
            # rest to rest there are some.
            fewest = max(FEWEST_PERIODS - since, 1) if rests else 1
            found.append(max(tick - now, fewest))
            since = 0 if rests else since + found[-1]
            now += found[-1] + ticks_of(segment.dwell, self.period)
        return tuple(found)

    def candidate(self, solution: Solution, state: PlanState, apart: bool) -> Candidate:
        """A motion on these knots, with rows for links where they would touch.

        Args:
            solution: What planning without the clock has led to.
            state: Time and callback.
            apart: Whether rows keep links apart from the first program on.

        Returns:
            The motion; one that is not feasible where there is none that lasts as long
            as the knots.
        """
        problem, options = solution.problem, solution.options

        def shown(record: IterationRecord) -> None:
            # A callback that has interrupted the plan is shown no more iterations.
            if not state.deadline.interrupted:
                state.see(record)

        def make(system: ProblemFunctions, _: int, __: Candidate | None) -> Candidate:
            return self._solved(system, options, shown).verified(problem, options)

        work = Work(self.system, "clock", make, self_collision_rows=apart)
        return made(state, work)

    def _solved(
        self, system: ProblemFunctions, options: Options, shown: Callback
    ) -> Candidate:
        """A motion on these knots, not replayed yet."""
        T = float(self.layout.eta[0])
        known = self.motion, self.spans
        of, z = self.layout.represented(system, *known, within=True)
        feasibility = max(options.feasibility, SLIGHT)
        options = replace(options, objective="time", feasibility=feasibility)
        near = near_to_it(options, RADIUS, ITERATIONS)
        step, stop = trust_regions(near, accuracy=EXACT)
        begun, z = rested(NonlinearProgram.of(of).at(z), z)
        result = solve(
            replace(begun, least_duration=T),
            least_time(system, near, T),
            z,
            step,
            first_of(ReachesTicks(T, feasibility), stop),
            exchange=RowExchange(level=0.0, longest=(1.0 + TRACE) * T),
            callback=shown,
        )
        best = result.best
        if best is not None:
            # One with room on its rows may be above T by more than a trace.
            z = np.append(best.z[:-1], T)
            best = replace(best, z=z, values=result.program.evaluate(z))
            kept = best if best.violation <= feasibility else None
            result = replace(result, best=kept)
        found = Candidate.of("clock", self.motion, result)
        if not found.feasible:
            return found
        return replace(found, trajectory=on_ticks(found.trajectory, self.period))

    def after(self, candidate: Candidate) -> Trial:
        """What to try after a motion that is slower, not feasible or not all right.

        Args:
            candidate: The motion that this trial has led to.
        """
        motion = candidate.trajectory
        dwells = sum(segment.dwell for segment in self.segments)
        needed = ticks_of((1.0 - TRACE) * (motion.duration - dwells), self.period)
        if candidate.violation <= FAR and needed > self.count:
            spans = spans_of(motion, self.system.problem.segments)
            slower = replace(self, motion=motion, spans=spans, halvings=0)
            many_more = needed > self.count + max(1.0, MANY_MORE * self.count)
            if many_more and not self.finer and motion.t.size <= needed:
                return replace(slower, halvings=1, finer=True)
            return replace(slower, periods=self._longer(needed))
        longer = LONGER[min(self.halvings, len(LONGER) - 1)]
        periods = self._longer(self.count + 1 + int(longer * self.count))
        return replace(self, periods=periods, halvings=self.halvings + 1)

    def _longer(self, count: int) -> tuple[int, ...]:
        """Periods of the segments in proportion to their lengths, within their windows.

        Args:
            count: Number of periods in all.
        """
        ends = np.rint(np.cumsum(self.periods) * (count / self.count))
        longer = np.maximum(np.diff(ends, prepend=0.0), self.periods)
        return self.on_time(longer.astype(np.int64).tolist())


def layout_on_clock(
    motion: Trajectory,
    spans: Sequence[Span],
    period: float,
    periods: Sequence[int],
    halvings: int,
) -> Layout:
    """Layout of a motion whose nodes are moved to ticks of a clock, without dwells.

    Args:
        motion: The motion.
        spans: When its segments begin, meet their goals, and end.
        period: The period [s].
        periods: Number of periods of each segment.
        halvings: How often its intervals are halved, up to :data:`MOST_INTERVALS`.
    """
    knots, ends = np.zeros(1, dtype=np.int64), []
    for (begin, arrival, _), count in zip(spans, periods, strict=True):
        nodes = motion.t[(motion.t >= begin) & (motion.t <= arrival)]
        own = nodes.size - 1
        wanted = min(2**halvings * own, max(own, MOST_INTERVALS))
        knots = np.append(knots, knots[-1] + knots_near(nodes, count, wanted)[1:])
        ends.append(knots.size - 1)
    degree = QUADRATIC if motion.inverse_dynamics is None else motion.degree
    shares = np.diff(knots)[:, None] / knots[-1]
    return Layout(degree, shares, multiples(knots[-1:], period), tuple(ends))


def on_ticks(motion: Trajectory, period: float) -> Trajectory:
    """A motion whose nodes are ticks, with its nodes on them to the last bit."""
    ends = motion.segment_ends
    ends = None if ends is None else at_ticks(ends, period)
    return replace(motion, t=at_ticks(motion.t, period), segment_ends=ends)


@dataclass(frozen=True)
class ReachesTicks:
    """Rule that ends an iteration on a clock once it is as short as its ticks.

    It ends as well where the motion is nearly feasible and slower, and no hope is left
    that it becomes as short: it takes another period.

    Attributes:
        duration: Time of the last tick [s].
        feasibility: Largest violation that is let pass.
    """

    duration: float
    feasibility: float

    def __call__(self, loop: Loop) -> Status | None:
        """FEASIBLE once it is as short, STALLED where it will not be."""
        record, *before = reversed(loop.history)
        missing = record.duration - self.duration
        if missing <= TRACE * self.duration:
            return Status.FEASIBLE if record.violation <= self.feasibility else None
        moved = abs(before[0].duration - record.duration) if before else np.inf
        hopeless = moved < MOVING * missing or record.predicted < HOPE * missing
        return Status.STALLED if hopeless and record.violation <= FAR else None
