"""A planner that takes no time, and what to call it with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tominpmp.description.files import robot_names
from tominpmp.options import Options
from tominpmp.problem import Problem
from tominpmp.solution import IterationRecord, Solution, Status
from tominpmp.trajectory import Trajectory

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

Run = Callable[..., Any]


def record(iteration: int, start: int = 0, **values: float) -> IterationRecord:
    numbers = {"duration": 1.0, "violation": 0.0, "objective": 1.0, "seconds": 0.1}
    return IterationRecord(
        iteration=iteration,
        predicted=0.0,
        actual=0.0,
        radius=1.0,
        accepted=True,
        programs=2,
        pivots=5,
        program_seconds=0.01,
        start=start,
        **{**numbers, **values},
    )


def straight(problem: Problem, duration: float = 2.0) -> Trajectory:
    """A motion along a line; it need not keep any limit."""
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
    """Stands in for the planner: keeps what it got, returns what it is told."""

    def __init__(self) -> None:
        self.problem: Any = None
        self.options: Any = None
        self.status = Status.CONVERGED
        self.feasible = True
        self.motion = True
        self.error: BaseException | None = None

    def __call__(self, problem: Problem, options: Options) -> Solution:
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
            message=f"{self.status.value} And so on.",
            feasible=self.feasible,
            trajectory=straight(problem) if self.motion else None,
            history=records,
            planning_time=0.25,
            violations={"torque": np.float64(2e-9), "velocity": 0.0},
        )
