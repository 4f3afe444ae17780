r"""Lower bounds on the duration of any motion that solves a problem.

The bounds hold for all motions: obstacles, detours and constraints are ignored, so that
they hold for any path. The largest bound counts, of

- joints, each by itself (:mod:`~tominpmp.bounds.joints`): its way at its limits of
  speed, acceleration and jerk; of an arm with one joint also by its torques;
- frames (:mod:`~tominpmp.bounds.frames`): a frame moves no farther than its joints
  carry it, and no faster than its limit;
- energy (:mod:`~tominpmp.bounds.energy`): the work of the torques on arms whose rotors
  have inertia.

Assumed are the robot's dynamics as they are replayed, torques within the share of their
limits and below their curves over speed, payloads as part of the robot, and, where
accelerations may not jump, that a motion begins and ends without acceleration. Motions
that use the tolerance of the verification can be shorter by as much.
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
    """Find a time that no motion which solves a problem can beat.

    Args:
        problem: The problem.
        known: Duration of a motion that solves it, if known [s]: an upper end of the
            searches.
        quick: Without effect, as the bounds of arms with two joints were removed: a
            warning says so, until the next release.

    Returns:
        The largest bound.

    Raises:
        ProblemError: If the known duration is not positive.
    """
    instance(problem, Problem, "problem")
    if quick is not None:
        warn_caller("lower_bound: quick has no effect, as all bounds that are left are")
    longest = number(known, "known", "seconds > 0", above=0.0, infinite=True)
    if problem.segments:
        return _of_segments(problem)
    return _of_goal(problem, problem.goal, problem.v_start, longest)


def _of_segments(problem: Problem) -> LowerBound:
    """Sum of the bounds of segments between two configurations, and of all dwells.

    Velocities at ends of segments that are not given may have any value.
    """
    total = stays = 0.0
    start, known = problem.v_start, True
    for phase, segment in zip(problem.phases, problem.segments, strict=True):
        stays += segment.dwell
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
        total + stays, "what joints can do on each segment, and all stays"
    )


def _of_goal(
    problem: Problem,
    goal: Goal,
    start: Array,
    longest: float = math.inf,
    *,
    smooth_ends: bool = True,
) -> LowerBound:
    """The bound for a goal; for a set of alternatives the least of their bounds.

    Args:
        problem: The problem.
        goal: The goal.
        start: Velocities at the start, shape (n,); infinite for any.
        longest: Longest time of the searches [s].
        smooth_ends: Whether accelerations that may not jump begin and end with zero.
    """
    joints, bounds = joints_of(problem, smooth_ends), []
    for one in goal.alternatives:
        q, ends = one.configuration, np.stack([start, _end_velocity(problem, one)])
        lower, upper = (x - problem.q_start for x in one.joint_ranges(problem.robot))
        found = [LowerBound(0.0, "no bound is known for a goal of this kind")]
        found += joint_bounds(joints, lower, upper, ends)
        found += tool_speed_bounds(problem, one)
        if q is not None and np.all(np.isfinite(ends)):
            found += energy_bounds(problem, q, ends)
        reach = reach_of(joints, ends)
        for member in one.members:
            if member.frame_name is not None:
                place = member, member.frame_name
                found += frame_bounds(problem, *place, reach, longest)
        bounds.append(max(found, key=lambda bound: bound.T))
    return min(bounds, key=lambda bound: bound.T)


def _end_velocity(problem: Problem, goal: Goal) -> Array:
    """Velocities that a goal asks for, shape (n,); infinite where any will do."""
    n = problem.robot.n
    return goal.final_velocity(n) if goal.fixes_velocity else np.full(n, math.inf)
