"""Constraints along a motion: one class for each kind."""

from __future__ import annotations

from tominpmp.constraints.base import Constraint, Partials, States
from tominpmp.constraints.clearance import ClearanceConstraint
from tominpmp.constraints.coupling import JointCoupling
from tominpmp.constraints.final import Arrival, GoalReached
from tominpmp.constraints.held_load import FirmGrasp
from tominpmp.constraints.joint_limits import JointLimit
from tominpmp.constraints.orientation import AxisFixed, KeepOrientation, KeepUpright
from tominpmp.constraints.path import PathConstraint
from tominpmp.constraints.stable_contact import StableContact
from tominpmp.constraints.tool_path import ToolArc, ToolLine, ToolPolyline
from tominpmp.constraints.tool_region import KeepAway, WithinRegion
from tominpmp.constraints.tool_speed import ToolAcceleration, ToolSpeed
from tominpmp.constraints.torque import (
    MotorLimit,
    Motors,
    TorqueLimit,
    TorqueOverSpeed,
    TorqueRate,
)

__all__ = [
    "Arrival",
    "AxisFixed",
    "ClearanceConstraint",
    "Constraint",
    "FirmGrasp",
    "GoalReached",
    "JointCoupling",
    "JointLimit",
    "KeepAway",
    "KeepOrientation",
    "KeepUpright",
    "MotorLimit",
    "Motors",
    "Partials",
    "PathConstraint",
    "StableContact",
    "States",
    "ToolAcceleration",
    "ToolArc",
    "ToolLine",
    "ToolPolyline",
    "ToolSpeed",
    "TorqueLimit",
    "TorqueOverSpeed",
    "TorqueRate",
    "WithinRegion",
]
