"""Wrong arguments of figures, pages and tables raise errors of the library."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import tominpmp as tm

START, END = [0.5, 1.7, -1.7], [0.6, 1.6, -1.6]


@pytest.fixture(scope="module")
def solution() -> tm.Solution:
    robot = tm.load_robot("planar3r")
    return tm.plan(tm.Problem(robot, START, tm.JointGoal(END)), intervals=8, starts=1)


@pytest.mark.parametrize(
    "wrong",
    [
        {"rate": "fast"},
        {"fps": [60.0]},
        {"fps": np.nan},
        {"title": 5},
        {"viewer": 3},
        {"twins": [1]},
        {"frame": np.zeros(2)},
    ],
    ids=str,
)
def test_wrong_argument_of_play_is_named(
    solution: tm.Solution, wrong: dict[str, Any], tmp_path: Path
) -> None:
    (name,) = wrong
    with pytest.raises(tm.TominpmpError, match=name):
        solution.play(**{"path": tmp_path / "motion.html", **wrong})


def test_wrong_argument_of_export_and_plot_is_named(
    solution: tm.Solution, tmp_path: Path
) -> None:
    with pytest.raises(tm.ProblemError, match="verify is 'yes', expected True or"):
        solution.export(tmp_path / "a.csv", verify="yes")  # type: ignore[arg-type]
    with pytest.raises(tm.ProblemError, match=r"ax is \[\[1\], \[2, 3\]\], expected"):
        solution.plot(ax=[[1], [2, 3]])  # type: ignore[arg-type]


def test_wrong_length_of_a_table_is_rejected(solution: tm.Solution) -> None:
    with pytest.raises(tm.ProblemError, match=r"most is 'a', expected a number"):
        solution.sensitivities.table("a")  # type: ignore[arg-type]
    assert solution.sensitivities.table(1).count("\n") <= 2


def test_wrong_argument_of_problem_copies_is_named(solution: tm.Solution) -> None:
    problem = solution.problem
    with pytest.raises(tm.ProblemError, match="goal is 'a', expected"):
        problem.with_ends(START, "a")  # type: ignore[arg-type]
    with pytest.raises(tm.ProblemError, match="scene is 3,"):
        problem.with_scene(3)  # type: ignore[arg-type]


def test_misspelt_joint_gets_a_suggestion(solution: tm.Solution) -> None:
    goal = tm.JointGoal({"jiont1": 0.5, "joint2": 0.1, "joint3": 0.1})
    with pytest.raises(tm.ProblemError, match=r"'jiont1' \(did you mean joint1"):
        tm.Problem(solution.problem.robot, START, goal)


def test_goal_in_degrees_gets_a_hint_about_radians(solution: tm.Solution) -> None:
    robot = solution.problem.robot
    with pytest.raises(tm.ProblemError, match="angles are in radians, not degrees"):
        tm.Problem(robot, START, tm.JointGoal([30.0, 90.0, -90.0]))
    with pytest.raises(tm.ProblemError, match=r"limits \[[^]]*\] rad$"):
        tm.Problem(robot, START, tm.JointGoal([4.0, 1.0, 1.0]))


def test_wrong_pose_is_shown_in_the_message() -> None:
    with pytest.raises(tm.ProblemError, match=r"goal.pose is \(1, 2, 3\), expected"):
        tm.PoseGoal("tip", (1, 2, 3))


def test_base_may_be_a_position_or_a_pose() -> None:
    robot = tm.load_robot("planar3r")
    base = np.eye(4)
    base[0, 3] = 0.5
    for given in ((0.5, 0.0, 0.0), base, ((0.5, 0.0, 0.0), (0, 0, 0, 1))):
        moved = tm.robot_at(robot, given)
        data = moved.model.createData()
        pin.framesForwardKinematics(moved.model, data, np.zeros(3))
        there = data.oMf[moved.frame_id("tip")].translation
        np.testing.assert_allclose(there, [6.5, 0.0, 0.0], atol=1e-12)
    with pytest.raises(tm.ProblemError, match="base"):
        tm.robot_at(robot, "here")
