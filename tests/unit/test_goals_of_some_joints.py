"""Goals that name some joints: Python, scenario files and the command line agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.cli.options import ProblemOptions
from tominpmp.cli.problem import load_problem

START = (0.5, 1.7, -1.7)


@pytest.fixture(scope="module")
def robot() -> tm.Robot:
    return tm.load_robot("planar3r")


def goal_of(problem: tm.Problem) -> list[float]:
    q = problem.goal.configuration
    assert q is not None
    return q.tolist()


def test_the_others_stay_at_the_start(robot: tm.Robot, tmp_path: Path) -> None:
    made = tm.Problem(robot, START, tm.JointGoal({"joint2": 1.2}))
    assert goal_of(made) == [0.5, 1.2, -1.7]
    path = tmp_path / "scenario.toml"
    path.write_text(
        'goal = {type = "joint", q = {joint2 = 1.2}}\n'
        'robot = {name = "planar3r"}\nstart = {q = [0.5, 1.7, -1.7]}\n'
    )
    assert goal_of(tm.load_scenario(path).problem) == goal_of(made)
    typed = ProblemOptions(start="0.5 1.7 -1.7", goal="joint2=1.2")
    found, _ = load_problem("planar3r", typed)
    assert goal_of(found) == goal_of(made)


def test_speeds_beside_them_are_zero(robot: tm.Robot) -> None:
    goal = tm.JointGoal({"joint2": 1.2, "joint1": 0.6}, v={"joint2": 0.1})
    made = tm.Problem(robot, START, goal)
    assert goal_of(made) == [0.6, 1.2, -1.7]
    assert made.goal.final_velocity(3).tolist() == [0.0, 0.1, 0.0]


def test_of_segments_where_the_one_before_leaves_them(robot: tm.Robot) -> None:
    goals = [tm.JointGoal({"joint1": 0.6}), tm.JointGoal({"joint2": 1.6})]
    made = tm.Problem(robot, START, segments=[tm.Segment(goal) for goal in goals])
    assert [goal_of(part) for part in made.phases] == [
        [0.6, 1.7, -1.7],
        [0.6, 1.6, -1.7],
    ]
    somewhere = tm.Segment(tm.PositionGoal("tip", (4, 1, 0)))
    last = tm.Segment(goals[1])
    with pytest.raises(tm.ProblemError, match="nothing about joint1, joint3"):
        tm.Problem(robot, START, segments=[somewhere, last])


def test_any_of_several_and_copies(robot: tm.Robot) -> None:
    goals = [tm.JointGoal({"joint1": 0.6}), tm.JointGoal({"joint1": 0.7})]
    made = tm.Problem(robot, START, tm.AnyGoal(goals))
    assert [goal_of(one) for one in made.alternatives] == [
        [0.6, *START[1:]],
        [0.7, *START[1:]],
    ]
    other = made.with_ends(np.array([0.4, 1.5, -1.5]), goals[0])
    assert goal_of(other) == [0.6, 1.5, -1.5]


def test_of_one_robot_among_several(robot: tm.Robot) -> None:
    cell = tm.Workcell({"a": (robot, (0, 0, 0)), "b": (robot, (30.0, 0, 0))})
    start = {"a": START, "b": START}
    goals = {"a": tm.JointGoal({"joint1": 0.6}), "b": tm.JointGoal({"joint3": -1.6})}
    found = cell.problem(start, goals)
    assert goal_of(found) == [0.6, 1.7, -1.7, 0.5, 1.7, -1.6]


def test_stations_and_starts_name_all_joints(robot: tm.Robot) -> None:
    goal = tm.JointGoal({"joint1": 0.6})
    with pytest.raises(tm.ProblemError, match="nothing about joint2, joint3"):
        tm.plan_tour(robot, START, {"a": goal, "b": tm.JointGoal(START)})
    with pytest.raises(tm.ProblemError, match="q_start says nothing about joint2"):
        tm.Problem(robot, {"joint1": 0.5, "joint3": -1.7}, goal)


def test_regions_have_tolerances_by_joint_name(robot: tm.Robot) -> None:
    goal = tm.JointRegionGoal(
        {"joint3": -1.6, "joint1": 0.6}, {"joint1": 0.1, "joint3": 0.2}
    )
    assert goal == tm.JointRegionGoal((-1.6, 0.6), (0.2, 0.1), ("joint3", "joint1"))
    with pytest.raises(tm.ProblemError, match=r"goal\.tolerance says nothing about j"):
        tm.JointRegionGoal({"joint3": -1.6, "joint1": 0.6}, {"joint1": 0.1})
    with pytest.raises(tm.ProblemError, match=r"goal\.q by name, too"):
        tm.JointRegionGoal((0.6, 1.7, -1.6), {"joint1": 0.1})


def test_joints_are_named_in_one_way(robot: tm.Robot) -> None:
    for kind in (tm.JointGoal, tm.JointRegionGoal):
        with pytest.raises(
            tm.ProblemError, match=r"joints is \('joint2',\), expected N"
        ):
            kind({"joint1": 0.6}, joints=("joint2",))


def test_goals_that_contradict_each_other_are_refused(robot: tm.Robot) -> None:
    def goal(apart: float) -> tm.AllGoals:
        near = tm.JointRegionGoal({"joint1": 1.0, "joint3": -1.0}, 0.1)
        return tm.AllGoals([near, tm.JointRegionGoal({"joint1": 1.0 + apart}, 0.2)])

    tm.Problem(robot, START, goal(0.3))
    with pytest.raises(tm.ProblemError, match=r"'joint1' is to be 1.15 at least and"):
        tm.Problem(robot, START, goal(0.35))
