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
accelerations may not jump, that a motion begins and ends with zero acceleration.
Motions that use the tolerances of the verification can be correspondingly shorter.
"""

from __future__ import annotations

import math

import numpy as np

from tominpmp.arrays import Array
from tominpmp.blas_threads import on_one_thread
from tominpmp.bounds.energy import energy_bounds
from tominpmp.bounds.frames import frame_bounds, tool_speed_bounds
from tominpmp.bounds.joints import joint_bounds, joints_of, reach_of
from tominpmp.bounds.result import LowerBound
from tominpmp.checks import instance, number
from tominpmp.exceptions import warn_caller
from tominpmp.goals.base import Goal
from tominpmp.problem.problem import Problem


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
    """Sum of the bounds of segments with a known start, and of all dwells.

    Velocities at ends of segments are free unless the goal fixes them. If the robot and
    its limits are the same on all segments, the bound of the whole motion to the last
    goal takes the place of a smaller sum.
    """
    total = dwells = 0.0
    start, known = problem.v_start, True
    for phase, segment in zip(problem.phases, problem.segments, strict=True):
        dwells += segment.dwell
        if known:
            total += _of_goal(phase, phase.goal, start, smooth_ends=False).T
        known = phase.goal.configuration is not None
        start = _end_velocity(phase, phase.goal)
    same = all(phase.robot is problem.robot for phase in problem.phases) and all(
        segment.motion_limits is None for segment in problem.segments
    )
    if same:
        last = problem.phases[-1].goal
        total = max(total, _of_goal(problem, last, problem.v_start).T)
    return LowerBound(
        total + dwells, "the limits of the joints on each segment, and all dwells"
    )


def _of_goal(
    problem: Problem,
    goal: Goal,
    start: Array,
    longest: float = math.inf,
    *,
    smooth_ends: bool = True,
) -> LowerBound:
    """The bound for a goal; for alternative goals the least of their bounds.

    Args:
        problem: The problem.
        goal: The goal.
        start: Velocities at the start, shape (n,); infinite where a velocity is free.
        longest: Largest time of the searches [s].
        smooth_ends: Whether accelerations that may not jump are zero at both ends.
    """
    joints, least = joints_of(problem, smooth_ends), []
    for item in goal.alternatives:
        q, ends = item.configuration, np.stack([start, _end_velocity(problem, item)])
        lower, upper = (x - problem.q_start for x in item.joint_ranges(problem.robot))
        bounds = [LowerBound(0.0, "no bound is known for a goal of this kind")]
        turning = item.angles(problem.robot)
        bounds += joint_bounds(joints, lower, upper, ends, turning)
        bounds += tool_speed_bounds(problem, item)
        if q is not None and np.all(np.isfinite(ends)):
            bounds += energy_bounds(problem, q, ends)
        reach = reach_of(joints, ends)
        for member in item.members:
            if member.frame_name is not None:
                frame = member, member.frame_name
                bounds += frame_bounds(problem, *frame, reach, longest)
        least.append(max(bounds, key=lambda bound: bound.T))
    return min(least, key=lambda bound: bound.T)


def _end_velocity(problem: Problem, goal: Goal) -> Array:
    """Final joint velocities of a goal, shape (n,); infinite where they are free."""
    n = problem.robot.n
    return goal.final_velocity(n) if goal.fixes_velocity else np.full(n, math.inf)
