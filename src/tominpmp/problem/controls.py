"""What drives the motions of a problem: torques, or accelerations of a kinematic robot.

A kinematic robot is a double integrator whose controls are its accelerations: their
limits are to it what limits of torques are to others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tominpmp.arrays import Array
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


def control_kind(robot: Robot) -> LimitKind:
    """Kind of the limits of what drives a robot."""
    return CONTROL_ACCELERATION if robot.kinematic else EFFORT


def control_bounds(robot: Robot, limits: MotionLimits | None) -> tuple[Array, Array]:
    """Least and largest torques of a robot, or accelerations of a kinematic one.

    Args:
        robot: The robot.
        limits: Limits beyond those of its description.

    Returns:
        Shape (n,) each [N m or N, rad/s^2 or m/s^2].
    """
    if not robot.kinematic:
        return robot.limits.effort_lower, robot.limits.effort_upper
    most = (limits or MotionLimits()).by_joint("acceleration", robot.joint_names)
    return -most, most


def effort_range(robot: Robot, limits: MotionLimits | None) -> tuple[Array, Array]:
    """Middle of the torques that motions may use at rest, and half of their range.

    Args:
        robot: The robot.
        limits: Limits beyond those of its description, whose ``effort_scale`` leaves a
            share of the torques.

    Returns:
        Shape (n,) each [N m or N]; of a kinematic robot they are accelerations.
    """
    lower, upper = control_bounds(robot, limits)
    half = 0.5 * (upper - lower)
    if limits is not None:
        half = limits.effort_scale * half
    return 0.5 * (lower + upper), half


def controls_in(robot: Robot, state: State) -> Array:
    """What drives a robot in states of a motion: torques, or accelerations."""
    return state.a if robot.kinematic else state.u


def need_smooth(robot: Robot, limits: MotionLimits | None) -> bool:
    """Whether motion limits ask for more than controls that may jump."""
    if limits is None or not limits.need_smooth:
        return False
    return not (robot.kinematic and limits._bounded == [ACCELERATION])
