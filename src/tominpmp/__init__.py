"""Time-optimal motions of robot manipulators, planned from their URDF.

    import tominpmp as tm

    robot = tm.load_robot("panda", locked_joints={"panda_finger_joint1": 0.04})
    problem = tm.Problem(robot, q_start, tm.JointGoal(q_goal))
    solution = tm.plan(problem)
    print(solution.T, solution.trajectory(0.1).q)
"""

from __future__ import annotations

import logging
from importlib.metadata import version

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
from tominpmp.goals import Goal, JointGoal, PoseGoal, PositionGoal
from tominpmp.options import Options
from tominpmp.planner import plan
from tominpmp.problem import Problem
from tominpmp.robot import JointLimits, Robot, load_robot
from tominpmp.scene import Box, Capsule, Cylinder, Obstacle, Scene, Sphere
from tominpmp.solution import IterationRecord, Solution, Status
from tominpmp.trajectory import Samples, State, Trajectory

__all__ = [
    "Box",
    "Capsule",
    "Cylinder",
    "FrameNotFound",
    "Goal",
    "IterationRecord",
    "JointGoal",
    "JointLimits",
    "JointNotFound",
    "MissingDependency",
    "Obstacle",
    "Options",
    "OptionsError",
    "PlanningFailed",
    "PoseGoal",
    "PositionGoal",
    "Problem",
    "ProblemError",
    "Robot",
    "RobotLoadError",
    "Samples",
    "ScenarioError",
    "Scene",
    "SceneError",
    "Solution",
    "SolverNotFound",
    "Sphere",
    "State",
    "Status",
    "TominpmpError",
    "TominpmpWarning",
    "Trajectory",
    "load_robot",
    "plan",
]

__version__ = version("tominpmp")

# A library leaves it to the application whether its log is shown.
logging.getLogger(__name__).addHandler(logging.NullHandler())
