"""Where the public names of the package are; read by type checkers and at import."""

from .cell.batch.dataset import (
    Dataset as Dataset,
    Outcome as Outcome,
)
from .cell.batch.plan_many import plan_many as plan_many
from .bounds.lower_bound import lower_bound as lower_bound
from .bounds.result import LowerBound as LowerBound
from .certificate.certificate import Certificate as Certificate
from .certificate.minimum_principle import certify as certify
from .combined_robots import combine_robots as combine_robots
from .constraints.coupling import JointCoupling as JointCoupling
from .constraints.held_load import FirmGrasp as FirmGrasp
from .constraints.orientation import (
    AxisFixed as AxisFixed,
    KeepOrientation as KeepOrientation,
    KeepUpright as KeepUpright,
)
from .constraints.path import PathConstraint as PathConstraint
from .constraints.stable_contact import StableContact as StableContact
from .constraints.tool_path import (
    ToolArc as ToolArc,
    ToolLine as ToolLine,
    ToolPolyline as ToolPolyline,
)
from .constraints.tool_region import (
    KeepAway as KeepAway,
    WithinRegion as WithinRegion,
)
from .constraints.tool_speed import (
    ToolAcceleration as ToolAcceleration,
    ToolSpeed as ToolSpeed,
)
from .exceptions import (
    FrameNotFound as FrameNotFound,
    JointNotFound as JointNotFound,
    MissingDependency as MissingDependency,
    OptionsError as OptionsError,
    PlanningFailed as PlanningFailed,
    ProblemError as ProblemError,
    RobotLoadError as RobotLoadError,
    ScenarioError as ScenarioError,
    SceneError as SceneError,
    SolverNotFound as SolverNotFound,
    TominpmpError as TominpmpError,
    TominpmpWarning as TominpmpWarning,
)
from .goals.base import Goal as Goal
from .goals.frames import (
    AxisGoal as AxisGoal,
    PoseGoal as PoseGoal,
    PositionGoal as PositionGoal,
    RegionGoal as RegionGoal,
)
from .goals.joints import (
    JointGoal as JointGoal,
    JointRegionGoal as JointRegionGoal,
)
from .goals.sets import (
    AllGoals as AllGoals,
    AnyGoal as AnyGoal,
)
from .files.export import load_motion as load_motion
from .files.export_check import (
    ExportCheck as ExportCheck,
    check_export as check_export,
    check_file as check_file,
)
from .files.ros import (
    Refusal as Refusal,
    controller_refusals as controller_refusals,
)
from .motion_limits import (
    EffortCurve as EffortCurve,
    MotionLimits as MotionLimits,
)
from .options import (
    Options as Options,
    Tolerances as Tolerances,
)
from .robot.payload import Payload as Payload
from .cell.placement import (
    ImprovedPlacement as ImprovedPlacement,
    improve_placement as improve_placement,
    robot_at as robot_at,
)
from .planner.planning import plan as plan
from .planner.smoothing import smooth as smooth
from .problem.problem import Problem as Problem
from .description.joint_table import JointLimits as JointLimits
from .robot.robot import (
    Robot as Robot,
    load_robot as load_robot,
)
from .motion.samples import Samples as Samples
from .files.limits import (
    MoveItLimits as MoveItLimits,
    load_joint_limits as load_joint_limits,
    load_motion_limits as load_motion_limits,
)
from .files.moveit import (
    load_moveit as load_moveit,
    load_moveit_scene as load_moveit_scene,
)
from .files.scenario import (
    Scenario as Scenario,
    load_scenario as load_scenario,
    save_scenario as save_scenario,
)
from .scene.grids import (
    HeightField as HeightField,
    OcTree as OcTree,
)
from .scene.meshes import Mesh as Mesh
from .scene.motion import (
    ConstantVelocity as ConstantVelocity,
    Motion as Motion,
    PoseFunction as PoseFunction,
    Waypoints as Waypoints,
)
from .scene.obstacles import (
    Box as Box,
    Capsule as Capsule,
    Cylinder as Cylinder,
    Obstacle as Obstacle,
    Sphere as Sphere,
)
from .scene.scene import Scene as Scene
from .problem.segments import Segment as Segment
from .solution import Solution as Solution
from .status import (
    IterationRecord as IterationRecord,
    Status as Status,
)
from .cell.tours.planning import plan_tour as plan_tour
from .cell.tours.station import (
    Station as Station,
    Visit as Visit,
)
from .cell.tours.tour import Tour as Tour
from .motion.trajectory import (
    State as State,
    Trajectory as Trajectory,
)
from .verification.clearance import (
    ClearanceProof as ClearanceProof,
    prove_clearance as prove_clearance,
)
from .verification.verification import (
    Verification as Verification,
    verify as verify,
)
from .problem.workcell import Workcell as Workcell

__version__: str
