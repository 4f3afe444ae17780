"""Least time of an arm with one joint."""

from __future__ import annotations

import math

from tominpmp.arrays import Array
from tominpmp.bounds.one_joint import OneJoint
from tominpmp.bounds.speed_changes import least_time_of_changes
from tominpmp.bounds.swings import least_swing_time
from tominpmp.problem import Problem


def single_joint_time(
    problem: Problem, q: Array, v: Array, smooth_ends: bool
) -> float | None:
    """Time that no motion of an arm with one joint can beat; None for other arms.

    Args:
        problem: The problem.
        q: Positions at start and goal, shape (2,).
        v: Velocities there, shape (2,).
        smooth_ends: Whether accelerations that may not jump begin and end with zero.
    """
    arm = OneJoint.of(problem)
    if arm is None or not all(map(math.isfinite, (*arm.effort, arm.mass))):
        return None
    if arm.uniform:
        limits = arm.limit(1.0), arm.limit(-1.0)
        return least_time_of_changes(float(q[1] - q[0]), v, *limits, arm.velocity)
    return least_swing_time(arm, q, v)
