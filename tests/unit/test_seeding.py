"""Initial guesses: timing of straight lines, inverse kinematics, guesses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

import tominpmp as tm
from tominpmp.seeding.guess import initial_guesses
from tominpmp.seeding.inverse_kinematics import goal_configurations
from tominpmp.seeding.timing import time_straight_line
from tominpmp.transcription.system import System

SLIDER = """<robot name="slider"><link name="base"/>
<link name="cart"><inertial><mass value="2"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="cart"/>
<axis xyz="1 0 0"/><limit lower="-5" upper="5" effort="8" velocity="{velocity}"/>
<dynamics damping="{damping}"/></joint></robot>"""


def slider(tmp_path, q_goal, *, velocity=100.0, damping=0.0):
    path = tmp_path / "slider.urdf"
    path.write_text(SLIDER.format(velocity=velocity, damping=damping))
    return System.of(tm.Problem(tm.load_robot(path), [0.0], tm.JointGoal([q_goal])))


@pytest.mark.parametrize("distance", [0.3, -2.0])
def test_timing_of_a_mass(tmp_path, distance):
    system = slider(tmp_path, distance)
    line = time_straight_line(system, np.zeros(1), np.array([distance]))
    # Mass 2 kg, force 8 N: T* = 2 sqrt(d m / F).
    assert line.duration == pytest.approx(2 * np.sqrt(abs(distance) / 4), rel=2e-3)


def test_timing_with_a_speed_limit(tmp_path):
    system = slider(tmp_path, 3.0, velocity=2.0)
    line = time_straight_line(system, np.zeros(1), np.array([3.0]))
    assert line.duration == pytest.approx(3 / 2 + 2 / 4, rel=2e-3)
    q = line.position(np.linspace(0, line.duration, 500))
    assert np.max(np.abs(np.gradient(q[:, 0], line.duration / 499))) <= 2.0 * 1.01


def test_timing_with_friction_is_between_bounds(tmp_path):
    """Friction 4 N s/m under 8 N: terminal speed 2 m/s, braking helped."""
    free = time_straight_line(slider(tmp_path, 3.0), np.zeros(1), np.array([3.0]))
    system = slider(tmp_path, 3.0, damping=4.0)
    line = time_straight_line(system, np.zeros(1), np.array([3.0]))
    assert line.duration > max(free.duration, 3.0 / 2.0)

    # Bang-bang with v' = (+-8 - 4 v) / 2, switched where both curves meet.
    def speed_up(t):
        return 2 * (1 - np.exp(-2 * t)), 2 * (t - (1 - np.exp(-2 * t)) / 2)

    def distance_left(t):
        v, x = speed_up(t)
        return x + v / 2 - np.log(1 + v / 2) - 3.0

    t1 = brentq(distance_left, 0.1, 10)
    v1, _ = speed_up(t1)
    assert line.duration == pytest.approx(t1 + np.log(1 + v1 / 2) / 2, rel=3e-3)


def test_torques_hold_along_a_timed_line():
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, (0.5, 1.7, -1.7), tm.JointGoal((1.5, 0.2, 0.5)))
    system = System.of(problem)
    line = time_straight_line(system, problem.q_start, problem.goal.q)
    t = np.linspace(0, line.duration, 4000)[1:-1]
    h = 1e-4
    q, before, after = line.position(t), line.position(t - h), line.position(t + h)
    v, a = (after - before) / (2 * h), (after - 2 * q + before) / h**2
    load = np.abs(system.torque(q, v, a))
    # The acceleration is constant between grid points, so that a few per cent are lost.
    assert np.quantile(load.max(axis=1), 0.95) < 1.02
    assert np.mean(load.max(axis=1) > 0.97) > 0.9  # at every time a limit is met


def test_no_timing_where_the_arm_cannot_stand(tmp_path):
    robot = tm.load_robot("planar3r", effort={"joint1": 2.0})
    start, goal = (np.pi / 2, 0.0, 0.0), (np.pi / 2 + 0.01, 0.0, 0.0)
    low = tm.Problem(robot, start, tm.JointGoal(goal))
    system = System.of(low)
    through = time_straight_line(system, np.array([0.2, 0, 0]), np.array(goal))
    assert through is None


def test_inverse_kinematics_finds_several_distinct_configurations():
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, (0.5, 1.7, -1.7), tm.PositionGoal("tip", (4, 1, 0)))
    system = System.of(problem)
    found, least = goal_configurations(
        system, problem.goal, 20, np.random.default_rng(0)
    )
    assert len(found) >= 5
    assert least == 0.0
    limits = robot.limits
    for q in found:
        error = np.linalg.norm(problem.goal.place_residual(system.kinematics, q)[0])
        assert error < 1e-6
        assert np.all(q >= limits.position_lower) and np.all(q <= limits.position_upper)


def test_guesses_are_reproducible_and_end_at_the_goal():
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, (0.5, 1.7, -1.7), tm.JointGoal((1.0, 0.5, 0.5)))
    system = System.of(problem)
    one = list(initial_guesses(system, 4, np.random.default_rng(5)))
    two = list(initial_guesses(system, 4, np.random.default_rng(5)))
    assert len(one) == 4
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.q, b.q)
        np.testing.assert_allclose(a.q[-1], problem.goal.q, atol=1e-9)
        np.testing.assert_allclose(a.q[0], problem.q_start, atol=1e-9)


def test_guesses_for_a_frame_begin_at_rest_and_reach_the_goal_after():
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, (0.5, 1.7, -1.7), tm.PositionGoal("tip", (4, 1, 0)))
    system = System.of(problem)
    first, *others = initial_guesses(system, 4, np.random.default_rng(5))
    np.testing.assert_array_equal(first.q, np.tile(problem.q_start, (2, 1)))
    assert len(others) == 3
    for guess in others:
        error, _ = problem.goal.place_residual(system.kinematics, guess.q[-1])
        assert np.linalg.norm(error) < 1e-6
