"""What holds along a motion: one class, in one file, for each kind of constraint."""

from __future__ import annotations

from tominpmp.constraints.base import Constraint, Partials, States
from tominpmp.constraints.clearance import ClearanceConstraint
from tominpmp.constraints.final import GoalReached
from tominpmp.constraints.joint_limits import (
    AccelerationLimit,
    JerkLimit,
    JointLimit,
    PositionLimit,
    VelocityLimit,
)
from tominpmp.constraints.path import PathConstraint
from tominpmp.constraints.tool_speed import ToolSpeed
from tominpmp.constraints.torque import (
    Motors,
    TorqueLimit,
    TorqueOverSpeed,
    TorqueRate,
)
from tominpmp.constraints.upright import KeepUpright

__all__ = [
    "AccelerationLimit",
    "ClearanceConstraint",
    "Constraint",
    "GoalReached",
    "JerkLimit",
    "JointLimit",
    "KeepUpright",
    "Motors",
    "Partials",
    "PathConstraint",
    "PositionLimit",
    "States",
    "ToolSpeed",
    "TorqueLimit",
    "TorqueOverSpeed",
    "TorqueRate",
    "VelocityLimit",
]
