"""What drives the motions of a problem: torques, or accelerations of a kinematic robot.

A kinematic robot is a double integrator whose controls are its accelerations: their
limits are to it what limits of torques are to others.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.description.joint_table import example_values
from tominpmp.exceptions import ProblemError
from tominpmp.motion.trajectory import State
from tominpmp.motion_limits import (
    ACCELERATION,
    CONTROL_ACCELERATION,
    EFFORT,
    LimitKind,
    MotionLimits,
    kinds_of,
)
from tominpmp.robot import Robot
from tominpmp.robot.robot import datasheet_hint


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


def controls_in(robot: Robot, state: State) -> Array:
    """What drives a robot in states of a motion: torques, or accelerations."""
    return state.a if robot.kinematic else state.u


def need_smooth(robot: Robot, limits: MotionLimits | None) -> bool:
    """Whether motion limits ask for more than controls that may jump."""
    if limits is None or not limits.need_smooth:
        return False
    return not (robot.kinematic and limits._given == [ACCELERATION])


def check_controls(robot: Robot, limits: MotionLimits | None) -> None:
    """Check that a kinematic robot has limits of accelerations, and none of torques.

    Args:
        robot: The robot.
        limits: Limits beyond those of its description.

    Raises:
        ProblemError: Naming all joints without a limit, or the limit of torques.
    """
    if not robot.kinematic:
        return
    limits = limits or MotionLimits()
    kinds = kinds_of(limits).items()
    wrong = [k for k, kind in kinds if kind.of_torques and kind in limits._given]
    wrong += ["effort_scale"] if limits.effort_scale < 1.0 else []
    if wrong:
        raise ProblemError(
            f"motion_limits: {', '.join(wrong)} is given, expected none: a kinematic "
            "robot has no torques",
            "motion_limits",
        )
    _, most = control_bounds(robot, limits)
    joints = [robot.joint_names[i] for i in np.flatnonzero(np.isinf(most))]
    if joints:
        raise ProblemError(
            f"motion_limits: no acceleration limit for {', '.join(joints)}, and a "
            f"kinematic robot needs one: give acceleration={example_values(joints)}, "
            "as MotionLimits or a joint_limits.yaml have it, or load a description "
            "with its dynamics, without kinematic=True"
            f"{datasheet_hint(robot, joints[0])}",
            "motion_limits",
        )
