"""Joint goals that give positions of some of the joints only, by name.

They are the same in Python, in scenario files and on the command line.
"""

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


def test_joints_not_in_the_goal_stay_at_the_start(
    robot: tm.Robot, tmp_path: Path
) -> None:
    partial = tm.Problem(robot, START, tm.JointGoal({"joint2": 1.2}))
    assert goal_of(partial) == [0.5, 1.2, -1.7]
    path = tmp_path / "scenario.toml"
    path.write_text(
        'goal = {type = "joint", q = {joint2 = 1.2}}\n'
        'robot = {name = "planar3r"}\nstart = {q = [0.5, 1.7, -1.7]}\n'
    )
    assert goal_of(tm.load_scenario(path).problem) == goal_of(partial)
    options = ProblemOptions(start="0.5 1.7 -1.7", goal="joint2=1.2")
    from_options, _ = load_problem("planar3r", options)
    assert goal_of(from_options) == goal_of(partial)


def test_velocities_of_joints_not_in_the_goal_are_zero(robot: tm.Robot) -> None:
    goal = tm.JointGoal({"joint2": 1.2, "joint1": 0.6}, v={"joint2": 0.1})
    partial = tm.Problem(robot, START, goal)
    assert goal_of(partial) == [0.6, 1.2, -1.7]
    assert partial.goal.final_velocity(3).tolist() == [0.0, 0.1, 0.0]


def test_joints_not_in_a_segment_goal_stay_at_the_previous_goal(
    robot: tm.Robot,
) -> None:
    goals = [tm.JointGoal({"joint1": 0.6}), tm.JointGoal({"joint2": 1.6})]
    partial = tm.Problem(robot, START, segments=[tm.Segment(goal) for goal in goals])
    assert [goal_of(part) for part in partial.phases] == [
        [0.6, 1.7, -1.7],
        [0.6, 1.6, -1.7],
    ]
    somewhere = tm.Segment(tm.PositionGoal("tip", (4, 1, 0)))
    last = tm.Segment(goals[1])
    with pytest.raises(tm.ProblemError, match="has no value for joint1, joint3"):
        tm.Problem(robot, START, segments=[somewhere, last])


def test_alternative_goals_leave_other_joints_at_the_start(robot: tm.Robot) -> None:
    goals = [tm.JointGoal({"joint1": 0.6}), tm.JointGoal({"joint1": 0.7})]
    partial = tm.Problem(robot, START, tm.AnyGoal(goals))
    assert [goal_of(one) for one in partial.alternatives] == [
        [0.6, *START[1:]],
        [0.7, *START[1:]],
    ]
    other = partial.with_ends(np.array([0.4, 1.5, -1.5]), goals[0])
    assert goal_of(other) == [0.6, 1.5, -1.5]


def test_workcell_goals_leave_other_joints_of_each_robot_at_the_start(
    robot: tm.Robot,
) -> None:
    cell = tm.Workcell({"a": (robot, (0, 0, 0)), "b": (robot, (30.0, 0, 0))})
    start = {"a": START, "b": START}
    goals = {"a": tm.JointGoal({"joint1": 0.6}), "b": tm.JointGoal({"joint3": -1.6})}
    combined = cell.problem(start, goals)
    assert goal_of(combined) == [0.6, 1.7, -1.7, 0.5, 1.7, -1.6]


def test_stations_and_starts_must_name_all_joints(robot: tm.Robot) -> None:
    goal = tm.JointGoal({"joint1": 0.6})
    with pytest.raises(tm.ProblemError, match="has no value for joint2, joint3"):
        tm.plan_tour(robot, START, {"a": goal, "b": tm.JointGoal(START)})
    with pytest.raises(tm.ProblemError, match="q_start has no value for joint2"):
        tm.Problem(robot, {"joint1": 0.5, "joint3": -1.7}, goal)


def test_joint_regions_have_tolerances_by_joint_name(robot: tm.Robot) -> None:
    goal = tm.JointRegionGoal(
        {"joint3": -1.6, "joint1": 0.6}, {"joint1": 0.1, "joint3": 0.2}
    )
    assert goal == tm.JointRegionGoal((-1.6, 0.6), (0.2, 0.1), ("joint3", "joint1"))
    with pytest.raises(tm.ProblemError, match=r"goal\.tolerance has no value for j"):
        tm.JointRegionGoal({"joint3": -1.6, "joint1": 0.6}, {"joint1": 0.1})
    with pytest.raises(tm.ProblemError, match=r"goal\.q by name, too"):
        tm.JointRegionGoal((0.6, 1.7, -1.6), {"joint1": 0.1})


def test_joint_names_in_a_mapping_and_in_joints_are_refused(robot: tm.Robot) -> None:
    for kind in (tm.JointGoal, tm.JointRegionGoal):
        with pytest.raises(
            tm.ProblemError, match=r"joints is \('joint2',\), expected N"
        ):
            kind({"joint1": 0.6}, joints=("joint2",))


def test_joint_ranges_that_contradict_each_other_are_refused(robot: tm.Robot) -> None:
    def goal(apart: float) -> tm.AllGoals:
        near = tm.JointRegionGoal({"joint1": 1.0, "joint3": -1.0}, 0.1)
        return tm.AllGoals([near, tm.JointRegionGoal({"joint1": 1.0 + apart}, 0.2)])

    tm.Problem(robot, START, goal(0.3))
    with pytest.raises(tm.ProblemError, match=r"'joint1' is to be 1.15 at least and"):
        tm.Problem(robot, START, goal(0.35))
