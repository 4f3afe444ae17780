"""Segments of a motion, each of which is verified like a whole motion.

A segment has a robot with its payload, a scene, limits, and a goal at its end. There is
one replay for all segments, from the start of the first to the end of the last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import Array
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion.extrema import least_between
from tominpmp.motion.joining import checked_motion
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import HOLDING
from tominpmp.options import Tolerances
from tominpmp.problem.joint_limits import effort_range
from tominpmp.problem.segments import SAME, arrival_window, spans_of
from tominpmp.problem.state_checks import holding
from tominpmp.verification.limit_violations import Excesses, LimitViolation
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.replay import TIME_STEP, Replay

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem

# Largest number of instants at which ends of recorded segments are searched for.
MOST_SAMPLES = 20_000
# Ends of segments closer to a node than this share of the duration are at the node:
# accelerations in an interval so short are rounding errors.
AT_NODE = 1e-6
# Residual below which a goal counts as met, as a share of the tolerance.
MET = 1e-3


@dataclass(frozen=True, eq=False)
class Stage:
    """One segment of a motion.

    Attributes:
        problem: The problem of the segment.
        begin: Time at which the segment begins [s].
        reached: Time at which the goal is met, before the dwell [s].
        end: Time at which the segment ends, after the dwell [s].
        arrival: Earliest and latest time at which the goal has to be met [s]; None
            without arrival times.
        segment: Number of the segment, from 1; None for a motion of one segment.
    """

    problem: Problem
    begin: float
    reached: float
    end: float
    arrival: tuple[float, float] | None = None
    segment: int | None = None

    @property
    def timeliness(self) -> list[LimitViolation]:
        """Deviation from the arrival times; empty without arrival times."""
        if self.arrival is None:
            return []
        (earliest, latest), reached = self.arrival, self.reached
        excess = max(reached - latest, earliest - reached)
        side = "late" if reached - latest >= earliest - reached else "early"
        violated = excess > TIME_STEP
        return [LimitViolation("arrival", side, reached, excess, "s", excess, violated)]

    def named(self, item: LimitViolation) -> LimitViolation:
        """A violation with number and times of the segment, if the motion has several.

        Args:
            item: The violation.
        """
        if self.segment is None:
            return item
        return replace(item, segment=self.segment, span=(self.begin, self.end))

    def section(self, replay: Replay, torque: Pieces) -> tuple[Replay, Pieces]:
        """Section of a replay and of its torques on the segment.

        The section is empty if the replay failed before the segment.

        Args:
            replay: The replay of the whole motion.
            torque: Torques of the whole motion.
        """
        if self.segment is None:
            return replay, torque
        rows = replay.between(self.begin, self.end)
        complete = bool(rows.t.size) and rows.t[-1] == self.end
        first, behind = np.searchsorted(torque.t, [self.begin, self.end]).tolist()
        pieces = replace(
            torque,
            t=torque.t[first : behind + 1],
            coefficients=torque.coefficients[first:behind],
        )
        u = np.array(rows.u)
        if self.begin == self.end:
            # A segment without duration has the torques that hold the arm.
            u = RobotDynamics(self.problem.robot).inverse(rows.q, rows.v, 0.0 * rows.v)
        elif complete:
            # The row of a node has the torque just after it, on the next segment.
            u[-1] += pieces.ends()[-1, 1] - torque(rows.t[-1:])[0]
        return replace(rows, u=u, complete=complete), pieces


def stages_of(problem: Problem, trajectory: Trajectory) -> tuple[Stage, ...]:
    """The segments of a motion; a single segment if their end times are not known.

    Args:
        problem: The problem.
        trajectory: The motion, with the end times of its segments.
    """
    phases, segments, T = problem.phases, problem.segments, trajectory.duration
    ends = trajectory.segment_ends
    if ends is None or len(ends) != len(segments):
        return (Stage(problem, 0.0, T, T),)
    each = zip(phases, segments, spans_of(trajectory, segments), strict=True)
    return tuple(
        Stage(phase, *span, segment.arrival, number if len(phases) > 1 else None)
        for number, (phase, segment, span) in enumerate(each, 1)
    )


def checked_in_segments(
    problem: Problem, trajectory: Trajectory | Samples
) -> Trajectory:
    """A caller's motion, checked, with the ends of its segments; samples are joined.

    Args:
        problem: The problem.
        trajectory: The motion.

    Raises:
        ProblemError: As raised by :func:`~tominpmp.motion.joining.checked_motion`.
        ScenarioError: Likewise.
    """
    return with_segments(problem, checked_motion(trajectory, problem), Tolerances())


def with_segments(
    problem: Problem, trajectory: Trajectory, tolerances: Tolerances
) -> Trajectory:
    """A motion with the end times of its segments, and the payload of each segment.

    A recorded motion has these times at best up to the time step between two rows. Its
    segments end where it first meets their goals, one after the other, or comes nearest
    to them; if end times are recorded, where it is nearest to them in the step before.

    Args:
        problem: The problem.
        trajectory: The motion.
        tolerances: Tolerances of the goals.
    """
    segments, recorded = problem.segments, trajectory.segment_ends
    if recorded is None or len(recorded) != len(segments):
        trajectory = replace(trajectory, segment_ends=None, segment_dynamics=())
    if trajectory.segment_dynamics or not segments:
        return trajectory
    ends = _segment_ends(problem, trajectory, tolerances)
    node = trajectory.t[np.argmin(np.abs(trajectory.t[:, None] - ends), axis=0)]
    near = np.abs(node - ends) <= AT_NODE * trajectory.duration
    ends = np.where(near, node, ends)
    nodes = np.union1d(trajectory.t, ends)
    motion = replace(trajectory._on_nodes(nodes), segment_ends=ends)
    if trajectory.inverse_dynamics is None:
        return motion
    dynamics = tuple(RobotDynamics(phase.robot).inverse for phase in problem.phases)
    return motion.with_torques(dynamics[0], dynamics)


def _segment_ends(
    problem: Problem, motion: Trajectory, tolerances: Tolerances
) -> Array:
    """Times at which the segments of a recorded motion end [s], shape (k,).

    Args:
        problem: The problem.
        motion: The motion, with the recorded end times, or without any.
        tolerances: Tolerances of the goals.
    """
    recorded = motion.segment_ends
    plain, T = replace(motion, inverse_dynamics=None), motion.duration
    step = max(TIME_STEP, T / MOST_SAMPLES)
    times = np.unique(np.concatenate([np.arange(0.0, T, step), motion.t]))
    ends: list[float] = []
    first, last = 0, times.size - 1
    each = zip(problem.phases[:-1], problem.segments[:-1], strict=True)
    for number, (phase, segment) in enumerate(each):
        begin, behind = first, last + 1
        if recorded is not None:
            # The row before the recorded first row of the next segment.
            row = max(int(np.searchsorted(motion.t, recorded[number])) - 1, 0)
            earliest = motion.t[row] - segment.dwell
            begin = max(first, int(np.searchsorted(times, earliest - step)))
            behind = max(int(np.searchsorted(times, recorded[number])) + 1, begin + 1)
        residuals = partial(_residuals, plain, phase, tolerances)
        # Of a dwell all times are equally near, and the first one counts.
        nearest = recorded is not None and segment.dwell == 0.0
        met = _first_met(residuals, times[begin:behind], nearest=nearest)
        allowed, _ = arrival_window(segment)
        if met < allowed <= T:
            # An arm may meet the goal early, and wait there or meet it again.
            after = np.append(allowed, times[begin:behind])
            again = _first_met(residuals, after[after >= allowed], nearest=nearest)
            met = again if next(residuals(np.array([again]))) <= 1.0 else met
        end = met
        if segment.dwell > 0.0:
            later = np.searchsorted(times, met + segment.dwell - SAME)
            end = float(times[min(int(later), last)])
            if recorded is not None and _rests(plain, end, recorded[number]):
                end = float(recorded[number])  # a dwell longer than the least
        first = min(int(np.searchsorted(times, end)), last)
        ends.append(end)
    return np.array([*ends, T])


def _residuals(
    motion: Trajectory, phase: Problem, tolerances: Tolerances, times: Array
) -> Iterator[float]:
    """Largest goal residual at each time of a motion, in units of the tolerances."""
    kinematics, state = RobotKinematics(phase.robot), motion(times)
    units = tolerances.goal, tolerances.speed
    for q, v in zip(state.q, state.v, strict=True):
        misses = phase.goal.misses(kinematics, q, v)
        yield max((miss.amount / units[miss.moving] for miss in misses), default=0.0)


def _rests(motion: Trajectory, begin: float, end: float) -> bool:
    """Whether the arm rests between two times."""
    if begin > end:
        return False
    state = motion(np.array([begin, end]))
    movement = np.maximum(np.abs(state.q[1] - state.q[0]), np.abs(state.v[1]))
    return bool(np.all(movement <= SAME))


def _first_met(
    residuals: Callable[[Array], Iterator[float]], times: Array, *, nearest: bool
) -> float:
    """First time at which a goal is met, or the time of its least residual [s].

    Args:
        residuals: Function that evaluates the residual of the goal at times.
        times: Times in order, shape (k,) [s].
        nearest: Whether only the least residual of all times counts; the last time,
            at which a file says that the segment ends, counts if the goal is met there.
    """
    if nearest and next(residuals(times[-1:])) <= MET:
        return float(times[-1])
    best, least = 0, np.inf
    for k, residual in enumerate(residuals(times)):
        nearer = residual < least
        if nearer:
            best, least = k, residual
        # Within the tolerance the motion may still come nearer: the segment ends at the
        # first local minimum of the residual.
        if not nearest and (least <= MET or (least <= 1.0 and not nearer)):
            break
    if least <= MET:
        return float(times[best])
    low, high = times[max(best - 1, 0)], times[min(best + 1, times.size - 1)]
    sampled = least_between(lambda near: np.array([*residuals(near)]), low, high)
    return sampled[0] if sampled[1] < least else float(times[best])


def goal_misses(
    stage: Stage, replay: Replay, tolerances: Tolerances
) -> list[LimitViolation]:
    """Largest deviations from the goal of a segment, in position and in velocity.

    Both are evaluated at the end of the segment and before its dwell; a goal that
    leaves the velocity free has no deviation in velocity. The torques that hold the arm
    at rest there follow.

    Args:
        stage: The segment.
        replay: The motion on the segment.
        tolerances: Tolerances of the goals.
    """
    rows = np.unique([np.argmin(np.abs(replay.t - stage.reached)), replay.t.size - 1])
    goal, kinematics = stage.problem.goal, RobotKinematics(stage.problem.robot)
    misses = [
        miss
        for q, v in zip(replay.q[rows], replay.v[rows], strict=True)
        for miss in goal.misses(kinematics, q, v)
    ]
    time, worst = replay.duration, []
    for kind, tolerance in (("goal", tolerances.goal), ("speed", tolerances.speed)):
        of_kind = [miss for miss in misses if miss.moving is (kind == "speed")]
        if of_kind:
            miss = max(of_kind, key=lambda miss: miss.amount)
            amount = miss.amount if replay.complete else np.inf
            violated = not amount <= tolerance
            item = kind, miss.name, time, amount, miss.unit, amount, violated
            worst.append(LimitViolation(*item))
    return [*worst, *_at_rest(stage, replay, tolerances.limits)]


def _at_rest(stage: Stage, replay: Replay, tolerance: float) -> list[LimitViolation]:
    """Excess of the torques that hold the arm where a segment ends over their limits.

    A goal that is a configuration was checked with its problem; joints without a motor
    are at rest within the tolerance of the goal, or leave it.

    Args:
        stage: The segment.
        replay: The motion on the segment.
        tolerance: Tolerated excess, as a share of half the range of the torques.
    """
    robot, (q, v) = stage.problem.robot, (replay.q[-1], replay.v[-1])
    goal = stage.problem.goal.nearest(RobotKinematics(robot), q, v)
    passes = goal.ends_moving or not goal.fixes_velocity
    if passes or goal.configuration is not None or robot.kinematic:
        return []
    torque, _ = holding(robot, q[None])
    middle, half = effort_range(robot, None)
    excess = np.where(half > 0.0, np.abs(torque - middle) - half, -np.inf)
    rows = Excesses.of_joints(robot, HOLDING, replay.t[-1:], excess, half)
    return rows.worst(tolerance)
