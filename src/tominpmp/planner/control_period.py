"""Motions on the clock of a controller: the last stage of a plan with a control period.

The duration of a motion that was planned without a clock is no multiple of the period.
Its knots are moved to ticks of the clock, and a few convex programs find a motion on
these knots that takes at most one period more, or a few more if that is infeasible.
Each segment takes a whole number of periods; each dwell is rounded up to one. A motion
without segments is a single segment. The controller interpolates the samples to exactly
this motion, see :mod:`~tominpmp.transcription.grid`, so that the replay judges the
motion of the controller.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tominpmp.certificate.dwells import no_certificate, with_dwells
from tominpmp.certificate.minimum_principle import TOLERANCE, certify, clock_share
from tominpmp.exceptions import OptionsError
from tominpmp.motion.trajectory import MAX_SAMPLES, Trajectory
from tominpmp.options import FEWEST_PERIODS
from tominpmp.planner.automatic_options import minimum_time, warm_start_options
from tominpmp.planner.candidate import Candidate, best_of
from tominpmp.planner.first_program import with_active_rows
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import NUMERICAL, Work, make_and_repair
from tominpmp.problem.segments import Segment, Span, arrival_window, spans_of
from tominpmp.solution import Solution
from tominpmp.solvers.exchange import RowExchange
from tominpmp.solvers.loop import Loop, Rule, first_of, solve
from tominpmp.solvers.objective import RESTORABLE
from tominpmp.solvers.trust_region_step import ACCURACY, trust_regions
from tominpmp.status import STOPPED, IterationRecord, Status
from tominpmp.stopping import Stop
from tominpmp.transcription.exchange import LEAST
from tominpmp.transcription.grid import ROUNDING, ticks_of, whole_periods
from tominpmp.transcription.layout import Layout, on_ticks
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.verification import Verification

logger = logging.getLogger(__name__)

# Share of the planning time for the search without a clock.
SEARCH_SHARE = 0.7
# Most trials. If a trial does not show how many periods are needed, the next ones have
# one period more, then two, four and so on.
TRIALS = 12
# The iteration continues while its last step predicts the share HOPE of the missing
# reduction of the duration, and the duration still changes by the share MOVING of it.
HOPE = 0.5
MOVING = 0.1
# Duality gap of the programs as a share of T, small compared with ROUNDING, so that the
# duration reaches the ticks.
EXACT = ACCURACY * ROUNDING


def on_clock(solution: Solution, state: PlanState) -> Solution:
    """Move the motion of a solution to the clock of its control period.

    Args:
        solution: The solution of planning without the clock.
        state: The plan, whose incumbent is the motion of the solution.

    Returns:
        The solution on the clock, which may be that of a warm start; the solution
        itself if it has no motion, or options have no control period. If no motion on
        the clock is found, the solution is a failure, and its message says so.

    Raises:
        OptionsError: If the period does not suit the duration of the motion.
    """
    period, fastest = solution.options.control_period, state.incumbent
    if period is None or fastest is None:
        return solution
    if not solution.T / period <= MAX_SAMPLES:
        raise OptionsError(
            f"control_period is {period:g} s, too short for a motion of "
            f"{solution.T:.4g} s: more than {MAX_SAMPLES} samples",
            "control_period",
        )
    clocked, status = None, None
    try:
        clocked = _bring_to_clock(period, fastest, state)
    except (Stop, KeyboardInterrupt) as stop:
        status = state.stopped(stop)
        if status is Status.INTERRUPTED and solution.status is not status:
            # A motion off the clock is of no use: the grace period serves to move it.
            with state.saving(), contextlib.suppress(Stop, KeyboardInterrupt):
                clocked = _bring_to_clock(period, fastest, state)
    except NUMERICAL as error:
        logger.warning("the motion could not be brought to the clock: %r", error)
    history = tuple(state.history)
    solution = replace(solution, history=history, planning_time=state.seconds)
    tried = state.candidates if clocked is None else [*state.candidates, clocked]
    clocked = best_of([item for item in tried if item.is_on_clock(period)])
    if clocked is None or not clocked.confirmed:
        return _without_clock(solution, state, clocked, status)
    return _with_clock(solution, period, clocked, state)


def _with_clock(
    solution: Solution, period: float, clocked: Candidate, state: PlanState
) -> Solution:
    """The solution with a motion on the clock and its status."""
    motion, replay = clocked.trajectory, clocked.verification
    try:
        status, promise = status_on_clock(solution, motion, replay, period)
    except (Stop, KeyboardInterrupt) as stop:
        status, promise = state.stopped(stop), ""
    if status is Status.TIME_LIMIT:
        promise = f"{state.time_advice}."
    T, bound = motion.duration, solution.lower_bound
    longer = round(100.0 * (T / solution.T - 1.0), 2) + 0.0  # never -0.00
    message = (
        f"{status.value} T = {T:.4f} s, {ticks_of(T, period)} periods of "
        f"{period:g} s, {longer:.2f} % above the motion without such a clock"
    )
    gap = "" if bound is None else bound.comparison(T)
    if gap:
        message += f" and {gap}"
    better = status is Status.CONVERGED and solution.status is not status
    remark = "" if better else f"{clocked.remark} {promise}".strip()
    return replace(
        solution,
        status=status,
        message=f"{message}. {remark}".rstrip(),
        trajectory=motion,
        verification=replay,
        violations={},
        planning_time=state.seconds,
    )


def _without_clock(
    solution: Solution, state: PlanState, last: Candidate | None, status: Status | None
) -> Solution:
    """The solution as a failure, with its motion that is not on the clock.

    Args:
        solution: The solution, whose motion is verified.
        state: The plan.
        last: The last trial; None if planning was stopped before.
        status: How planning was stopped; None if it was not.
    """
    if status is Status.TIME_LIMIT:
        reason = state.time_advice
    elif status is Status.INTERRUPTED:
        reason = "the planning was interrupted"
    elif last is not None and last.verification is not None:
        status, reason = Status.UNVERIFIED, last.verification.message.rstrip(".")
    else:
        status = Status.INFEASIBLE
        reason = "no number of periods that was tried is feasible"
    message = (
        f"{status.value} No motion on a clock of {state.options.control_period:g} s "
        f"was found: {reason}. The motion that is kept, T = {solution.T:.4f} s, keeps "
        "all else, but its knots are not on the clock."
    )
    return replace(solution, status=status, message=message, feasible=False)


def status_on_clock(
    solution: Solution, motion: Trajectory, replay: Verification | None, period: float
) -> tuple[Status, str]:
    """The status of a motion on the clock, and a remark.

    A motion that was locally optimal without a clock remains so if T has grown by no
    more than a period for each segment, or if the lower bound shows that the rest is
    within the tolerance of the certificate. Otherwise it is certified again, where a
    predicted gain below one period for each segment does not count. A motion of the
    fewest possible periods is optimal.

    Args:
        solution: The solution without a clock.
        motion: The motion on the clock.
        replay: Its replay.
        period: The period [s].
    """
    status, problem, bound = solution.status, solution.problem, solution.lower_bound
    share = clock_share(motion, period)
    if share == 1.0 and status not in STOPPED:
        return Status.CONVERGED, ""
    if status is not Status.CONVERGED or no_certificate(problem):
        return status, ""
    if (1.0 - share) * motion.duration <= solution.T:
        return status, ""
    if bound is not None and (1.0 - share - TOLERANCE) * motion.duration <= bound.T:
        return status, ""
    verdict = certify(problem, motion, verification=replay, control_period=period)
    if verdict.ok:
        return status, ""
    return Status.STALLED, (
        f"Small changes promise {100.0 * verdict.stationarity:.2g} % of T, of which "
        f"{100.0 * share:.2g} % is the rounding of the clock."
    )


def _bring_to_clock(period: float, former: Candidate, state: PlanState) -> Candidate:
    """Move a candidate to the clock.

    If no motion on the knots of a trial is feasible, the next trial has more periods.

    Args:
        period: The period [s].
        former: The candidate without a clock.
        state: The plan.

    Returns:
        The motion on the clock; the last trial if no trial succeeds.
    """
    problem, motion = state.problem, former.trajectory
    dwells = [whole_periods(phase.dwell, period) for phase in problem.segments]
    rounded = with_dwells(problem.alternative_of(motion), dwells)
    system = ProblemFunctions.of(rounded)
    segments = rounded.segments or (Segment(rounded.goal),)
    spans = spans_of(motion, problem.segments)
    begins, arrivals, _ = np.array(spans).T
    # Durations of the segments without a clock and without their dwells, in periods.
    lengths = np.maximum((arrivals - begins) / period, 1.0)
    # A segment that waits for its earliest arrival takes what this time asks for.
    earliest = [arrival_window(segment)[0] for segment in segments]
    waits = arrivals <= (1.0 + ROUNDING) * np.array(earliest)
    counts = [ticks_of(length, 1.0) for length in np.where(waits, 0.0, lengths)]
    wanted, halvings = np.array(_within_windows(counts, segments, period)), 0
    candidate, knots = former, np.zeros(0)
    for _ in range(TRIALS):
        periods = _within_windows(wanted.tolist(), segments, period)
        layout = Layout.on_clock(motion, spans, period, periods, halvings)
        if np.array_equal(layout.shares, knots):
            break  # the windows of arrival allow no other knots
        knots = layout.shares
        make = partial(_on_knots, layout, motion, spans, period, state)
        # Rows against self-collision that the former program had are kept.
        tried = make_and_repair(
            state, Work(system, make, self_collision_rows=candidate.clearance_rows)
        )
        count, candidate = sum(periods), tried.after(candidate)
        logger.info("%d periods of %g s: %s", count, period, tried.status.value)
        if tried.confirmed:
            break
        needed = (1.0 - ROUNDING) * (tried.trajectory.duration - sum(dwells))
        more = ticks_of(needed, period) - count
        if tried.violation <= RESTORABLE and more > 0:
            motion, halvings = tried.trajectory, 0
            spans = spans_of(motion, rounded.segments)
            # With several segments the duration also depends on the rounding of each,
            # which is another one for every number of periods.
            more = more if len(segments) == 1 else (more + 1) // 2
        else:
            more = 2**halvings
            halvings += 1
        # Each further period goes to the segment that is shortest compared with the
        # motion without a clock: the fastest segment determines the duration.
        for _ in range(more):
            wanted[np.argmin(wanted / lengths)] += 1
    return replace(candidate, remark=former.remark)


def _within_windows(
    wanted: Sequence[int], segments: Sequence[Segment], period: float
) -> list[int]:
    """Periods of segments, without dwells, within their windows of arrival.

    Args:
        wanted: Numbers of periods before they are adapted to the windows.
        segments: The segments, whose dwells are whole periods.
        period: The period [s].
    """
    counts: list[int] = []
    now = since = 0
    for count, segment in zip(wanted, segments, strict=True):
        rests = segment is segments[-1] or segment.stop
        earliest, latest = arrival_window(segment)
        tick = max(now + count, ticks_of(earliest, period))
        if latest < np.inf:
            tick = min(tick, -ticks_of(-latest, period))
        # A segment whose goal is passed may take a single period, but a motion from
        # rest to rest takes FEWEST_PERIODS.
        fewest = max(FEWEST_PERIODS - since, 1) if rests else 1
        counts.append(max(tick - now, fewest))
        since = 0 if rests else since + counts[-1]
        now += counts[-1] + ticks_of(segment.dwell, period)
    return counts


def _on_knots(
    layout: Layout,
    motion: Trajectory,
    spans: Sequence[Span],
    period: float,
    state: PlanState,
    system: ProblemFunctions,
    *_: object,
) -> Candidate:
    """The motion on given knots, replayed.

    It is not feasible if no motion with the duration of the layout was found.

    Args:
        layout: The knots, which are ticks.
        motion: The motion that serves as warm start.
        spans: When its segments begin, meet their goals, and end.
        period: The period [s].
        state: The plan.
        system: Functions of the problem, with dwells of whole periods.
    """

    def shown(record: IterationRecord) -> None:
        # A callback that has interrupted the plan sees no more iterations. A motion
        # that is feasible before the tick ends no iteration: it needs more periods.
        if not state.deadline.interrupted:
            state(record)

    T = float(layout.eta[0])
    represented = layout.represented(system, motion, spans, within=True)
    # Smaller violations come from rounding, which another period would not remove: they
    # are left to the replay, which tolerates much more.
    feasibility = max(state.options.feasibility, LEAST)
    options = replace(state.options, objective="time", feasibility=feasibility)
    warm = warm_start_options(options)
    step, stop = trust_regions(warm, accuracy=EXACT)
    program, z = with_active_rows(*represented)
    result = solve(
        replace(program, least_duration=T),
        minimum_time(system, warm, T),
        z,
        step,
        first_of(reaches_tick(T, feasibility), stop),
        exchange=RowExchange(longest=(1.0 + ROUNDING) * T),
        callback=shown,
    )
    best = result.best
    if best is not None:
        # With slack in its rows T may exceed the tick by more than rounding: it is set
        # to the tick, and the rows are evaluated again.
        z = np.append(best.z[:-1], T)
        best = replace(best, z=z, values=result.program.evaluate(z))
        feasible = best if best.violation <= feasibility else None
        result = replace(result, best=feasible)
    clocked = Candidate.of(motion, result)
    if clocked.feasible:
        clocked = replace(clocked, trajectory=on_ticks(clocked.trajectory, period))
    return clocked.verified(state.problem, state.options)


def reaches_tick(duration: float, feasibility: float) -> Rule:
    """Stop rule of iterations on a clock: T has come down to the last tick.

    The iteration is FEASIBLE once the tick is reached. It is STALLED if the motion is
    nearly feasible and still slower, and its progress predicts that it will not reach
    the tick: it needs another period.

    Args:
        duration: Time of the last tick [s].
        feasibility: Largest tolerated violation.
    """

    def rule(loop: Loop) -> Status | None:
        record, *before = reversed(loop.history)
        missing = record.duration - duration
        if missing <= ROUNDING * duration:
            return Status.FEASIBLE if record.violation <= feasibility else None
        moved = abs(before[0].duration - record.duration) if before else np.inf
        hopeless = moved < MOVING * missing or record.predicted < HOPE * missing
        return Status.STALLED if hopeless and record.violation <= RESTORABLE else None

    return rule
