"""Paths around obstacles by RRT-Connect: validity, seeds, failures, alternatives."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pinocchio as pin
import pytest
from guess_samples import END, START, fine, maze, wall
from test_goals_close_to_obstacles import RAIL

import tominpmp as tm
from tominpmp.collision.checker import CollisionChecker
from tominpmp.initial_guess.rrt import (
    PathSearches,
    _Space,
    alike,
    is_free,
    is_free_line,
    sample_path,
    sample_paths,
)
from tominpmp.kinematics import RobotKinematics
from tominpmp.stopping import Deadline, Stop
from tominpmp.transcription.problem_functions import ProblemFunctions


def zigzag(folder):
    return maze(folder, wall("first", -0.6, -2.0, 1.2), wall("second", 0.6, -1.2, 2.0))


def test_path_leads_through_a_maze(tmp_path):
    system = zigzag(tmp_path)
    path = sample_path(system, np.array(END), 1, PathSearches())
    np.testing.assert_array_equal(path[[0, -1]], [START, END])
    points = fine(path)
    # Branches are checked every 0.05 of the reach; between these a corner may be cut.
    assert max(system.clearance.values(points, np.inf).max(), 0.0) * system.reach < 0.02
    assert np.interp(-0.6, points[:, 0], points[:, 1]) > 1.2
    assert np.interp(0.6, points[:, 0], points[:, 1]) < -1.2
    assert len(path) < 20  # it was simplified


def test_path_depends_on_its_seed_alone(tmp_path):
    system = zigzag(tmp_path)
    paths = [
        sample_path(system, np.array(END), seed, PathSearches())
        for seed in (3, 3, 4, 3)
    ]
    np.testing.assert_array_equal(paths[0], paths[1])
    np.testing.assert_array_equal(paths[0], paths[3])
    assert paths[0].shape != paths[2].shape or not np.allclose(paths[0], paths[2])


def test_every_other_branch_keeps_the_orientation_of_the_last_link():
    arm = tm.load_robot("ur5", limits="urdf")
    rng = np.random.default_rng(5)
    start, end = rng.uniform(-1.5, 1.5, (2, arm.n))
    system = ProblemFunctions.of(tm.Problem(arm, start, tm.JointGoal(end)))
    space = _Space(system, end, 100)
    points, steps = rng.uniform(-1.5, 1.5, (2, 4, arm.n))
    kept = space.without_turning(points, 1e-4 * steps)
    kinematics = RobotKinematics(arm)
    for point, step, asked in zip(points, kept, 1e-4 * steps, strict=True):
        ends = (point * space.unit, (point + step) * space.unit)
        places = [kinematics.placement(q, "wrist_3_link") for q in ends]
        assert (
            np.linalg.norm(pin.log3(places[0].rotation.T @ places[1].rotation)) < 1e-7
        )
        assert step @ (asked - step) == pytest.approx(0.0, abs=1e-15)  # a projection
        assert np.linalg.norm(step) > 0.1 * np.linalg.norm(asked)


def test_branches_of_arms_of_few_joints_turn_the_last_link(planar3r):
    system = ProblemFunctions.of(
        tm.Problem(planar3r, (0.3, 0.0, 0.0), tm.JointGoal((1.4, 0.0, 0.0)))
    )
    steps = np.array([[0.3, 0.0, 0.1], [-0.2, 0.1, 0.0]])
    space = _Space(system, np.ones(3), 100)
    np.testing.assert_array_equal(space.without_turning(np.ones((2, 3)), steps), steps)


def test_path_of_an_arm_leads_around_a_ball(planar3r):
    # The stretched arm would sweep across the ball: it has to fold.
    scene = tm.Scene([tm.Sphere("O", radius=0.6, position=(3.2, 3.2, 0))])
    goal = tm.JointGoal((1.4, 0.0, 0.0))
    system = ProblemFunctions.of(
        tm.Problem(planar3r, (0.3, 0.0, 0.0), goal, scene=scene)
    )
    line = fine(np.stack([system.problem.q_start, goal.q]))
    assert not all(is_free(system, q) for q in line)
    path = sample_path(system, goal.q, 1, PathSearches())
    assert max(system.clearance.values(fine(path), np.inf).max(), 0.0) < 0.02
    limits = planar3r.limits
    assert np.all((path >= limits.position_lower) & (path <= limits.position_upper))


@pytest.mark.parametrize("without_limit", [2, 3])
def test_path_of_joints_without_a_speed_limit_is_found(without_limit):
    """Half of the joints without a limit made the unit of the others zero."""
    fast = dict.fromkeys(("joint1", "joint2", "joint3")[:without_limit], np.inf)
    robot = tm.load_robot("planar3r", velocity=fast)
    ball = tm.Sphere("ball", radius=0.5, position=(3.5, 3.0, 0.0))
    goal = np.array([1.2, 1.5, -1.5])
    problem = tm.Problem(robot, (0.5, 1.7, -1.7), tm.JointGoal(goal), scene=[ball])
    system = ProblemFunctions.of(problem)
    assert is_free(system, sample_path(system, goal, 1, PathSearches()))


def test_path_within_very_narrow_joint_ranges_is_found():
    """The joint ranges are narrower than the distance between checks of a branch."""
    room = {"position_lower": -0.005, "position_upper": 0.005}
    scene = tm.Scene([tm.Sphere("O", radius=0.6, position=(3.2, 3.2, 0))])
    start, end = np.full(3, -0.004), np.full(3, 0.004)
    arm = tm.load_robot("planar3r", **room)
    problem = tm.Problem(arm, start, tm.JointGoal(end), scene=scene)
    path = sample_path(ProblemFunctions.of(problem), end, 1, PathSearches())
    np.testing.assert_array_equal(path, [start, end])


def test_message_on_a_closed_wall_names_joint_and_obstacle(tmp_path):
    system = maze(tmp_path, wall("closed", 0.0, -3.0, 3.0))
    rng, searches = np.random.default_rng(0), PathSearches(checks=500)
    assert not list(sample_paths(system, [np.array(END)], rng, searches))
    assert not searches.found
    assert "no path around the obstacles was found: from the " in searches.impasse
    assert "joint 'x' came no farther than " in searches.impasse
    closed = "and obstacle 'closed' collide; more clearance may open a way"
    assert closed in searches.impasse


def test_failed_searches_are_followed_by_longer_searches(tmp_path):
    """Regression: searches of equal length failed one after the other."""
    system, searches = zigzag(tmp_path), PathSearches(checks=50)
    rng, ends, failed = np.random.default_rng(0), [np.array(END)], 0
    while (path := next(sample_paths(system, ends, rng, searches), None)) is None:
        failed += 1
    assert failed and searches.found and path is not None
    assert searches.checks > 50


def test_search_stops_when_the_time_is_up(tmp_path):
    system, searches, past = zigzag(tmp_path), PathSearches(), Deadline()
    past.end = time.perf_counter() - 1.0
    with past.in_force(), pytest.raises(Stop):
        sample_path(system, np.array(END), 1, searches)
    # A search that was cut short says nothing about the obstacles.
    assert not searches.impasse


def test_end_in_collision_has_no_path(tmp_path):
    system = zigzag(tmp_path)
    inside = np.array([0.6, 0.0])
    assert sample_path(system, inside, 1, PathSearches()) is None
    ends = [inside, np.array(END)]
    path = next(sample_paths(system, ends, np.random.default_rng(0), PathSearches()))
    np.testing.assert_array_equal(path[-1], END)


def test_paths_around_a_block_pass_on_both_sides(tmp_path):
    system = maze(tmp_path, wall("block", 0.0, -0.8, 0.8))
    rng = np.random.default_rng(0)
    paths = list(sample_paths(system, [np.array(END)], rng, PathSearches()))
    heights = [np.interp(0.0, fine(p)[:, 0], fine(p)[:, 1]) for p in paths]
    assert min(heights) < -0.8 and max(heights) > 0.8
    for one, other in itertools.combinations(paths, 2):
        assert not alike(system, one, other)


def test_ends_take_turns_and_the_order_is_reproducible(tmp_path):
    system = maze(tmp_path, wall("block", 0.0, -0.8, 0.8))
    ends = [np.array(END), np.array((1.5, -1.5))]

    def two():
        paths = sample_paths(system, ends, np.random.default_rng(7), PathSearches())
        return list(itertools.islice(paths, 2))

    one, other = two(), two()
    for path, again, end in zip(one, other, ends, strict=True):
        np.testing.assert_array_equal(path[-1], end)
        np.testing.assert_array_equal(path, again)


def test_known_paths_are_not_found_again(tmp_path):
    system = maze(tmp_path, wall("block", 0.0, -0.8, 0.8))
    over = np.array([START, (0.0, 1.4), END])
    rng = np.random.default_rng(0)
    paths = list(
        sample_paths(system, [np.array(END)], rng, PathSearches(), known=[over])
    )
    assert paths and all(not alike(system, over, path) for path in paths)


def test_lines_are_checked_along_their_length(tmp_path):
    system = maze(tmp_path, wall("block", 0.0, -0.8, 0.8))
    assert not is_free_line(system, np.array(START), np.array(END))
    assert is_free_line(system, np.array((-1.5, 1.2)), np.array((1.5, 1.2)))


def test_paths_are_alike_if_they_deform_into_each_other(tmp_path):
    system = maze(tmp_path, wall("block", 0.0, -0.5, 0.5))
    over = np.array([START, (0.0, 0.8), END])
    high = np.array([START, (-1.0, 1.6), (1.0, 1.6), END])
    under = over * (1, -1)
    assert alike(system, over, high)
    assert not alike(system, over, under)
    elsewhere = np.array([START, (0.0, 0.8), (1.5, 1.5)])
    assert not alike(system, over, elsewhere)


def test_failed_search_for_further_paths_gives_no_message(tmp_path):
    """Regression: one path was known, and the message was that no path was found."""
    system = maze(tmp_path, wall("closed", 0.0, -3.0, 3.0))
    ends, known = [np.array(END)], [np.array([START, END])]
    rng, searches = np.random.default_rng(0), PathSearches(checks=500)
    paths = sample_paths(system, ends, rng, searches, known=known)
    assert not list(paths) and not searches.impasse


def test_search_for_a_single_joint_ends_early(monkeypatch):
    """Regression: in a gap narrower than the padding, 80 000 checks took 10 s."""
    begin, end = np.array([-0.5]), np.array([0.5])
    wall = tm.Box("wall", size=(0.1, 0.2, 1.0), position=(0.0, 0.14, 0.0))
    arm, scene = tm.load_robot(RAIL), tm.Scene([wall])
    system = ProblemFunctions.of(tm.Problem(arm, begin, tm.JointGoal(end), scene))
    checks, checked = [], CollisionChecker.each_free

    def counted(*args):
        checks.append(args)
        return checked(*args)

    monkeypatch.setattr(CollisionChecker, "each_free", counted)
    searches = PathSearches()
    assert sample_path(system, end, 1, searches) is None
    assert len(checks) < 2000
    assert "joint 'slide' came no farther than 0.35 of 1 m" in searches.impasse
    assert "link 'cube' and obstacle 'wall' collide" in searches.impasse
