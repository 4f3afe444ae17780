"""Barriers: obstacles that one joint cannot pass, whatever the other joints do."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.collision.checker import CollisionChecker
from tominpmp.planner.barriers import find_barrier
from tominpmp.status import Status

START, GOAL = [2.5, 1.4, 0.5], [0.5, -1.4, -0.5]
FORGIVEN = 1e-5


@pytest.fixture(scope="module")
def arm() -> tm.Robot:
    """The planar arm: its first link is 3 m long."""
    return tm.load_robot("planar3r")


def ball(distance: float, radius: float = 0.1, **more: object) -> tm.Scene:
    """A ball on the y axis, at a distance from the base."""
    place = [0.0, distance, 0.0]
    return tm.Scene([tm.Sphere("ball", radius=radius, position=place, **more)])


def test_barrier_of_the_first_link_makes_the_problem_infeasible(arm: tm.Robot) -> None:
    problem = tm.Problem(arm, START, tm.JointGoal(GOAL), ball(2.0))

    solution = tm.plan(problem)

    assert solution.status is Status.INFEASIBLE
    assert not solution.success
    assert solution.trajectory is None
    assert "No motion exists: joint 'joint1' has to pass 1.5" in solution.message
    assert "link 'link1' and obstacle 'ball' lack 0.09" in solution.message
    assert solution.planning_time < 1.0


def test_obstacle_that_a_second_link_can_avoid_is_no_barrier(arm: tm.Robot) -> None:
    problem = tm.Problem(arm, START, tm.JointGoal(GOAL), ball(3.5))

    assert not find_barrier(problem, FORGIVEN)
    assert tm.plan(problem, objective="feasible").success


def test_margin_can_make_an_obstacle_a_barrier(arm: tm.Robot) -> None:
    goal, scene = tm.JointGoal(GOAL), ball(3.12)

    near = tm.Problem(arm, START, goal, scene, margin=0.0)
    with_margin = tm.Problem(arm, START, goal, scene, margin=0.05)

    assert not find_barrier(near, FORGIVEN)
    barrier = find_barrier(with_margin, FORGIVEN)
    assert 0.0 < float(barrier.split("lack ")[1].split(" m")[0]) < 0.05


def test_moving_obstacle_is_no_barrier(arm: tm.Robot) -> None:
    away = tm.ConstantVelocity([0.0, 0.5, 0.0])
    problem = tm.Problem(arm, START, tm.JointGoal(GOAL), ball(2.0, motion=away))

    assert not find_barrier(problem, FORGIVEN)


def test_barrier_must_bar_every_goal_of_a_set(arm: tm.Robot) -> None:
    this_side = [2.2, 1.0, 0.0]
    one = tm.Problem(arm, START, tm.AnyGoal([tm.JointGoal(GOAL)] * 2), ball(2.0))
    goals = tm.AnyGoal([tm.JointGoal(GOAL), tm.JointGoal(this_side)])
    two = tm.Problem(arm, START, goals, ball(2.0))

    assert find_barrier(one, FORGIVEN)
    assert not find_barrier(two, FORGIVEN)


def test_message_names_the_segment_with_the_barrier(arm: tm.Robot) -> None:
    stations = [
        tm.Segment(tm.JointGoal([2.2, 1.0, 0.0])),
        tm.Segment(tm.JointGoal(GOAL)),
    ]
    problem = tm.Problem(arm, START, scene=ball(2.0), segments=stations)

    barrier = find_barrier(problem, FORGIVEN)

    assert "on segment 2," in barrier
    assert tm.plan(problem).message == barrier


def test_goal_on_a_frame_has_no_barrier(arm: tm.Robot) -> None:
    goal = tm.PositionGoal("tip", [3.0, 2.0, 0.0])
    problem = tm.Problem(arm, START, goal, ball(2.0))

    assert not find_barrier(problem, FORGIVEN)


@pytest.mark.parametrize("name", ["panda", "planar3r", "ur5"])
def test_single_joints_decide_the_distances_of_their_pairs(name: str) -> None:
    """These distances change with their single joint, and with no other joint."""
    robot = tm.load_robot(name)
    scene = tm.Scene([tm.Box("box", size=[0.2, 0.3, 0.4], position=[0.6, 0.7, 0.3])])
    checker = CollisionChecker(robot, scene, self_collision=True)
    lone = checker.single_joints
    rng = np.random.default_rng(7)
    low = np.maximum(robot.limits.position_lower, -np.pi)
    high = np.minimum(robot.limits.position_upper, np.pi)
    for joint in range(robot.n):
        q = rng.uniform(low, high, (12, robot.n))
        q[:, joint] = q[0, joint]
        same = np.ptp(checker.distances(q), axis=0) < 1e-7
        assert np.all(same[lone == joint])
    one = np.tile(rng.uniform(low, high), (12, 1))
    for joint in set(lone[lone >= 0].tolist()):
        q = one.copy()
        q[:, joint] = np.linspace(low[joint], high[joint], 12)
        assert np.ptp(checker.distances(q)[:, lone == joint], axis=0).max() > 1e-3
    assert np.any(lone[: checker.obstacle_pairs] >= 0)


def test_barrier_of_a_continuous_joint_needs_both_directions() -> None:
    """One post bars one direction of a continuous joint, two posts bar both."""
    robot = tm.load_robot(
        """<robot name="hand"><link name="base"/><link name="hand"><inertial>
        <origin xyz="0.2 0 0"/><mass value="1"/><inertia ixx="0.01" iyy="0.01"
        izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial><collision>
        <origin xyz="0.2 0 0"/><geometry><box size="0.4 0.04 0.04"/></geometry>
        </collision></link><joint name="turn" type="continuous"><parent link="base"/>
        <child link="hand"/><axis xyz="0 0 1"/><limit velocity="3" effort="50"/>
        </joint></robot>"""
    )
    posts = [
        tm.Cylinder(f"post {x}", radius=0.03, length=1.0, position=(x, 0.0, 0.0))
        for x in (0.3, -0.3)
    ]
    goal = tm.AnyGoal([tm.JointGoal([0.5 + 0.01 * k]) for k in range(8)])
    one, both = (tm.Problem(robot, [-0.5], goal, posts[:k]) for k in (1, 2))
    assert "joint 'turn' has to pass" in find_barrier(both, FORGIVEN)
    assert not find_barrier(one, FORGIVEN)
    assert tm.plan(one, effort="quick").success
