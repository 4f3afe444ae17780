r"""Lower bounds on the duration of any motion that solves a problem.

The bounds hold for any path, as obstacles, detours and constraints are ignored. The
result is the largest of the bounds from

- single joints (:mod:`~tominpmp.bounds.joints`): the displacement of a joint at its
  limits of speed, acceleration and jerk; for an arm with one joint also at its torques;
- frames (:mod:`~tominpmp.bounds.frames`): a frame moves no farther than its joints
  carry it, and no faster than its speed limit;
- energy (:mod:`~tominpmp.bounds.energy`): the work of the torques on arms whose rotors
  have inertia.

The bounds assume the robot dynamics of the replay, torques within the allowed share of
their limits and below the torque-speed curves, payloads as part of the robot, and, if
accelerations may not jump, that a motion begins and ends with zero acceleration; limits
of jerk and torque rate do not count if the problem has accelerations at the start.
Motions that use the tolerances of the verification can be correspondingly shorter.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.blas_threads import on_one_thread
from tominpmp.bounds.energy import energy_bounds
from tominpmp.bounds.frames import frame_bounds, tool_speed_bounds
from tominpmp.bounds.joints import joint_bounds, joints_of, reach_of, tightest_limits
from tominpmp.bounds.least_time import SHARE, TOLERANCE
from tominpmp.bounds.result import LowerBound
from tominpmp.checks import instance, number
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import warn_caller
from tominpmp.goals.base import Goal
from tominpmp.goals.turns import TURN
from tominpmp.kinematics import units_of
from tominpmp.motion_limits import EFFORT
from tominpmp.problem.joint_limits import effort_range
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import arrival_window

# A time this close to a tick of a clock counts as the tick, in shares of the period.
ROUNDED = 1e-6
# No joints begin or end any number of turns away.
NO_TURNS = np.zeros(1, dtype=bool)


@on_one_thread
def lower_bound(
    problem: Problem, *, known: float = math.inf, quick: bool | None = None
) -> LowerBound:
    """Find a lower bound on the duration of all motions that solve a problem.

    Args:
        problem: The problem.
        known: Duration of a motion that solves the problem [s], as an upper end of the
            searches, not used for segments; infinite if no motion is known.
        quick: Without effect, as the bounds of arms with two joints were removed: it
            causes a warning until the next release.

    Returns:
        The largest bound.

    Raises:
        ProblemError: If the problem is not a problem, or the known duration is not
            positive.
    """
    instance(problem, Problem, "problem")
    if quick is not None:
        warn_caller("lower_bound: quick has no effect, as all bounds are quick")
    longest = number(known, "known", "seconds > 0", above=0.0, infinite=True)
    if problem.segments:
        return _of_segments(problem)
    return _of_goal(problem, problem.goal, problem.v_start, longest)


def _of_segments(problem: Problem) -> LowerBound:
    """The bound of the last arrival and its dwell, or that of the last goal alone.

    The latter counts if the robot and its limits are the same on all segments.
    """
    *_, bound = _arrival_bounds(problem)
    total = bound.T + problem.segments[-1].dwell
    same = all(phase.robot is problem.robot for phase in problem.phases) and all(
        segment.motion_limits is None for segment in problem.segments
    )
    if same:
        last = problem.phases[-1].goal
        turned = last.angles(problem.robot)
        total = max(total, _of_goal(problem, last, problem.v_start, turned=turned).T)
    return LowerBound(total, "the limits of the joints on each segment, and all dwells")


def _arrival_bounds(problem: Problem) -> Iterator[LowerBound]:
    """Bounds on the arrival at the goal of each segment, from the start of the motion.

    They are the sums of the bounds of segments with a known start, and of the dwells
    before. Velocities at ends of segments are free unless the goal fixes them. The turn
    of an angle in which a segment begins is known for the first segment only.
    """
    begin, start, known, turned = 0.0, problem.v_start, True, NO_TURNS
    for phase, segment in zip(problem.phases, problem.segments, strict=True):
        bound = LowerBound(0.0, "")
        if known:
            bound = _of_goal(phase, phase.goal, start, smooth_ends=False, turned=turned)
        earliest, _ = arrival_window(segment)
        arrival = max(begin + bound.T, earliest)
        yield replace(bound, T=arrival)
        begin = arrival + segment.dwell
        known = phase.goal.configuration is not None
        turned = phase.goal.angles(phase.robot) & bool(phase.goal.alternatives[1:])
        start = _end_velocity(phase, phase.goal)


def why_impossible(
    problem: Problem, tolerance: float, period: float | None = None
) -> str:
    """Proof by the limits of joints and tools that no motion exists, in a sentence.

    Args:
        problem: The problem.
        tolerance: Excess over limits that is tolerated, as a share.
        period: Period of the clock on which segments end [s]; None without a clock.

    Returns:
        The sentence; empty without a proof.
    """
    why = _beyond_motors(problem, tolerance) or _too_close_to_limit(problem)
    why = why or _late_arrival(problem, tolerance, period)
    return why and f"No motion exists: {why}."


def _late_arrival(problem: Problem, tolerance: float, period: float | None) -> str:
    """The first segment whose window of arrival no motion can meet; or empty."""
    windows = [arrival_window(segment) for segment in problem.segments]
    if all(latest == math.inf for _, latest in windows):
        return ""
    each = zip(windows, _arrival_bounds(problem), strict=True)
    for k, ((earliest, latest), bound) in enumerate(each, 1):
        if period and np.floor(latest / period + ROUNDED) < earliest / period - ROUNDED:
            return (
                f"the window of arrival of segment {k}, {earliest:.10g} to "
                f"{latest:.10g} s, holds no multiple of the control period {period:g} s"
            )
        if bound.T > (1.0 + 2.0 * tolerance) * latest:
            why = f": {bound.reason}" if k == 1 else ", by its joint limits and dwells"
            return (
                f"the goal of segment {k} is to be reached by {latest:.4g} s, and no "
                f"motion gets there before {bound.T:.4g} s{why}"
            )
    return ""


def _beyond_motors(problem: Problem, tolerance: float) -> str:
    """The first joint without the torque for the acceleration at the start; or empty.

    It needs this torque where accelerations may not jump. Dry friction may help it.
    """
    robot, limits = problem.phases[0].robot, problem.phases[0].motion_limits
    if limits is None or not limits.continuous:
        return ""
    start = problem.q_start[None], problem.v_start[None], problem.a_start[None]
    (needed,) = RobotDynamics(robot, dry=False).inverse(*start)
    middle, half = effort_range(robot, limits)
    most = (1.0 + 2.0 * tolerance) * half + robot.friction
    for i in np.flatnonzero(np.abs(needed - middle) > most).tolist():
        return (
            f"joint {robot.joint_names[i]!r} needs {needed[i]:.4g} "
            f"{units_of(robot, EFFORT)[i]} for its acceleration at the start, "
            f"[{middle[i] - half[i]:.4g}, {middle[i] + half[i]:.4g}] allowed"
        )
    return ""


def _too_close_to_limit(problem: Problem) -> str:
    """The first joint too close to a position limit to stop, or to reach a speed.

    On a segment that a joint passes in one direction it may be at the limit. Empty
    without such a joint.
    """
    q: Array | None = problem.q_start
    v, many = problem.v_start, len(problem.phases) > 1
    for k, phase in enumerate(problem.phases, 1):
        goal, limits = phase.goal, phase.robot.limits
        q_end, w = goal.configuration, _end_velocity(phase, goal)
        if goal.alternatives[1:]:
            q_end, w = None, np.full(v.size, math.inf)
        most = tightest_limits(phase)["a"]
        returns = np.isfinite(v) & np.isfinite(w) & (np.sign(v) * np.sign(w) <= 0.0)
        ends = (q, v, v, "start", "stop"), (q_end, w, -w, "goal", "reach this speed")
        for place, speed, way, end, verb in ends:
            if place is None:
                continue
            limit = np.where(way > 0.0, limits.position_upper, limits.position_lower)
            left = np.abs(limit - place)
            needed = 0.5 * np.where(returns, speed, 0.0) ** 2 / np.maximum(most, 1e-9)
            lacking = needed * (1.0 - SHARE) > left + TOLERANCE
            for i in np.flatnonzero(lacking).tolist():
                unit = units_of(phase.robot)[i]
                return (
                    f"joint {phase.robot.joint_names[i]!r} has {abs(speed[i]):.4g} "
                    f"{unit}/s at the {end}{f' of segment {k}' * many}, {left[i]:.4g} "
                    f"{unit} from its position limit of {limit[i]:.4g} {unit}, and "
                    f"needs {needed[i]:.4g} {unit} to {verb}"
                )
        q, v = q_end, w
    return ""


def _of_goal(
    problem: Problem,
    goal: Goal,
    start: Array,
    longest: float = math.inf,
    *,
    smooth_ends: bool = True,
    turned: BoolArray = NO_TURNS,
) -> LowerBound:
    """The bound for a goal; for alternative goals the least of their bounds.

    Args:
        problem: The problem.
        goal: The goal.
        start: Velocities at the start, shape (n,); infinite where a velocity is free.
        longest: Largest time of the searches [s].
        smooth_ends: Whether accelerations that may not jump are zero at both ends.
        turned: Joints that may begin or end any number of turns away from the positions
            of the problem and the goal, shape (n,) or (1,).
    """
    still = not np.any(problem.a_start)
    joints, least = joints_of(problem, smooth_ends and still), []
    for item in goal.alternatives:
        q, ends = item.configuration, np.stack([start, _end_velocity(problem, item)])
        lower, upper = (x - problem.q_start for x in item.joint_ranges(problem.robot))
        bounds = [LowerBound(0.0, "no bound above zero is known")]
        # An angle at rest takes the nearest turn; a moving one may take a further turn.
        turning = turned | (item.angles(problem.robot) & np.any(ends != 0.0, axis=0))
        bounds += joint_bounds(joints, lower, upper, ends, turning)
        bounds += tool_speed_bounds(problem, item)
        if q is not None and np.all(np.isfinite(ends)):
            turns = np.where(turned, np.round((q - problem.q_start) / TURN), 0.0)
            bounds += energy_bounds(problem, q - TURN * turns, ends)
        reach = reach_of(joints, ends)
        for member in item.members:
            if member.frame_name is not None and not np.any(turned):
                frame = member, member.frame_name
                bounds += frame_bounds(problem, *frame, reach, longest)
        least.append(max(bounds, key=lambda bound: bound.T))
    return min(least, key=lambda bound: bound.T)


def _end_velocity(problem: Problem, goal: Goal) -> Array:
    """Final joint velocities of a goal, shape (n,); infinite where they are free."""
    n = problem.robot.n
    return goal.final_velocity(n) if goal.fixes_velocity else np.full(n, math.inf)
