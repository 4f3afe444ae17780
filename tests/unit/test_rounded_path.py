"""Rounded paths and their timing."""

from __future__ import annotations

import numpy as np
import pytest
from guess_samples import END, START, gantry, maze, time_straight_line, timed, wall

import tominpmp as tm
from tominpmp.initial_guess.guess import SAMPLED, along
from tominpmp.initial_guess.path import RoundedPath, speed_weights
from tominpmp.initial_guess.rrt import is_free
from tominpmp.transcription.problem_functions import ProblemFunctions

CORNERS = np.array([[0.0, 0.0], [1.0, 0.5], [1.5, -1.0], [2.0, 0.0]])


@pytest.fixture
def path():
    return RoundedPath.through(CORNERS, np.array([1.0, 2.0]))


def test_path_runs_from_the_first_to_the_last_corner(path):
    q, _, _ = path.evaluate(np.array([0.0, 1.0]))
    np.testing.assert_allclose(q, CORNERS[[0, -1]], atol=1e-15)


def test_path_parameter_is_shared_by_time_at_the_speed_limits(path):
    # Joint 1 is slowest on all pieces but the second, where joint 2 needs 1.5 / 2 s.
    np.testing.assert_allclose(np.diff(path.s), np.array([1.0, 0.75, 0.5]) / 2.25)


def test_derivatives_of_a_path_match_finite_differences(path):
    s, h = np.linspace(0.003, 0.997, 400), 1e-6
    _, first, second = path.evaluate(s)
    before, after = path.evaluate(s - h), path.evaluate(s + h)
    np.testing.assert_allclose((after[0] - before[0]) / (2 * h), first, atol=1e-6)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * h), second, atol=1e-3)
    # Both derivatives are continuous, of which the polyline has neither.
    assert np.abs(after[1] - before[1]).max() < 1e-3
    assert np.abs(after[2] - before[2]).max() < 1e-2


def test_path_leaves_the_polyline_only_at_rounded_corners(path):
    s = np.linspace(0, 1, 1001)
    columns = [np.interp(s, path.s, column) for column in CORNERS.T]
    off = np.abs(path.evaluate(s)[0] - np.stack(columns, axis=1)).max(axis=1)
    rounded = np.any(np.abs(s[:, None] - path.s) < path.radii, axis=1)
    assert off[~rounded].max() < 1e-12
    slopes = np.diff(CORNERS, axis=0) / np.diff(path.s)[:, None]
    jumps = np.abs(np.diff(slopes, axis=0)).max(axis=1)
    assert off.max() == pytest.approx(
        3 / 16 * (path.radii[1:-1] * jumps).max(), rel=0.01
    )


def test_repeated_corners_are_left_out():
    doubled = np.repeat(CORNERS, 2, axis=0)
    path = RoundedPath.through(doubled, np.ones(2))
    np.testing.assert_array_equal(path.corners, CORNERS)


def test_a_joint_without_speed_limit_counts_as_the_slowest():
    np.testing.assert_allclose(
        speed_weights(np.array([2.0, np.inf, 0.5])), [0.5, 2.0, 2.0]
    )
    np.testing.assert_allclose(speed_weights(np.full(2, np.inf)), 1.0)


def test_roundings_are_narrowed_where_they_meet_an_obstacle(tmp_path):
    # Over a wall that the inside of the wide rounding cuts.
    system = maze(tmp_path, wall("low", 0.0, -2.0, 0.8))
    corners = np.array([START, (0.0, 1.0), END])
    wide = RoundedPath.through(corners, np.full(2, 2.0))
    s = np.linspace(0, 1, 300)

    def blocked(path):
        return [not is_free(system, q) for q in path.evaluate(s)[0]]

    narrow = wide.clear_of_obstacles(lambda q: is_free(system, q))
    assert np.any(blocked(wide)) and not np.any(blocked(narrow))
    assert 0.0 < narrow.radii[1] < wide.radii[1]


def test_timing_of_collinear_corners_is_that_of_the_line():
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, (0.5, 1.7, -1.7), tm.JointGoal((1.5, 0.2, 0.5)))
    system = ProblemFunctions.of(problem)
    ends = np.stack([problem.q_start, problem.goal.q])
    shares = np.array([0.0, 0.3, 0.35, 0.8, 1.0])[:, None]
    corners = ends[0] + shares * (ends[1] - ends[0])
    timing = timed(system, corners)
    line = time_straight_line(system, *ends)
    assert timing.duration == pytest.approx(line.duration, rel=2e-3)


def test_torques_are_saturated_along_a_timed_path():
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, (0.5, 1.7, -1.7), tm.JointGoal((1.5, 0.2, 0.5)))
    system = ProblemFunctions.of(problem)
    corners = np.array(
        [problem.q_start, (0.9, 0.5, -1.0), (1.1, 0.8, 0.3), (1.5, 0.2, 0.5)]
    )
    timing = timed(system, corners)
    t = np.linspace(0, timing.duration, 4000)[2:-2]
    h = 1e-4
    q, before, after = (timing.position(t + d) for d in (0.0, -h, h))
    v, a = (after - before) / (2 * h), (after - 2 * q + before) / h**2
    load = np.abs(system.torque(q, v, a)).max(axis=1)
    assert np.quantile(load, 0.9) < 1.05
    assert np.mean(load > 0.95) > 0.8  # nearly always saturated
    np.testing.assert_allclose(
        timing.position(np.array([timing.duration]))[0], corners[-1]
    )


def test_timing_round_a_corner_is_between_bounds(tmp_path):
    robot = gantry(tmp_path)
    problem = tm.Problem(robot, START, tm.JointGoal((0.5, 1.5)))
    system = ProblemFunctions.of(problem)
    corners = np.array([START, (0.5, 0.0), (0.5, 1.5)])
    timing = timed(system, corners)
    # Both joints go with 10 m/s^2 up to 2 m/s: d / 2 + 0.2 from rest to rest.
    alone, stopping = 2.0 / 2 + 0.2, 2.0 / 2 + 0.2 + 1.5 / 2 + 0.2
    assert alone < timing.duration < stopping
    q = timing.position(np.linspace(0, timing.duration, 1000))
    speed = np.abs(np.gradient(q, timing.duration / 999, axis=0)).max(axis=0)
    assert np.all(speed < 2.0 * 1.02)


def test_path_guess_is_timed_and_free(tmp_path):
    system = maze(tmp_path, wall("low", 0.0, -2.0, 0.8))
    guess = along(system, np.array([START, (0.0, 1.0), END]), SAMPLED, clear=True)
    assert guess.timed and guess.name == "sampled path"
    assert all(
        is_free(system, q) for q in guess.position(np.linspace(0, guess.duration, 99))
    )
    np.testing.assert_allclose(guess.q[[0, -1]], [START, END], atol=1e-9)


def test_path_guess_where_gravity_exceeds_torques_is_not_timed():
    robot = tm.load_robot("planar3r", effort={"joint1": 2.0})
    start, goal = (np.pi / 2, 0.0, 0.0), (np.pi / 2 + 0.01, 0.0, 0.0)
    system = ProblemFunctions.of(tm.Problem(robot, start, tm.JointGoal(goal)))
    guess = along(system, np.array([start, (0.2, 0.0, 0.0), goal]), SAMPLED, clear=True)
    assert not guess.timed
    assert guess.duration > 0.0
    assert guess.q[:, 0].min() < 1.0  # it goes towards the corner and turns
    np.testing.assert_allclose(guess.q[-1], goal)


@pytest.mark.parametrize("count", [2, 3])
def test_path_guess_without_length_is_at_rest(tmp_path, count):
    """Regression: a sampled path ended at its start, and its parameter was NaN."""
    system = maze(tmp_path, wall("low", 0.0, -2.0, 0.8))
    guess = along(system, np.tile(START, (count, 1)), SAMPLED, clear=True)
    assert not guess.timed and guess.duration > 0.0
    np.testing.assert_array_equal(guess.q, np.tile(START, (len(guess.t), 1)))
