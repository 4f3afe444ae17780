"""Continuous joints: goals are angles, reached with the fastest number of turns."""

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


def test_goal_is_reached_at_the_nearest_turn_of_the_start(robot: tm.Robot) -> None:
    start = [3.0 + 10 * TURN, 0.1]
    solution = tm.plan(tm.Problem(robot, start, tm.JointGoal([-3.0, 0.4])))
    assert solution.T == pytest.approx(0.151, rel=0.02)
    assert solution.trajectory.q[0, 0] == pytest.approx(start[0], abs=1e-13)
    assert solution.trajectory.q[-1, 0] == pytest.approx(-3.0 + 11 * TURN, abs=1e-5)
    assert "j1 11 turns above the number given" in solution.message
    assert solution.lower_bound.T <= solution.T


def test_replay_accepts_positions_after_many_turns(robot: tm.Robot) -> None:
    """Regression: positions beyond 1e6 rad counted as failed integration: T was 3 s."""
    start = [3.0 + 3e5 * TURN, 0.1]
    goal = tm.JointGoal([-3.0 + 3e5 * TURN, 0.4])
    solution = tm.plan(tm.Problem(robot, start, goal))
    assert solution.T == pytest.approx(0.151, rel=0.02)


def test_goal_without_wrap_is_reached_at_its_own_turn(robot: tm.Robot) -> None:
    goal = tm.JointGoal([-3.0, 0.4], wrap=False)
    solution = tm.plan(tm.Problem(robot, [3.0, 0.1], goal))
    assert solution.T == pytest.approx(3.0007, abs=1e-3)
    assert solution.trajectory.q[-1, 0] == pytest.approx(-3.0, abs=1e-5)
    assert "turn" not in solution.message


def test_start_whole_turns_from_the_goal_is_at_the_goal(robot: tm.Robot) -> None:
    goal = tm.JointGoal([0.0, 0.1])
    solution = tm.plan(tm.Problem(robot, [10 * TURN, 0.1], goal))
    assert solution.T == 0.0
    assert "j1 10 turns above" in solution.message


def test_unnamed_joints_of_a_goal_keep_their_position(robot: tm.Robot) -> None:
    start = [0.1 + 3 * TURN, 0.1]
    found = end_of(robot, start, tm.JointGoal({"j2": 0.4}))
    assert found == pytest.approx([start[0], 0.4], abs=1e-5)


def test_goal_within_half_a_turn_keeps_its_number(robot: tm.Robot) -> None:
    for q in (0.5, -3.1, np.pi, -np.pi):
        problem = tm.Problem(robot, [0.0, 0.1], tm.JointGoal([q, 0.1]))
        assert problem.goal.configuration[0] == q


@pytest.mark.parametrize(("x", "end"), [(0.25, TURN - 0.8), (-0.25, -0.8)])
def test_obstacle_makes_the_other_direction_faster(
    robot: tm.Robot, x: float, end: float
) -> None:
    """A pillar bars one of the two directions, which are about equally long."""
    pillar = tm.Box("pillar", size=(0.1, 0.1, 2.0), position=(x, 0.0, 0.4))
    goal = tm.JointGoal([-0.8, 1.5])
    problem = tm.Problem(robot, [2.4, 1.5], goal, [pillar], motion_limits=LIMITS)
    assert problem.goal.configuration[0] == TURN - 0.8
    found = tm.plan(problem, effort="quick", refine=None)
    assert found.trajectory.q[-1, 0] == pytest.approx(end, abs=1e-5)


def test_joints_with_time_to_spare_take_the_short_direction() -> None:
    turn = "j2s6s200_joint_1"
    limits = {"position_lower": {turn: -3.1}, "position_upper": {turn: 3.1}}
    kinova = tm.load_robot("kinova", **limits)
    start = [3.0, 3.0, 3.0, 0.0, 1.5, 0.0]
    goal = tm.JointGoal([-3.0, 2.6, 2.6, 0.5, 1.5, 6.0])
    end = tm.plan(tm.Problem(kinova, start, goal)).trajectory.q[-1]
    # The first joint takes 9.55 s; the others have time for many turns.
    np.testing.assert_allclose(end[[3, 5]], [0.5, 6.0 - TURN], atol=1e-4)


def test_goal_set_keeps_both_directions_of_each_goal(robot: tm.Robot) -> None:
    """A pillar bars the short direction to each goal, but not the long one."""
    pillar = tm.Box("pillar", size=(0.1, 0.1, 2.0), position=(-0.3, 0.0, 0.4))
    goal = tm.AnyGoal([tm.JointGoal([-0.8 + 0.1 * k, 1.5]) for k in range(5)])
    problem = tm.Problem(robot, [2.4, 1.5], goal, [pillar], motion_limits=LIMITS)
    found = tm.plan(problem)
    assert found.success
    assert found.trajectory.q[-1, 0] == pytest.approx(-0.4, abs=1e-5)


def continuous_arm(joints: int) -> tm.Robot:
    """An arm of continuous joints about parallel axes, with a long first link."""
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


def moving_start(goal: tm.Goal, velocity: float, **limits: float) -> tm.Problem:
    """A problem of one continuous joint that moves at the start, with motion limits."""
    robot, motion_limits = continuous_arm(1), tm.MotionLimits(**limits)
    v_start = [velocity]
    return tm.Problem(robot, [0.0], goal, v_start=v_start, motion_limits=motion_limits)


POST = tm.Cylinder("post", radius=0.03, length=1.0, position=(0.3, 0.0, 0.0))


def test_one_of_many_joints_may_take_the_long_direction() -> None:
    """A post bars one joint; the other joints move by nearly half a turn."""
    robot = continuous_arm(5)
    start, end = np.zeros(5), np.full(5, 3.1)
    start[0], end[0] = -0.5, 0.5
    problem = tm.Problem(robot, start, tm.JointGoal(end), [POST], self_collision=False)
    found = tm.plan(problem, effort="quick")
    assert found.success, found.message
    assert found.trajectory.q[-1] == pytest.approx([0.5 - TURN, *end[1:]], abs=1e-4)


@pytest.mark.parametrize("count", [4, 8])
def test_later_segments_keep_the_direction_of_the_first(count: int) -> None:
    goals = [tm.JointGoal([0.5 + 0.1 * k]) for k in range(count)]
    segments = [tm.Segment(goal) for goal in goals]
    problem = tm.Problem(continuous_arm(1), [-0.5], segments=segments, scene=[POST])
    found = tm.plan(problem, effort="quick")
    assert found.success, found.message
    ends = [part.trajectory.q[-1, 0] for part in found.segments]
    assert ends == pytest.approx([goal.q[0] - TURN for goal in goals], abs=1e-4)


def test_joint_that_brakes_too_weakly_reaches_its_goal_two_turns_later(
    robot: tm.Robot,
) -> None:
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
def test_phase_with_a_goal_on_the_way_can_be_replaced(goal: tm.Goal) -> None:
    segments = [tm.Segment(goal, stop=False), tm.Segment(tm.JointGoal([1.5]))]
    first = tm.Problem(continuous_arm(1), [0.0], segments=segments).phases[0]
    again = replace(first, margin=0.01)
    assert again.margin == 0.01
    ends = [each.configuration for each in again.goal.alternatives]
    assert ends == [each.configuration for each in first.goal.alternatives]


def test_replaced_problem_has_the_same_turns() -> None:
    problem = tm.Problem(continuous_arm(2), [0.0, 0.0], tm.JointGoal([1.0, -1.0]))
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
def test_goals_of_all_kinds_are_reached_where_the_joint_can_stop(
    goal: tm.Goal,
) -> None:
    """The joint comes to rest 31 rad away at the earliest."""
    found = tm.plan(moving_start(goal, -2.5, acceleration=0.1), **QUICK)
    assert found.success, found.message
    assert found.trajectory.q[-1, 0] == pytest.approx(1.0 - 6.0 * TURN, abs=1e-4)


def test_later_segment_is_reached_where_a_moving_joint_can_stop() -> None:
    segments = [
        tm.Segment(tm.JointGoal([1.0], v=[2.5])),
        tm.Segment(tm.JointGoal([1.5])),
    ]
    problem = tm.Problem(
        continuous_arm(1),
        [0.0],
        segments=segments,
        motion_limits=tm.MotionLimits(acceleration=0.3),
    )
    found = tm.plan(problem, **QUICK)
    way = np.diff([part.trajectory.q[-1, 0] for part in found.segments])
    assert way == pytest.approx([0.5 + 2.0 * TURN], abs=1e-4)


def test_jerk_limit_determines_where_a_moving_joint_can_stop() -> None:
    found = tm.plan(moving_start(tm.JointGoal([1.0]), 2.5, jerk=0.1), effort="quick")
    assert found.T == pytest.approx(2.0 * np.sqrt(2.5 / 0.1), rel=0.1)


def test_bounds_of_joints_that_hardly_brake_are_fast() -> None:
    """Regression: bounds of fifty thousand turns, one by one, took a minute."""
    problem = moving_start(tm.JointGoal([1.0]), 2.5, acceleration=1e-5)
    found = tm.plan(problem, max_planning_time=2.0)
    assert not found.success and found.planning_time < 3.0


def test_lower_bound_regards_goals_at_later_turns(robot: tm.Robot) -> None:
    """A joint that cannot stop earlier reaches a later turn in less time."""
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


def test_moving_start_keeps_its_direction(robot: tm.Robot) -> None:
    """Reversing would take longer than the longer direction."""
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


def test_region_goal_of_a_continuous_joint_wraps(robot: tm.Robot) -> None:
    goal = tm.JointRegionGoal([-3.0], 0.05, joints=["j1"])
    found = end_of(robot, [3.0, 0.1], goal)
    assert found[0] == pytest.approx(TURN - 3.05, abs=1e-4)
    goal = tm.JointRegionGoal([-3.0], 0.05, joints=["j1"], wrap=False)
    problem = tm.Problem(robot, [3.0, 0.1], goal)
    assert tm.lower_bound(problem).T > 2.9


def test_goal_set_chooses_the_goal_nearest_by_whole_turns(robot: tm.Robot) -> None:
    goal = tm.AnyGoal([tm.JointGoal([6.2, 0.1]), tm.JointGoal([2.0, 0.5])])
    found = end_of(robot, [0.0, 0.1], goal)
    assert found == pytest.approx([6.2 - TURN, 0.1], abs=1e-5)


def test_segments_continue_from_the_turn_of_the_last_segment(robot: tm.Robot) -> None:
    goals = [tm.JointGoal([q, 0.1]) for q in (2.0, -2.5, -0.5, 1.5)]
    segments = [tm.Segment(goal, stop=True) for goal in goals]
    problem = tm.Problem(robot, [0.0, 0.1], segments=segments, motion_limits=LIMITS)
    solution = tm.plan(problem, **QUICK)
    ends = [part.trajectory.q[-1, 0] for part in solution.segments]
    expected = [2.0, TURN - 2.5, TURN - 0.5, TURN + 1.5]
    assert ends == pytest.approx(expected, abs=1e-4)
    assert "j1 a turn above the number given of segment 2" in solution.message


def test_pose_goal_is_reached_at_the_nearest_turn(robot: tm.Robot) -> None:
    found = end_of(robot, [3.0 + 4 * TURN, 0.1], pose(robot, [-3.0, 0.4]))
    assert found == pytest.approx([5 * TURN - 3.0, 0.4], abs=1e-4)


def test_tour_is_continuous_across_its_motions(robot: tm.Robot) -> None:
    stations = [tm.JointGoal([-3.0, 0.4]), tm.JointGoal([9.0, 0.3])]
    stations.append(pose(robot, [-2.5, 0.3]))
    tour = tm.plan_tour(robot, [3.0, 0.1], stations, motion_limits=LIMITS)
    assert tour.success
    assert tour.cycle_time < 3.0
    ends = [motion.trajectory.q[[0, -1]] for motion in tour.motions]
    for before, after in pairwise(ends):
        assert after[0] == pytest.approx(before[-1], abs=1e-6)


def test_revolute_joint_wraps_on_request_only() -> None:
    robot = tm.load_robot("ur5")
    start = [0.0, -1.5, 1.0, 0.0, 0.5, 5.0]
    q = [0.0, -1.5, 1.0, 0.0, 0.5, -1.0]
    assert tm.Problem(robot, start, tm.JointGoal(q)).goal.configuration[5] == -1.0
    wrapped = tm.Problem(robot, start, tm.JointGoal(q, wrap=("wrist_3_joint",)))
    ends = [goal.configuration[5] for goal in wrapped.goal.alternatives]
    # A third turn would be beyond the limits of the joint.
    assert ends == pytest.approx([TURN - 1.0, -1.0])


def test_invalid_wrap_is_named_in_the_error(robot: tm.Robot) -> None:
    with pytest.raises(tm.JointNotFound, match="j9"):
        tm.Problem(robot, [0.0, 0.1], tm.JointGoal([1.0, 0.1], wrap=("j9",)))
    with pytest.raises(
        tm.ProblemError, match="wrap is 3, expected True, False or names"
    ):
        tm.JointGoal([1.0, 0.1], wrap=3)  # type: ignore[arg-type]


def test_wrap_survives_a_scenario_file(robot: tm.Robot, tmp_path: Path) -> None:
    for wrap in (True, False, ("j2",)):
        goal = tm.JointGoal([-3.0, 0.4], wrap=wrap)
        problem = tm.Problem(robot, [3.0, 0.1], goal)
        tm.save_scenario(tmp_path / "s.toml", problem)
        read = tm.load_scenario(tmp_path / "s.toml").problem
        assert read.goal == goal
        assert read.goal.configuration.tolist() == problem.goal.configuration.tolist()


def test_warm_start_with_the_same_problem_keeps_the_duration(robot: tm.Robot) -> None:
    problem = tm.Problem(robot, [3.0, 0.1], tm.JointGoal([-3.0, 0.4]))
    solution = tm.plan(problem)
    again = tm.plan(problem, start=solution)
    assert again.T == pytest.approx(solution.T, rel=1e-2)


def test_goal_in_collision_is_reported_at_its_nearest_turn(robot: tm.Robot) -> None:
    pillar = tm.Box("pillar", size=(0.1, 0.1, 2.0), position=(-0.25, 0.0, 0.4))
    expected = r"^goal in collision.*q = \[3.2832, 1.5"
    with pytest.raises(tm.ProblemError, match=expected):
        tm.Problem(robot, [2.0, 1.5], tm.JointGoal([-3.0, 1.5]), [pillar])


def test_workcell_goals_wrap_for_each_robot(robot: tm.Robot) -> None:
    cell = tm.Workcell({"a": (robot, (0, 0, 0)), "b": (robot, (2.0, 0, 0))})
    start = {"a": [3.0, 0.1], "b": [3.0, 0.1]}
    goal = tm.JointGoal([-3.0, 0.4])
    for wrap, expected in ((True, TURN - 3.0), (False, -3.0)):
        other = tm.JointGoal([-3.0, 0.4], wrap=wrap)
        problem = cell.problem(start, {"a": goal, "b": other})
        assert problem.goal.configuration[0] == pytest.approx(expected)
