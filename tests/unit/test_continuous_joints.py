"""Continuous joints are angles: their goals are reached by the nearest whole turn."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.kinematics import RobotKinematics

FILE = Path(__file__).parents[1] / "reports" / "continuous_across_pi" / "robot.urdf"
TURN = 2.0 * np.pi
LIMITS = tm.MotionLimits(acceleration=20.0)
QUICK = {"effort": "quick", "refine": None}


@pytest.fixture(scope="module")
def robot() -> tm.Robot:
    return tm.load_robot(FILE)


def end_of(robot: tm.Robot, start: list[float], goal: tm.Goal) -> list[float]:
    solution = tm.plan(tm.Problem(robot, start, goal), **QUICK)
    assert solution.success
    return solution.trajectory.q[-1].tolist()


def pose(robot: tm.Robot, q: list[float]) -> tm.PoseGoal:
    return tm.PoseGoal("l2", RobotKinematics(robot).placement(np.array(q), "l2"))


def test_the_nearest_way_from_any_number_of_turns(robot: tm.Robot) -> None:
    start = [3.0 + 10 * TURN, 0.1]
    solution = tm.plan(tm.Problem(robot, start, tm.JointGoal([-3.0, 0.4])))
    assert solution.T == pytest.approx(0.151, rel=0.02)
    assert solution.trajectory.q[0, 0] == start[0]
    assert solution.trajectory.q[-1, 0] == pytest.approx(-3.0 + 11 * TURN, abs=1e-5)
    assert "j1 11 turns above the number given" in solution.message
    assert solution.lower_bound.T <= solution.T


def test_replays_are_not_lost_after_many_turns(robot: tm.Robot) -> None:
    """Positions beyond 1e6 rad counted as a failed integration: T was 3 s."""
    start = [3.0 + 3e5 * TURN, 0.1]
    goal = tm.JointGoal([-3.0 + 3e5 * TURN, 0.4])
    solution = tm.plan(tm.Problem(robot, start, goal))
    assert solution.T == pytest.approx(0.151, rel=0.02)


def test_a_number_is_taken_as_it_is(robot: tm.Robot) -> None:
    goal = tm.JointGoal([-3.0, 0.4], wrap=False)
    solution = tm.plan(tm.Problem(robot, [3.0, 0.1], goal))
    assert solution.T == pytest.approx(3.0007, abs=1e-3)
    assert solution.trajectory.q[-1, 0] == pytest.approx(-3.0, abs=1e-5)
    assert "turn" not in solution.message


def test_a_start_turns_away_is_at_the_goal(robot: tm.Robot) -> None:
    goal = tm.JointGoal([0.0, 0.1])
    solution = tm.plan(tm.Problem(robot, [10 * TURN, 0.1], goal))
    assert solution.T == 0.0
    assert "j1 10 turns above" in solution.message


def test_joints_by_name_stay_where_they_are_not_named(robot: tm.Robot) -> None:
    start = [0.1 + 3 * TURN, 0.1]
    found = end_of(robot, start, tm.JointGoal({"j2": 0.4}))
    assert found == pytest.approx([start[0], 0.4], abs=1e-5)


def test_numbers_that_are_near_are_kept(robot: tm.Robot) -> None:
    for q in (0.5, -3.1, np.pi, -np.pi):
        problem = tm.Problem(robot, [0.0, 0.1], tm.JointGoal([q, 0.1]))
        assert problem.goal.configuration[0] == q


@pytest.mark.parametrize(("x", "end"), [(0.25, TURN - 0.8), (-0.25, -0.8)])
def test_an_obstacle_makes_the_other_way_round_faster(
    robot: tm.Robot, x: float, end: float
) -> None:
    """A pillar stands on one of two ways that are about as long."""
    pillar = tm.Box("pillar", size=(0.1, 0.1, 2.0), position=(x, 0.0, 0.4))
    goal = tm.JointGoal([-0.8, 1.5])
    problem = tm.Problem(robot, [2.4, 1.5], goal, [pillar], motion_limits=LIMITS)
    assert problem.goal.configuration[0] == TURN - 0.8
    found = tm.plan(problem, effort="quick", refine=None)
    assert found.trajectory.q[-1, 0] == pytest.approx(end, abs=1e-5)


def test_no_joint_turns_the_long_way_round_for_next_to_nothing() -> None:
    turn = "j2s6s200_joint_1"
    limits = {"position_lower": {turn: -3.1}, "position_upper": {turn: 3.1}}
    kinova = tm.load_robot("kinova", **limits)
    start = [3.0, 3.0, 3.0, 0.0, 1.5, 0.0]
    goal = tm.JointGoal([-3.0, 2.6, 2.6, 0.5, 1.5, 6.0])
    end = tm.plan(tm.Problem(kinova, start, goal)).trajectory.q[-1]
    # The first joint takes 9.55 s; the others have time for any number of turns.
    np.testing.assert_allclose(end[[3, 5]], [0.5, 6.0 - TURN], atol=1e-4)


def test_many_goals_keep_the_ways_in_both_directions(robot: tm.Robot) -> None:
    """A pillar bars the nearest way to each goal, but not the way round."""
    pillar = tm.Box("pillar", size=(0.1, 0.1, 2.0), position=(-0.3, 0.0, 0.4))
    goal = tm.AnyGoal([tm.JointGoal([-0.8 + 0.1 * k, 1.5]) for k in range(5)])
    problem = tm.Problem(robot, [2.4, 1.5], goal, [pillar], motion_limits=LIMITS)
    found = tm.plan(problem)
    assert found.success
    assert found.trajectory.q[-1, 0] == pytest.approx(-0.4, abs=1e-5)


def endless_arm(joints: int) -> tm.Robot:
    """Joints without limits about one axis; the first link is the longest."""
    text = '<robot name="endless"><link name="l0"/>'
    for i in range(1, joints + 1):
        length, x = (0.5, 0.0) if i == 1 else (0.1, 0.5 if i == 2 else 0.1)
        text += f'''
        <link name="l{i}"><inertial><origin xyz="{length / 2} 0 0"/><mass value="1"/>
          <inertia ixx=".01" iyy=".02" izz=".02" ixy="0" ixz="0" iyz="0"/></inertial>
          <collision><origin xyz="{length / 2} 0 0"/>
            <geometry><box size="{length} .04 .04"/></geometry></collision></link>
        <joint name="j{i}" type="continuous"><parent link="l{i - 1}"/>
          <child link="l{i}"/><origin xyz="{x} 0 0.05"/><axis xyz="0 0 1"/>
          <limit velocity="3" effort="50"/></joint>'''
    return tm.load_robot(text + "</robot>")


def coasting(goal: tm.Goal, velocity: float, **limits: float) -> tm.Problem:
    """A single joint without end that moves at the start, with motion limits."""
    robot, motion_limits = endless_arm(1), tm.MotionLimits(**limits)
    v_start = [velocity]
    return tm.Problem(robot, [0.0], goal, v_start=v_start, motion_limits=motion_limits)


POST = tm.Cylinder("post", radius=0.03, length=1.0, position=(0.3, 0.0, 0.0))


def test_each_of_many_joints_may_go_the_other_way_round() -> None:
    """A post bars one joint; the others have nearly half a turn to go."""
    robot = endless_arm(5)
    start, end = np.zeros(5), np.full(5, 3.1)
    start[0], end[0] = -0.5, 0.5
    problem = tm.Problem(robot, start, tm.JointGoal(end), [POST], self_collision=False)
    found = tm.plan(problem, effort="quick")
    assert found.success, found.message
    assert found.trajectory.q[-1] == pytest.approx([0.5 - TURN, *end[1:]], abs=1e-4)


@pytest.mark.parametrize("count", [4, 8])
def test_later_segments_follow_the_way_round_of_one(count: int) -> None:
    goals = [tm.JointGoal([0.5 + 0.1 * k]) for k in range(count)]
    segments = [tm.Segment(goal) for goal in goals]
    problem = tm.Problem(endless_arm(1), [-0.5], segments=segments, scene=[POST])
    found = tm.plan(problem, effort="quick")
    assert found.success, found.message
    ends = [part.trajectory.q[-1, 0] for part in found.segments]
    assert ends == pytest.approx([goal.q[0] - TURN for goal in goals], abs=1e-4)


def test_a_joint_that_cannot_stop_goes_on_for_two_turns(robot: tm.Robot) -> None:
    problem = tm.Problem(
        robot,
        [0.0, 0.1],
        tm.JointGoal([0.5, 0.1]),
        v_start=[2.0, 0.0],
        motion_limits=tm.MotionLimits(acceleration=0.17),
    )
    found = tm.plan(problem)
    assert found.trajectory.q[-1, 0] == pytest.approx(0.5 + 2.0 * TURN, abs=1e-4)
    assert found.T == pytest.approx(found.lower_bound.T, rel=1e-2)


@pytest.mark.parametrize(
    "goal", [tm.JointGoal([1.0]), tm.AnyGoal([tm.JointGoal([1.0])] * 2)]
)
def test_problems_of_passed_goals_are_made_anew(goal: tm.Goal) -> None:
    segments = [tm.Segment(goal, stop=False), tm.Segment(tm.JointGoal([1.5]))]
    first = tm.Problem(endless_arm(1), [0.0], segments=segments).phases[0]
    again = replace(first, margin=0.01)
    assert again.margin == 0.01
    ends = [each.configuration for each in again.goal.alternatives]
    assert ends == [each.configuration for each in first.goal.alternatives]


def test_copies_of_problems_have_the_same_turns() -> None:
    problem = tm.Problem(endless_arm(2), [0.0, 0.0], tm.JointGoal([1.0, -1.0]))
    copied = replace(problem, margin=0.01)
    ends = [[one.goal.q for one in each.alternatives] for each in (problem, copied)]
    assert len(ends[0]) > 1
    np.testing.assert_array_equal(*ends)


@pytest.mark.parametrize(
    "goal",
    [
        tm.AnyGoal([tm.JointGoal([1.0])]),
        tm.JointRegionGoal([1.0]),
        tm.AllGoals([tm.JointRegionGoal([1.0])]),
    ],
    ids=["any", "region", "all"],
)
def test_goals_of_all_kinds_are_reached_where_a_joint_comes_by_itself(
    goal: tm.Goal,
) -> None:
    """It comes to rest 31 rad away at the earliest."""
    found = tm.plan(coasting(goal, -2.5, acceleration=0.1), **QUICK)
    assert found.success, found.message
    assert found.trajectory.q[-1, 0] == pytest.approx(1.0 - 6.0 * TURN, abs=1e-4)


def test_later_segments_begin_where_a_moving_joint_comes_by_itself() -> None:
    segments = [
        tm.Segment(tm.JointGoal([1.0], v=[2.5])),
        tm.Segment(tm.JointGoal([1.5])),
    ]
    problem = tm.Problem(
        endless_arm(1),
        [0.0],
        segments=segments,
        motion_limits=tm.MotionLimits(acceleration=0.3),
    )
    found = tm.plan(problem, **QUICK)
    way = np.diff([part.trajectory.q[-1, 0] for part in found.segments])
    assert way == pytest.approx([0.5 + 2.0 * TURN], abs=1e-4)


def test_jerk_limits_count_for_where_a_joint_comes_by_itself() -> None:
    found = tm.plan(coasting(tm.JointGoal([1.0]), 2.5, jerk=0.1), effort="quick")
    assert found.T == pytest.approx(2.0 * np.sqrt(2.5 / 0.1), rel=0.1)


def test_bounds_of_joints_that_hardly_brake_take_no_time() -> None:
    """One after the other, their fifty thousand turns took a minute."""
    problem = coasting(tm.JointGoal([1.0]), 2.5, acceleration=1e-5)
    found = tm.plan(problem, max_planning_time=2.0)
    assert not found.success and found.planning_time < 3.0


def test_no_bound_exceeds_a_motion_that_goes_on_for_two_turns(robot: tm.Robot) -> None:
    """A joint that cannot stop earlier goes on to a later turn, which takes less."""
    limits = tm.MotionLimits(acceleration=0.17)
    nearest = tm.JointGoal([0.5, 0.1])
    later = tm.JointGoal([0.5 + 2 * TURN, 0.1], wrap=False)
    bounds = [
        tm.lower_bound(
            tm.Problem(
                robot, [0.0, 0.1], goal, v_start=[2.0, 0.0], motion_limits=limits
            )
        )
        for goal in (nearest, later)
    ]
    assert bounds[1].T == pytest.approx(12.3, abs=1.0)
    assert bounds[0].T <= bounds[1].T


def test_a_moving_start_goes_on(robot: tm.Robot) -> None:
    """To turn back would take longer than to go the longer way."""
    limits = tm.MotionLimits(acceleration=1.0)
    problem = tm.Problem(
        robot,
        [0.0, 0.1],
        tm.JointGoal([-3.0, 0.1]),
        v_start=[2.0, 0.0],
        motion_limits=limits,
    )
    found = tm.plan(problem)
    assert found.trajectory.q[-1, 0] == pytest.approx(TURN - 3.0, abs=1e-4)


def test_regions(robot: tm.Robot) -> None:
    goal = tm.JointRegionGoal([-3.0], 0.05, joints=["j1"])
    found = end_of(robot, [3.0, 0.1], goal)
    assert found[0] == pytest.approx(TURN - 3.05, abs=1e-4)
    goal = tm.JointRegionGoal([-3.0], 0.05, joints=["j1"], wrap=False)
    problem = tm.Problem(robot, [3.0, 0.1], goal)
    assert tm.lower_bound(problem).T > 2.9


def test_any_of_several_goals(robot: tm.Robot) -> None:
    goal = tm.AnyGoal([tm.JointGoal([6.2, 0.1]), tm.JointGoal([2.0, 0.5])])
    found = end_of(robot, [0.0, 0.1], goal)
    assert found == pytest.approx([6.2 - TURN, 0.1], abs=1e-5)


def test_segments_go_on_from_turn_to_turn(robot: tm.Robot) -> None:
    goals = [tm.JointGoal([q, 0.1]) for q in (2.0, -2.5, -0.5, 1.5)]
    segments = [tm.Segment(goal, stop=True) for goal in goals]
    problem = tm.Problem(robot, [0.0, 0.1], segments=segments, motion_limits=LIMITS)
    solution = tm.plan(problem, **QUICK)
    ends = [part.trajectory.q[-1, 0] for part in solution.segments]
    expected = [2.0, TURN - 2.5, TURN - 0.5, TURN + 1.5]
    assert ends == pytest.approx(expected, abs=1e-4)
    assert "j1 a turn above the number given of segment 2" in solution.message


def test_poses_are_reached_the_nearest_way(robot: tm.Robot) -> None:
    found = end_of(robot, [3.0 + 4 * TURN, 0.1], pose(robot, [-3.0, 0.4]))
    assert found == pytest.approx([5 * TURN - 3.0, 0.4], abs=1e-4)


def test_tours_without_a_jump(robot: tm.Robot) -> None:
    stations = [tm.JointGoal([-3.0, 0.4]), tm.JointGoal([9.0, 0.3])]
    stations.append(pose(robot, [-2.5, 0.3]))
    tour = tm.plan_tour(robot, [3.0, 0.1], stations, motion_limits=LIMITS)
    assert tour.success
    assert tour.cycle_time < 3.0
    ends = [motion.trajectory.q[[0, -1]] for motion in tour.motions]
    for before, after in pairwise(ends):
        assert after[0] == pytest.approx(before[-1], abs=1e-6)


def test_revolute_joints_turn_on_request_only() -> None:
    robot = tm.load_robot("ur5")
    start = [0.0, -1.5, 1.0, 0.0, 0.5, 5.0]
    q = [0.0, -1.5, 1.0, 0.0, 0.5, -1.0]
    assert tm.Problem(robot, start, tm.JointGoal(q)).goal.configuration[5] == -1.0
    wrapped = tm.Problem(robot, start, tm.JointGoal(q, wrap=("wrist_3_joint",)))
    ends = [goal.configuration[5] for goal in wrapped.goal.alternatives]
    # A third one would be beyond its limits.
    assert ends == pytest.approx([TURN - 1.0, -1.0])


def test_wrong_joints_are_named(robot: tm.Robot) -> None:
    with pytest.raises(tm.JointNotFound, match="j9"):
        tm.Problem(robot, [0.0, 0.1], tm.JointGoal([1.0, 0.1], wrap=("j9",)))
    with pytest.raises(
        tm.ProblemError, match="wrap is 3, expected True, False or names"
    ):
        tm.JointGoal([1.0, 0.1], wrap=3)  # type: ignore[arg-type]


def test_files_keep_it(robot: tm.Robot, tmp_path: Path) -> None:
    for wrap in (True, False, ("j2",)):
        goal = tm.JointGoal([-3.0, 0.4], wrap=wrap)
        problem = tm.Problem(robot, [3.0, 0.1], goal)
        tm.save_scenario(tmp_path / "s.toml", problem)
        read = tm.load_scenario(tmp_path / "s.toml").problem
        assert read.goal == goal
        assert read.goal.configuration.tolist() == problem.goal.configuration.tolist()


def test_a_replan_with_a_former_motion(robot: tm.Robot) -> None:
    problem = tm.Problem(robot, [3.0, 0.1], tm.JointGoal([-3.0, 0.4]))
    solution = tm.plan(problem)
    again = tm.plan(problem, start=solution)
    assert again.T == pytest.approx(solution.T, rel=1e-2)


def test_a_goal_in_collision_is_told_once(robot: tm.Robot) -> None:
    pillar = tm.Box("pillar", size=(0.1, 0.1, 2.0), position=(-0.25, 0.0, 0.4))
    expected = r"^goal in collision.*q = \[3.2832, 1.5"
    with pytest.raises(tm.ProblemError, match=expected):
        tm.Problem(robot, [2.0, 1.5], tm.JointGoal([-3.0, 1.5]), [pillar])


def test_workcells(robot: tm.Robot) -> None:
    cell = tm.Workcell({"a": (robot, (0, 0, 0)), "b": (robot, (2.0, 0, 0))})
    start = {"a": [3.0, 0.1], "b": [3.0, 0.1]}
    goal = tm.JointGoal([-3.0, 0.4])
    for wrap, expected in ((True, TURN - 3.0), (False, -3.0)):
        other = tm.JointGoal([-3.0, 0.4], wrap=wrap)
        problem = cell.problem(start, {"a": goal, "b": other})
        assert problem.goal.configuration[0] == pytest.approx(expected)
