"""Robots: what a description file, or the caller, says about an arm."""

from tominpmp.description.joint_table import JointLimits
from tominpmp.robot.loading import DEFAULT_GRAVITY, RobotSource, load_robot, read_source
from tominpmp.robot.robot import Robot

__all__ = [
    "DEFAULT_GRAVITY",
    "JointLimits",
    "Robot",
    "RobotSource",
    "load_robot",
    "read_source",
]
