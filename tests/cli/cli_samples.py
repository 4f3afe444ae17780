"""Stand-ins for the planner and the verification, and arguments of commands."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_samples import record

from tominpmp.description.files import robot_names
from tominpmp.files.export_check import ExportCheck
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options, Tolerances
from tominpmp.problem.problem import Problem
from tominpmp.solution import Solution
from tominpmp.status import Status

START = "0.5,1.7,-1.7"
GOAL = "2,-1,0.5"
PLAN = ["plan", "planar3r", "--start", START, "--goal", GOAL]

needs_panda = pytest.mark.skipif(
    "panda" not in robot_names(), reason="example-robot-data is not installed"
)

SLIDER = """
<robot name="slider">
  <link name="base"/>
  <link name="cart">
    <inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
      iyz="0"/></inertial>
  </link>
  <link name="pole">
    <inertial><origin xyz="0 0 1"/><mass value="1"/><inertia ixx="1" iyy="1" izz="1"
      ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="slide" type="prismatic">
    <parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2" velocity="3" effort="50"/>
  </joint>
  <joint name="swing" type="continuous">
    <parent link="cart"/><child link="pole"/><axis xyz="0 0 1"/>
    <limit velocity="5" effort="20"/>
  </joint>
</robot>
"""

SCENARIO = """
margin = 0.01
[robot]
name = "planar3r"
[start]
state = "start"
[goal]
type = "joint"
q = [2.0, -1.0, 0.5]
[[scene.obstacles]]
type = "sphere"
name = "ball"
position = [0.0, 5.5, 0.0]
radius = 0.1
[options]
intervals = 50
"""

PANDA = [f"panda_joint{k}" for k in range(1, 8)]
FINGERS = ["panda_finger_joint1", "panda_finger_joint2"]
READY = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]

SCENE: dict[str, Any] = {
    "world": {
        "collision_objects": [
            {
                "id": "table",
                "primitives": [{"type": "box", "dimensions": [1.0, 1.0, 0.1]}],
                "primitive_poses": [{"position": [0.8, 0.0, 0.0]}],
            }
        ]
    }
}
REQUEST: dict[str, Any] = {
    "start_state": {
        "joint_state": {"name": PANDA + FINGERS, "position": [*READY, 0.04, 0.04]}
    },
    "goal_constraints": [
        {
            "joint_constraints": [
                {"joint_name": name, "position": value + 0.1}
                for name, value in zip(PANDA, READY, strict=True)
            ]
        }
    ],
}

Run = Callable[..., Any]


def straight(problem: Problem, duration: float = 2.0) -> Trajectory:
    """A motion along a line, which need not satisfy any limit."""
    q_end = getattr(problem.goal, "q", problem.q_start)
    q = np.linspace(problem.q_start, q_end, 5)
    return Trajectory(
        problem.robot.joint_names,
        np.linspace(0.0, duration, 5),
        q,
        np.zeros_like(q),
        np.zeros_like(q),
    )


class Planner:
    """Stand-in for the planner: records its arguments, returns a prepared solution."""

    def __init__(self) -> None:
        self.problem: Any = None
        self.options: Any = None
        self.status = Status.CONVERGED
        self.feasible = True
        self.motion = True
        self.error: BaseException | None = None
        self.remark = "And so on."
        self.violations = {"torque": np.float64(2e-9), "velocity": 0.0}

    def __call__(
        self, problem: Problem, options: Options, start: object = None
    ) -> Solution:
        self.problem, self.options = problem, options
        if self.error is not None:
            raise self.error
        records = (record(0), record(1), record(0, start=1))
        for item in records:
            options.callback(item)
        return Solution(
            problem=problem,
            options=options,
            status=self.status,
            message=f"{self.status.value} {self.remark}",
            feasible=self.feasible,
            trajectory=straight(problem) if self.motion else None,
            history=records,
            planning_time=0.25,
            violations=self.violations,
        )


def passed(solution: Solution, path: Path, dt: float | None = None) -> ExportCheck:
    """Stand-in for the check of an exported file: every file passes."""
    assert Path(path).is_file()
    return ExportCheck(Path(path), True, "straight lines", (), (), None)


@dataclass(frozen=True)
class Violation:
    """A violation in a prepared verdict."""

    kind: str
    joint: str
    time: float
    amount: float

    def __str__(self) -> str:
        """The message of the violation."""
        return f"{self.kind} of {self.joint} by {self.amount} at {self.time} s"


@dataclass(frozen=True)
class Verdict:
    """The prepared result of a verification."""

    ok: bool
    goal_error: float
    violations: tuple[Violation, ...]
    speed_error: float = 0.0
    min_clearance: float = math.inf
    integrator: str = "none"
    seconds: float = 0.0
    touches: tuple[object, ...] = ()
    replay: object = field(default=None, repr=False)


class Judge:
    """Stand-in for the verification: records its arguments, returns its verdict."""

    def __init__(self) -> None:
        self.problem: Any = None
        self.trajectory: Any = None
        self.tolerances: Any = None
        self.verdict = Verdict(True, 1e-9, ())

    def __call__(
        self, problem: Problem, trajectory: Trajectory, tolerances: Tolerances
    ) -> Verdict:
        self.problem, self.trajectory = problem, trajectory
        self.tolerances = tolerances
        return self.verdict
