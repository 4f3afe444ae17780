"""Controls of the motions of a problem: torques, or accelerations of a kinematic robot.

A kinematic robot is a double integrator whose controls are its joint accelerations:
acceleration limits bound its controls as torque limits bound those of other robots.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import Array
from tominpmp.dynamics import RobotDynamics
from tominpmp.motion_limits import (
    ACCELERATION,
    CONTROL_ACCELERATION,
    EFFORT,
    LimitKind,
    MotionLimits,
)

if TYPE_CHECKING:
    from tominpmp.motion.trajectory import State
    from tominpmp.robot.robot import Robot

# Accelerations and jerks beyond this count as unlimited, and accelerations below its
# inverse as this inverse [rad/s^2, rad/s^3].
MOST = 1e9


def control_kind(robot: Robot) -> LimitKind:
    """Kind of the limits on the controls of a robot: torque or acceleration limits."""
    return CONTROL_ACCELERATION if robot.kinematic else EFFORT


def control_bounds(robot: Robot, limits: MotionLimits | None) -> tuple[Array, Array]:
    """Least and largest torques of a robot, or accelerations of a kinematic one.

    Args:
        robot: The robot.
        limits: Motion limits in addition to the limits of its description.

    Returns:
        Shape (n,) each [N m or N, rad/s^2 or m/s^2].
    """
    if not robot.kinematic:
        return robot.limits.effort_lower, robot.limits.effort_upper
    most = (limits or MotionLimits()).by_joint("acceleration", robot.joint_names)
    return -most, most


def effort_range(robot: Robot, limits: MotionLimits | None) -> tuple[Array, Array]:
    """Middle of the torque range of a robot, and half of its width.

    Torque-speed curves are not part of this range.

    Args:
        robot: The robot.
        limits: Motion limits in addition to the limits of its description, of which
            their ``effort_scale`` leaves a share.

    Returns:
        Shape (n,) each [N m or N]; accelerations for a kinematic robot [rad/s^2 or
        m/s^2].
    """
    lower, upper = control_bounds(robot, limits)
    share = 0.5 if limits is None else 0.5 * limits.effort_scale
    return share * (lower + upper), share * (upper - lower)


def accelerations_alone(robot: Robot, limits: MotionLimits | None, q: Array) -> Array:
    """Accelerations that limits allow each joint, if the other joints rest.

    Where torques limit them, these are estimates: the torque that gravity leaves, over
    the inertia at the joint.

    Args:
        robot: The robot.
        limits: Motion limits in addition to the limits of its description.
        q: Configurations, shape (k, n) [rad or m].

    Returns:
        Shape (k, n) [rad/s^2 or m/s^2].
    """
    dynamics, rest = RobotDynamics(robot), np.zeros_like(q)
    _, half = effort_range(robot, limits)
    weight = np.abs(dynamics.inverse(q, rest, rest))
    inertia = np.diagonal(dynamics.mass(q), axis1=1, axis2=2)
    spare = np.maximum(half - weight, 0.1 * half)
    most = (limits or MotionLimits()).by_joint("acceleration", robot.joint_names)
    return np.minimum(spare / np.maximum(inertia, 1e-9), most)


def durations_alone(
    robot: Robot, limits: MotionLimits | None, q: Array, change: Array
) -> Array:
    """Durations that changes of velocity take each joint, if the other joints rest.

    Args:
        robot: The robot.
        limits: Motion limits in addition to the limits of its description.
        q: Configuration, shape (n,) [rad or m].
        change: Amounts of the changes, shape (n,) [rad/s or m/s].

    Returns:
        Shape (n,) [s].
    """
    jerk = (limits or MotionLimits()).by_joint("jerk", robot.joint_names)
    jerk = np.minimum(jerk, MOST)
    alone = accelerations_alone(robot, limits, q[None])[0]
    a = np.clip(np.minimum(alone, np.sqrt(change * jerk)), 1.0 / MOST, MOST)
    return np.asarray(change / a + a / jerk)


def controls_in(robot: Robot, state: State) -> Array:
    """Controls of a robot in states of a motion: torques, or accelerations."""
    return state.a if robot.kinematic else state.u


def need_smooth(robot: Robot, limits: MotionLimits | None) -> bool:
    """Whether motion limits rule out controls that jump.

    Acceleration limits alone do not for a kinematic robot: they bound its controls.
    """
    bounded = [] if limits is None else limits._bounded
    return bool(bounded) and not (robot.kinematic and bounded == [ACCELERATION])
