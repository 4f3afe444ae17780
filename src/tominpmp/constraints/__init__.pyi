"""Where the names of the package are; read by type checkers and at import."""

from .base import (
    Constraint as Constraint,
    Partials as Partials,
    States as States,
)
from .clearance import ClearanceConstraint as ClearanceConstraint
from .coupling import JointCoupling as JointCoupling
from .final import (
    Arrival as Arrival,
    GoalReached as GoalReached,
)
from .held_load import FirmGrasp as FirmGrasp
from .joint_limits import JointLimit as JointLimit
from .orientation import (
    AxisFixed as AxisFixed,
    KeepOrientation as KeepOrientation,
    KeepUpright as KeepUpright,
)
from .path import PathConstraint as PathConstraint
from .stable_contact import StableContact as StableContact
from .tool_path import (
    ToolArc as ToolArc,
    ToolLine as ToolLine,
    ToolPolyline as ToolPolyline,
)
from .tool_region import (
    KeepAway as KeepAway,
    WithinRegion as WithinRegion,
)
from .tool_speed import (
    ToolAcceleration as ToolAcceleration,
    ToolSpeed as ToolSpeed,
)
from .torque import (
    MotorLimit as MotorLimit,
    Motors as Motors,
    TorqueLimit as TorqueLimit,
    TorqueOverSpeed as TorqueOverSpeed,
    TorqueRate as TorqueRate,
)
