"""Robots: what a description file, or the caller, says about an arm."""

from tominpmp.description.joint_table import JointLimits
from tominpmp.robot.loading import DEFAULT_GRAVITY, load_robot
from tominpmp.robot.robot import Robot

__all__ = ["DEFAULT_GRAVITY", "JointLimits", "Robot", "load_robot"]
