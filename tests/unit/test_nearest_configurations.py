"""Configurations that reach a goal on a frame are moved towards the start."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pinocchio as pin
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, rod
from tominpmp.initial_guess.guess import GuessRequest, straight_guess
from tominpmp.initial_guess.inverse_kinematics import Target, moved_nearer
from tominpmp.kinematics import RobotKinematics
from tominpmp.stopping import Deadline, Stop
from tominpmp.transcription.problem_functions import ProblemFunctions


def test_redundant_configuration_is_moved_as_near_the_start_as_possible():
    # Four joints in a plane, two of them left free by the place of the tip.
    robot = make_arm(*[rod(1.0, 0.5)] * 4, effort=50.0, velocity=1.0)
    start, there = np.array([0.3, 0.4, 0.5, 0.6]), np.array([-0.5, 1.2, -0.4, 1.5])
    place = RobotKinematics(robot).placement(there, "tip").translation
    system = ProblemFunctions.of(
        tm.Problem(robot, start, tm.PositionGoal("tip", place))
    )
    goal = system.problem.goal
    (led,) = moved_nearer(Target(system, goal), [there])
    past = Deadline()
    past.end = 0.0
    with past.in_force(), pytest.raises(Stop):
        moved_nearer(Target(system, goal), [there])
    led, miss = Target(system, goal).solve(led)
    assert miss < 1e-6 and np.abs(led - there).max() < 2.0  # the same branch

    def far(q):
        return np.linalg.norm(q - start, 4)

    assert far(led) < 0.8 * far(there)
    free = np.linalg.svd(goal.place_residual(system.kinematics, led)[1])[2][-2:]
    for step in (*free, *-free):
        beside, miss = Target(system, goal).solve(led + 0.05 * step)
        assert miss < 1e-6 and far(beside) > far(led)


def test_search_finds_a_configuration_that_random_starts_miss():
    # No configuration found from random starts is reached on a line in less than
    # 0.88 s; the fastest motion takes 0.81 s and ends elsewhere.
    robot = tm.load_robot("ur5", limits="urdf")
    start = np.array([1.4697, 2.1336, 0.3214, 2.1879, 1.9678, 1.0154])
    goal = tm.PositionGoal("tool0", (0.1144, 0.1252, 0.0941))
    problem = tm.Problem(robot, start, goal)
    system = ProblemFunctions.of(problem)
    found = Target(system, problem.goal).configurations(20, np.random.default_rng(0))
    assert min(straight_guess(system, q).duration for q in found.free[:10]) < 0.85


def test_fastest_line_comes_first_under_acceleration_limits():
    down = np.diag([1.0, -1.0, -1.0])
    # 5 rad/s^2 slow the line of 15 cm, but not the line to the other side of the arm.
    problem = tm.Problem(
        tm.load_robot("ur10"),
        np.array([0.428, -1.299, 1.464, -1.735, -1.571, -1.142]),
        tm.PoseGoal("tool0", pin.SE3(down, np.array([0.7, 0.5, 0.381]))),
    )
    system, rng = ProblemFunctions.of(problem), np.random.default_rng(0)
    lines = list(islice(GuessRequest(rng).guesses(system), 3))
    assert lines[0].duration == min(line.duration for line in lines) < 0.6
