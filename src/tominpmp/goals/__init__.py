"""Goals: what must hold at the end of a motion (paper, equations 5 and 8).

A goal is data; its residual a(x(T)) and the derivatives are evaluated on kinematics,
and have to end within bounds, which are zero unless the goal has a tolerance. A motion
ends at rest unless a final velocity is given.
"""

from tominpmp.goals.base import Goal
from tominpmp.goals.frames import (
    AxisGoal,
    FrameGoal,
    PoseGoal,
    PositionGoal,
    RegionGoal,
)
from tominpmp.goals.joints import JointGoal, JointRegionGoal
from tominpmp.goals.place import Label, Place, Scales
from tominpmp.goals.sets import AllGoals, AnyGoal, passed

__all__ = [
    "AllGoals",
    "AnyGoal",
    "AxisGoal",
    "FrameGoal",
    "Goal",
    "JointGoal",
    "JointRegionGoal",
    "Label",
    "Place",
    "PoseGoal",
    "PositionGoal",
    "RegionGoal",
    "Scales",
    "passed",
]
