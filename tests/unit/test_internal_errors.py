"""Internal errors reach the caller unchanged, and are not attributed to an argument."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.collision.checker import CollisionChecker
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import RobotKinematics

START = [0.5, 1.7, -1.7]  # a list, as callers may pass it instead of an array


def failing(*_: Any, **__: Any) -> Any:
    raise RuntimeError("the hull of a mesh is empty")


@pytest.fixture(scope="module")
def motion() -> tm.Trajectory:
    robot = tm.load_robot("planar3r")
    t, q = np.array([0.0, 1.0]), np.array([START, [0.6, 1.6, -1.6]])
    return tm.Trajectory(robot.joint_names, t, q, 0.0 * q, 0.0 * q)


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (CollisionChecker, "__init__"),
        (CollisionChecker, "hulls_clear"),
        (CollisionChecker, "is_free"),
        (RobotDynamics, "inverse"),
    ],
)
def test_internal_error_of_a_problem_reaches_the_caller(
    owner: type, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = tm.load_robot("planar3r")
    monkeypatch.setattr(owner, name, failing)
    with pytest.raises(RuntimeError, match="the hull of a mesh is empty"):
        tm.Problem(robot, START, tm.JointGoal([0.6, 1.6, -1.6]))


@pytest.mark.parametrize(
    "call",
    [
        lambda problem, motion: tm.verify(problem, motion),
        lambda problem, motion: tm.plan(problem, intervals=6, starts=1),
        lambda problem, motion: motion.with_torques(failing),
        lambda problem, motion: problem.with_ends(START, problem.goal),
        lambda problem, motion: problem.checker.distances(np.array([START])),
        lambda problem, motion: (
            tm.ToolSpeed("tip", 1.0).on(problem.robot).measure(START, START, [])
        ),
        lambda problem, motion: tm.PositionGoal("tip", (4, 1, 0)).place(
            RobotKinematics(problem.robot), START
        ),
    ],
)
def test_internal_error_of_a_call_reaches_the_caller(
    call: Callable[[tm.Problem, tm.Trajectory], Any],
    motion: tm.Trajectory,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = tm.load_robot("planar3r")
    ball = tm.Sphere("ball", radius=0.1, position=(9.0, 0.0, 0.0))
    problem = tm.Problem(robot, START, tm.JointGoal([0.6, 1.6, -1.6]), [ball])
    monkeypatch.setattr(tm.Robot, "expand", failing)
    with pytest.raises(RuntimeError, match="the hull of a mesh is empty"):
        call(problem, motion)


def test_error_in_a_goal_class_of_the_caller_reaches_the_caller() -> None:
    class Own(tm.JointGoal):
        def place(self, kinematics: Any, q: Any) -> Any:
            raise ZeroDivisionError

    kinematics = RobotKinematics(tm.load_robot("planar3r"))
    with pytest.raises(ZeroDivisionError):
        Own(START).residual(kinematics, START, START)  # type: ignore[arg-type]
