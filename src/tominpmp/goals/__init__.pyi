"""Where the names of the package are; read by type checkers and at import."""

from .base import Goal as Goal
from .frames import (
    AxisGoal as AxisGoal,
    FrameGoal as FrameGoal,
    PoseGoal as PoseGoal,
    PositionGoal as PositionGoal,
    RegionGoal as RegionGoal,
)
from .joints import (
    JointGoal as JointGoal,
    JointRegionGoal as JointRegionGoal,
)
from .place import (
    Label as Label,
    Place as Place,
    Scales as Scales,
)
from .sets import (
    AllGoals as AllGoals,
    AnyGoal as AnyGoal,
    passed as passed,
)
