"""What torques make of an arm with one joint: its minimum time.

Its inertia does not change, so that its acceleration is what torque, friction and
gravity leave at its speed. Where gravity acts alike wherever the joint is, as on a
rail, speeding up to a peak and slowing down is the fastest motion there is. That of a
pendulum is taken to pull either way as strongly as it does anywhere.
"""

from __future__ import annotations

import math

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.energy import effort_bounds
from tominpmp.bounds.least_time import Both, Change, Drive, Ramp, SpeedLaw
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import prismatic_joints
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem import Problem
from tominpmp.robot import Robot


def torque_drive(problem: Problem, smooth_ends: bool) -> Drive | None:
    """What torques and limits make of an arm with one joint; None for other arms.

    Args:
        problem: The problem.
        smooth_ends: Whether accelerations that may not jump are zero at both ends.
    """
    robot, more = problem.robot, problem.motion_limits or MotionLimits()
    if robot.n != 1 or robot.expansion_matrix is not None:
        return None
    effort = np.concatenate(effort_bounds(problem))
    if not np.all(np.isfinite(effort)):
        return None
    names = robot.joint_names
    kinds = ("acceleration", "jerk", "effort_rate")
    acceleration, jerk, rate = (float(more.by_joint(k, names)[0]) for k in kinds)
    top = float(robot.limits.velocity[0])
    mass, mean, wave = _inertia_and_weight(robot)

    def law(sign: float, torque: float) -> SpeedLaw:
        """Largest acceleration one way, over the speed that way."""
        limit = SpeedLaw.line(torque)
        curve = (more.effort_curves or {}).get(names[0])
        if curve is not None:
            limit = limit.lower_of(_over_speed(curve.speed, curve.effort))
        dry, viscous = float(robot.friction[0]), float(robot.damping[0])
        against = np.array([dry, -dry]) + wave - sign * mean
        load = SpeedLaw(np.zeros(1), against, np.full(2, -viscous))
        total = limit.plus(load)
        total = SpeedLaw(total.knots, total.level / mass, total.slope / mass)
        if math.isfinite(acceleration):
            total = total.lower_of(SpeedLaw.line(acceleration))
        return total

    def smooth(item: SpeedLaw) -> Change:
        """The same with what limits of jerk and torque rate leave of it."""
        most = item.highest(top)
        # Friction and gravity change the torque beside its rate.
        changes = ((float(robot.damping[0]), most), (wave, top))
        beside = sum(factor * by for factor, by in changes if factor > 0.0)
        fastest = min(jerk, (rate + beside) / mass)
        return Both(item, Ramp(most, fastest)) if smooth_ends else item

    ahead, back = law(1.0, float(effort[1])), law(-1.0, -float(effort[0]))
    return Drive(
        (smooth(ahead), smooth(back.reflected)),
        (smooth(back), smooth(ahead.reflected)),
        top,
    )


def _inertia_and_weight(robot: Robot) -> tuple[float, float, float]:
    """Inertia, the mean torque of gravity, and how far it is from that at most."""
    dynamics = RobotDynamics(robot)
    q = np.array([[0.0], [0.5 * math.pi], [math.pi]])
    rest = np.zeros_like(q)
    mass = float(dynamics.inertial(q[:1], np.ones((1, 1)))[0, 0])
    first, middle, last = dynamics.inverse(q, rest, rest)[:, 0].tolist()
    if prismatic_joints(robot)[0]:
        return mass, first, 0.0
    mean = 0.5 * (first + last)
    return mass, mean, math.hypot(first - mean, middle - mean)


def _over_speed(speed: Array, effort: Array) -> SpeedLaw:
    """Torque over the absolute speed, which stays as it is at the last one."""
    slope = np.append(np.diff(effort) / np.diff(speed), 0.0)
    one = SpeedLaw(speed[1:], effort - slope * speed, slope)
    other = one.reflected
    return SpeedLaw(
        np.concatenate([other.knots, [0.0], one.knots]),
        np.concatenate([other.level, one.level]),
        np.concatenate([other.slope, one.slope]),
    )
