"""Least time of an arm with one joint."""

from __future__ import annotations

import math

from tominpmp.arrays import Array
from tominpmp.bounds.joint_limits import jerk_limited_time
from tominpmp.bounds.one_joint import OneJoint
from tominpmp.bounds.smooth_changes import least_time_of_smooth_changes
from tominpmp.bounds.speed_changes import least_time_of_changes
from tominpmp.bounds.swings import least_swing_time
from tominpmp.problem import Problem

# Halvings of an interval of times.
HALVINGS = 30


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
    smooth = smooth_ends and math.isfinite(min(arm.jerk, arm.effort_rate))
    times = [_smooth_time(arm, q, v)] if smooth else []
    if not arm.uniform:
        return max([least_swing_time(arm, q, v), *times])
    way, limits = float(q[1] - q[0]), (arm.limit(1.0), arm.limit(-1.0))
    if smooth and (arm.damping > 0.0 or arm.curve is not None):
        rates = arm.jerk, arm.effort_rate / arm.mass, arm.damping / arm.mass
        times.append(least_time_of_smooth_changes(way, v, limits, arm.velocity, rates))
    return max([least_time_of_changes(way, v, *limits, arm.velocity), *times])


def _smooth_time(arm: OneJoint, q: Array, v: Array) -> float:
    """Bound from limits of jerk and torque rate, and the largest accelerations.

    It is the minimum where nothing depends on the speed or the position: viscous
    friction and gravity change the torque, and so the jerk that its rate allows. A
    joint with dry friction and only one way to go is taken not to turn back on it.
    """
    side = 1.0 if q[1] >= q[0] else -1.0
    if min(side * v) < 0.0:
        return 0.0
    constant, *waves = arm.weight
    wave = math.hypot(*waves)
    # Whoever only goes on has dry friction against him all the way.
    dry = side * arm.friction
    up = (arm.effort[1] - constant + wave - dry) / arm.mass
    down = (constant + wave + dry - arm.effort[0]) / arm.mass
    if min(up, down) <= 0.0:
        return 0.0
    way, speed = float(q[1] - q[0]), float(max(abs(v)))

    def least(T: float) -> float:
        """Least time of motions that take no longer than T."""
        push = min(up if side > 0.0 else down, arm.acceleration)
        fastest = min(arm.velocity, speed + push * T)
        # Viscous friction helps to brake, and torque follows speed and place.
        helped = arm.damping * fastest / arm.mass
        both = (up, down + helped) if side > 0.0 else (up + helped, down)
        both = min(both[0], arm.acceleration), min(both[1], arm.acceleration)
        drift = arm.damping * max(both) + wave * fastest
        jerk = min(arm.jerk, (arm.effort_rate + drift) / arm.mass)
        return jerk_limited_time(way, v, arm.velocity, both, jerk)

    low, high = 0.0, least(0.0)
    if least(high) >= high:
        return high
    for _ in range(HALVINGS):
        T = 0.5 * (low + high)
        low, high = (T, high) if least(T) >= T else (low, T)
    return low
