"""Robots: what a description file, or the caller, says about an arm."""

from tominpmp.description.joint_table import JointLimits
from tominpmp.robot.robot import (
    DEFAULT_GRAVITY,
    Robot,
    RobotSource,
    load_robot,
    read_source,
)

__all__ = [
    "DEFAULT_GRAVITY",
    "JointLimits",
    "Robot",
    "RobotSource",
    "load_robot",
    "read_source",
]
