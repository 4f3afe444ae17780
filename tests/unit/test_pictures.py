"""Pictures of motions: camera view, colours of obstacles, skeletons, twins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from tominpmp.exceptions import ProblemError
from tominpmp.goals.joints import JointGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem.problem import Problem
from tominpmp.problem.workcell import Workcell
from tominpmp.robot.robot import load_robot
from tominpmp.scene.motion import ConstantVelocity
from tominpmp.scene.obstacles import Box, Cylinder, Sphere
from tominpmp.viz.playback import play
from tominpmp.viz.shares import shares_of_limits
from tominpmp.viz.skeleton import camera_view, points_in_view, skeleton
from tominpmp.viz.surroundings import (
    FURNITURE_RGB,
    HAZARD_RGB,
    obstacle_color,
)

START, END = np.array([0.5, 1.7, -1.7]), np.array([0.9, -1.2, -0.9])


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem(load_robot("planar3r"), START, JointGoal(END))


def straight(problem: Problem, q_end: np.ndarray, duration: float = 1.0) -> Trajectory:
    """A motion from rest to rest by a cubic."""
    q = np.stack([problem.q_start, q_end])
    zero = np.zeros_like(q)
    return Trajectory(
        problem.robot.joint_names, np.array([0.0, duration]), q, zero, zero
    )


def test_furniture_is_grey_and_hazards_are_red() -> None:
    table = Box("table", size=(1.0, 1.0, 0.05))
    post = Box("post", size=(0.1, 0.1, 1.0))
    gate = Box("gate", size=(2, 0.1, 1), motion=ConstantVelocity((0, 0.5, 0)))
    assert obstacle_color(table) == FURNITURE_RGB
    for hazard in (
        post,
        gate,
        Sphere("ball", radius=0.1),
        Cylinder("can", radius=0.1, length=1),
    ):
        assert obstacle_color(hazard) == HAZARD_RGB


def test_camera_view_of_the_hand_is_not_blocked_by_obstacles() -> None:
    arm = load_robot("panda", group="panda_arm")
    q = np.array([[0.2 * i - 0.4, 0.3, 0.0, -1.8, 0.0, 2.0, 0.8] for i in range(5)])
    points = skeleton(arm, q, "panda_hand").points
    free = camera_view(points).normal
    side = np.sign(free[1])
    wall = np.array([[-4.5, 0.85 * side, -3.5], [4.5, 0.9 * side, 5.5]])
    past = camera_view(points, obstacles=[wall]).normal
    assert past @ free < 0.9
    assert past[1] * side < 0.1
    assert past[2] > 0.0


def test_large_and_distant_obstacles_do_not_enlarge_the_view() -> None:
    robot = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]])
    table = np.array([[-5.0, -5.0, -0.1], [5.0, 5.0, 0.0]])
    far = table + np.array([0.0, 0.0, 20.0])
    np.testing.assert_array_equal(points_in_view(robot, [table, far]), robot)
    # A bench is in view as far as the robot extends, and a little beyond.
    bench = np.array([[0.3, -5.0, -0.1], [0.6, 5.0, 0.0]])
    points = points_in_view(robot, [table, bench, far])
    assert np.ptp(points, axis=0).max() < 1.6
    assert points[:, 2].min() == pytest.approx(-0.1)
    assert points[:, 2].max() == pytest.approx(1.0)


def test_skeleton_of_a_workcell_has_its_arms_but_not_the_origin_of_the_world() -> None:
    arm = load_robot("planar3r")
    far, turned = (
        pin.SE3(np.diag([way, way, 1.0]), np.array([x, 0.0, 0.0]))
        for way, x in ((1.0, 20.0), (-1.0, 34.0))
    )
    cell = Workcell({"a": (arm, far), "b": (arm, turned)})
    x = np.sort(skeleton(cell.robot, np.zeros((1, 6)), "a/tip").points[0, :, 0])
    np.testing.assert_allclose(x, [20, 23, 25, 26, 28, 29, 31, 34], atol=1e-12)


def test_shares_of_limits_include_the_effort_scale(problem: Problem) -> None:
    motion = straight(problem, END)
    shares = shares_of_limits(problem, motion)
    fastest = 1.5 * np.abs(END - START) / problem.robot.limits.velocity
    np.testing.assert_allclose(np.abs(shares.speed).max(axis=0), fastest, rtol=1e-3)
    half = Problem(
        problem.robot,
        START,
        JointGoal(END),
        motion_limits=MotionLimits(effort_scale=0.5),
    )
    tight = shares_of_limits(half, motion)
    np.testing.assert_allclose(tight.torque, 2.0 * shares.torque)


def test_page_plays_a_pale_twin_of_the_same_joints(
    problem: Problem, tmp_path: Path
) -> None:
    path = tmp_path / "motion.html"
    slow = straight(problem, END, 2.0)
    play(problem, straight(problem, END), path=path, twins={"slow": slow}, fps=10.0)
    assert "pale: slow, T = 2 s" in path.read_text("utf-8")
    other = Problem(
        load_robot("planar3r", locked_joints={"joint3": 0.0}),
        END[:2],
        JointGoal(START[:2]),
    )
    with pytest.raises(ProblemError, match="joint"):
        play(problem, slow, path=path, twins={"wrong": straight(other, START[:2])})
