"""Time-optimal motions of robot manipulators, planned from their URDF.

import tominpmp as tm

robot = tm.load_robot("panda", locked_joints={"panda_finger_joint1": 0.04})
problem = tm.Problem(robot, q_start, tm.JointGoal(q_goal))
solution = tm.plan(problem)
print(solution.T, solution.trajectory(0.1).q)
"""

from __future__ import annotations

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tominpmp.batch import Dataset, Outcome, plan_many
    from tominpmp.bounds import LowerBound, lower_bound
    from tominpmp.certificate import Certificate, certify
    from tominpmp.combined_robots import combine_robots
    from tominpmp.constraints import (
        AxisFixed,
        FirmGrasp,
        JointCoupling,
        KeepAway,
        KeepOrientation,
        KeepUpright,
        PathConstraint,
        StableContact,
        ToolAcceleration,
        ToolArc,
        ToolLine,
        ToolPolyline,
        ToolSpeed,
        WithinRegion,
    )
    from tominpmp.exceptions import (
        FrameNotFound,
        JointNotFound,
        MissingDependency,
        OptionsError,
        PlanningFailed,
        ProblemError,
        RobotLoadError,
        ScenarioError,
        SceneError,
        SolverNotFound,
        TominpmpError,
        TominpmpWarning,
    )
    from tominpmp.goals import (
        AllGoals,
        AnyGoal,
        AxisGoal,
        Goal,
        JointGoal,
        JointRegionGoal,
        PoseGoal,
        PositionGoal,
        RegionGoal,
    )
    from tominpmp.io.export import load_motion
    from tominpmp.io.export_check import ExportCheck, check_export, check_file
    from tominpmp.io.ros_rules import Refusal, controller_refusals
    from tominpmp.motion_limits import EffortCurve, MotionLimits
    from tominpmp.options import Options, Tolerances
    from tominpmp.payload import Payload
    from tominpmp.placement import ImprovedPlacement, improve_placement, robot_at
    from tominpmp.planner.planning import plan
    from tominpmp.planner.smoothing import smooth
    from tominpmp.problem import Problem
    from tominpmp.robot import JointLimits, Robot, load_robot
    from tominpmp.samples import Samples
    from tominpmp.scenario.joint_limits import MoveItLimits, load_joint_limits
    from tominpmp.scenario.motion_limits import load_motion_limits
    from tominpmp.scenario.moveit import load_moveit, load_moveit_scene
    from tominpmp.scenario.scenario import Scenario, load_scenario, save_scenario
    from tominpmp.scene import (
        Box,
        Capsule,
        ConstantVelocity,
        Cylinder,
        HeightField,
        Mesh,
        Motion,
        Obstacle,
        OcTree,
        PoseFunction,
        Scene,
        Sphere,
        Waypoints,
    )
    from tominpmp.segments import Segment
    from tominpmp.solution import Solution
    from tominpmp.status import IterationRecord, Status
    from tominpmp.tours import Station, Tour, Visit, plan_tour
    from tominpmp.trajectory import State, Trajectory
    from tominpmp.verification import (
        ClearanceProof,
        Verification,
        prove_clearance,
        verify,
    )
    from tominpmp.workcell import Workcell

# Where the public names are: a module is imported when one of its names is first used,
# so that the command line shows its help without loading the robotics libraries.
_HOMES = {
    "batch": ("Dataset", "Outcome", "plan_many"),
    "bounds": ("LowerBound", "lower_bound"),
    "certificate": ("Certificate", "certify"),
    "combined_robots": ("combine_robots",),
    "constraints": (
        "AxisFixed",
        "FirmGrasp",
        "JointCoupling",
        "StableContact",
        "KeepAway",
        "KeepOrientation",
        "KeepUpright",
        "PathConstraint",
        "ToolAcceleration",
        "ToolArc",
        "ToolLine",
        "ToolPolyline",
        "ToolSpeed",
        "WithinRegion",
    ),
    "exceptions": (
        "FrameNotFound",
        "JointNotFound",
        "MissingDependency",
        "OptionsError",
        "PlanningFailed",
        "ProblemError",
        "RobotLoadError",
        "ScenarioError",
        "SceneError",
        "SolverNotFound",
        "TominpmpError",
        "TominpmpWarning",
    ),
    "goals": (
        "AllGoals",
        "AnyGoal",
        "AxisGoal",
        "Goal",
        "JointGoal",
        "JointRegionGoal",
        "PoseGoal",
        "PositionGoal",
        "RegionGoal",
    ),
    "motion_limits": (
        "EffortCurve",
        "MotionLimits",
    ),
    "options": (
        "Options",
        "Tolerances",
    ),
    "io.export": ("load_motion",),
    "io.export_check": ("ExportCheck", "check_export", "check_file"),
    "io.ros_rules": ("Refusal", "controller_refusals"),
    "payload": ("Payload",),
    "placement": ("ImprovedPlacement", "improve_placement", "robot_at"),
    "planner": ("plan",),
    "problem": ("Problem",),
    "robot": (
        "JointLimits",
        "Robot",
        "load_robot",
    ),
    "scenario.joint_limits": (
        "MoveItLimits",
        "load_joint_limits",
    ),
    "scenario.motion_limits": ("load_motion_limits",),
    "scenario.moveit": (
        "load_moveit",
        "load_moveit_scene",
    ),
    "scenario.scenario": (
        "Scenario",
        "load_scenario",
        "save_scenario",
    ),
    "scene": (
        "Box",
        "Capsule",
        "ConstantVelocity",
        "Cylinder",
        "HeightField",
        "Mesh",
        "Motion",
        "Obstacle",
        "OcTree",
        "PoseFunction",
        "Scene",
        "Sphere",
        "Waypoints",
    ),
    "planner.smoothing": ("smooth",),
    "segments": ("Segment",),
    "solution": ("Solution",),
    "status": (
        "IterationRecord",
        "Status",
    ),
    "samples": ("Samples",),
    "tours": ("Station", "Tour", "Visit", "plan_tour"),
    "trajectory": (
        "State",
        "Trajectory",
    ),
    "verification": (
        "ClearanceProof",
        "Verification",
        "prove_clearance",
        "verify",
    ),
    "workcell": ("Workcell",),
}
_MODULE_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "AllGoals",
    "AnyGoal",
    "AxisFixed",
    "AxisGoal",
    "Box",
    "Capsule",
    "Certificate",
    "ClearanceProof",
    "ConstantVelocity",
    "Cylinder",
    "Dataset",
    "EffortCurve",
    "ExportCheck",
    "FirmGrasp",
    "FrameNotFound",
    "Goal",
    "HeightField",
    "ImprovedPlacement",
    "IterationRecord",
    "JointCoupling",
    "JointGoal",
    "JointLimits",
    "JointNotFound",
    "JointRegionGoal",
    "KeepAway",
    "KeepOrientation",
    "KeepUpright",
    "LowerBound",
    "Mesh",
    "MissingDependency",
    "Motion",
    "MotionLimits",
    "MoveItLimits",
    "Obstacle",
    "OcTree",
    "Options",
    "OptionsError",
    "Outcome",
    "PathConstraint",
    "Payload",
    "PlanningFailed",
    "PoseFunction",
    "PoseGoal",
    "PositionGoal",
    "Problem",
    "ProblemError",
    "Refusal",
    "RegionGoal",
    "Robot",
    "RobotLoadError",
    "Samples",
    "Scenario",
    "ScenarioError",
    "Scene",
    "SceneError",
    "Segment",
    "Solution",
    "SolverNotFound",
    "Sphere",
    "StableContact",
    "State",
    "Station",
    "Status",
    "Tolerances",
    "TominpmpError",
    "TominpmpWarning",
    "ToolAcceleration",
    "ToolArc",
    "ToolLine",
    "ToolPolyline",
    "ToolSpeed",
    "Tour",
    "Trajectory",
    "Verification",
    "Visit",
    "Waypoints",
    "WithinRegion",
    "Workcell",
    "certify",
    "check_export",
    "check_file",
    "combine_robots",
    "controller_refusals",
    "improve_placement",
    "load_joint_limits",
    "load_motion",
    "load_motion_limits",
    "load_moveit",
    "load_moveit_scene",
    "load_robot",
    "load_scenario",
    "lower_bound",
    "plan",
    "plan_many",
    "plan_tour",
    "prove_clearance",
    "robot_at",
    "save_scenario",
    "smooth",
    "verify",
]

# A library leaves it to the application whether its log is shown.
logging.getLogger(__name__).addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("tominpmp")
    elif name in _MODULE_OF:
        value = getattr(import_module(f"tominpmp.{_MODULE_OF[name]}"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, imported or not."""
    return sorted({*globals(), *__all__, "__version__"})
