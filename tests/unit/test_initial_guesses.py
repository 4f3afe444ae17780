"""Initial guesses: timing of straight lines, inverse kinematics, sampled paths."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from guess_samples import END, maze, time_straight_line, timed, wall
from sample_arms import two_link_arm
from scipy.optimize import brentq

import tominpmp as tm
from tominpmp.initial_guess import rrt as sampling
from tominpmp.initial_guess.guess import REST_GUESS, GuessRequest, sampled_guesses
from tominpmp.initial_guess.inverse_kinematics import (
    MOST_TRIED,
    REACHED,
    SPREAD,
    Target,
)
from tominpmp.initial_guess.rrt import is_free
from tominpmp.initial_guess.segments import segmented_guesses
from tominpmp.kinematics import RobotKinematics
from tominpmp.transcription.problem_functions import ProblemFunctions

SLIDER = """<robot name="slider"><link name="base"/>
<link name="cart"><inertial><mass value="2"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="cart"/>
<axis xyz="1 0 0"/><limit lower="-5" upper="5" effort="8" velocity="{velocity}"/>
<dynamics damping="{damping}"/></joint></robot>"""


def slider(tmp_path, q_goal, *, velocity=100.0, damping=0.0):
    path = tmp_path / "slider.urdf"
    path.write_text(SLIDER.format(velocity=velocity, damping=damping))
    return ProblemFunctions.of(
        tm.Problem(tm.load_robot(path), [0.0], tm.JointGoal([q_goal]))
    )


@pytest.mark.parametrize("distance", [0.3, -2.0])
def test_timing_of_a_free_mass_is_time_optimal(tmp_path, distance):
    system = slider(tmp_path, distance)
    line = time_straight_line(system, np.zeros(1), np.array([distance]))
    # Mass 2 kg, force 8 N: T* = 2 sqrt(d m / F).
    assert line.duration == pytest.approx(2 * np.sqrt(abs(distance) / 4), rel=2e-3)


def test_timing_keeps_a_speed_limit(tmp_path):
    system = slider(tmp_path, 3.0, velocity=2.0)
    line = time_straight_line(system, np.zeros(1), np.array([3.0]))
    assert line.duration == pytest.approx(3 / 2 + 2 / 4, rel=2e-3)
    q = line.position(np.linspace(0, line.duration, 500))
    assert np.max(np.abs(np.gradient(q[:, 0], line.duration / 499))) <= 2.0 * 1.01


def test_timing_with_friction_matches_the_bang_bang_solution(tmp_path):
    """Friction of 4 N s/m under 8 N: the terminal speed is 2 m/s; friction brakes."""
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


@pytest.mark.parametrize("share", [1.0, 0.8])
def test_torques_are_saturated_along_a_timed_line(share):
    robot, limits = tm.load_robot("planar3r"), tm.MotionLimits(effort_scale=share)
    start, goal = (0.5, 1.7, -1.7), tm.JointGoal((1.5, 0.2, 0.5))
    problem = tm.Problem(robot, start, goal, motion_limits=limits)
    system = ProblemFunctions.of(problem)
    line = time_straight_line(system, problem.q_start, problem.goal.q)
    t = np.linspace(0, line.duration, 4000)[1:-1]
    h = 1e-4
    q, before, after = line.position(t), line.position(t - h), line.position(t + h)
    v, a = (after - before) / (2 * h), (after - 2 * q + before) / h**2
    load = np.abs(system.torque(q, v, a))
    # The acceleration is constant between grid points, which costs a few per cent.
    assert np.quantile(load.max(axis=1), 0.95) < 1.02
    assert np.mean(load.max(axis=1) > 0.97) > 0.9  # nearly always saturated


def test_line_where_gravity_exceeds_the_torque_limit_has_no_timing(tmp_path):
    robot = tm.load_robot("planar3r", effort={"joint1": 2.0})
    start, goal = (np.pi / 2, 0.0, 0.0), (np.pi / 2 + 0.01, 0.0, 0.0)
    low = tm.Problem(robot, start, tm.JointGoal(goal))
    system = ProblemFunctions.of(low)
    through = time_straight_line(system, np.array([0.2, 0, 0]), np.array(goal))
    assert through is None


def test_inverse_kinematics_finds_several_distinct_configurations():
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, (0.5, 1.7, -1.7), tm.PositionGoal("tip", (4, 1, 0)))
    system = ProblemFunctions.of(problem)
    search = Target(system, problem.goal).configurations(20, np.random.default_rng(0))
    found = search.free
    assert len(found) >= 5 and not search.blocked
    limits = robot.limits
    for q in found:
        error = np.linalg.norm(problem.goal.place_residual(system.kinematics, q)[0])
        assert error < 1e-6
        assert np.all(q >= limits.position_lower) and np.all(q <= limits.position_upper)


def test_guesses_are_reproducible_and_end_at_the_goal():
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, (0.5, 1.7, -1.7), tm.JointGoal((1.0, 0.5, 0.5)))
    system = ProblemFunctions.of(problem)
    one = list(
        itertools.islice(GuessRequest(np.random.default_rng(5)).guesses(system), 4)
    )
    two = list(
        itertools.islice(GuessRequest(np.random.default_rng(5)).guesses(system), 4)
    )
    assert len(one) == 4
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.q, b.q)
        np.testing.assert_allclose(a.q[-1], problem.goal.q, atol=1e-9)
        np.testing.assert_allclose(a.q[0], problem.q_start, atol=1e-9)


def test_guesses_for_a_frame_goal_are_lines_then_a_guess_at_rest():
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, (0.5, 1.7, -1.7), tm.PositionGoal("tip", (4, 1, 0)))
    system = ProblemFunctions.of(problem)
    guesses = GuessRequest(np.random.default_rng(5)).guesses(system)
    lines = list(itertools.takewhile(lambda guess: guess.name != REST_GUESS, guesses))
    assert 3 <= len(lines) <= MOST_TRIED
    for guess in lines:
        error, _ = problem.goal.place_residual(system.kinematics, guess.q[-1])
        assert np.linalg.norm(error) < 1e-6


# An obstacle near the goal of the tip.
BALL = tm.Sphere("ball", radius=0.3, position=(3.5, 1.2, 0))


def test_guess_along_a_half_circle_follows_it_at_the_tool_speed():
    """The straight line between the ends of the arc passes its centre."""
    start = np.array([-0.4, -1.6, 1.9, -1.9, -1.57, 0.0])
    robot = tm.load_robot("ur5", limits="urdf")
    begin = np.array(RobotKinematics(robot).placement(start, "tool0").translation)
    arc = tm.ToolArc("tool0", begin + np.array([0.0, 0.12, 0.0]), begin, angle=np.pi)
    goal = tm.PositionGoal("tool0", arc.at(np.pi))
    along = arc, tm.ToolSpeed("tool0", 0.25)
    system = ProblemFunctions.of(tm.Problem(robot, start, goal, constraints=along))
    guess = next(GuessRequest(np.random.default_rng(0)).guesses(system))
    t = np.linspace(0.0, guess.duration, 400)
    q, empty = guess.position(t), np.zeros((t.size, 0))
    assert np.max(arc.on(robot).measure_rows(q, empty, empty)) < arc.radius
    assert guess.duration == pytest.approx(0.12 * np.pi / 0.25, rel=0.05)


def test_path_that_must_slow_down_at_once_is_timed():
    """The largest acceleration along the path falls steeply with the path speed."""
    arm = tm.load_robot("ur5", limits="urdf")
    goal = tm.JointGoal(np.full(arm.n, 0.5))
    system = ProblemFunctions.of(tm.Problem(arm, np.zeros(arm.n), goal))
    steps = np.random.default_rng(64).uniform(-0.6, 0.6, (9, arm.n))
    corners = np.cumsum(steps, axis=0)
    timing = timed(system, corners)
    # Rounded corners shorten the path a little.
    least = np.abs(np.diff(corners, axis=0)) / arm.limits.velocity
    assert 0.9 < timing.duration / least.max(axis=1).sum() < 1.2


def planar_system(scene=None, goal=(4, 1, 0)):
    robot = tm.load_robot("planar3r")
    goal = tm.PositionGoal("tip", goal)
    return ProblemFunctions.of(tm.Problem(robot, (0.5, 1.7, -1.7), goal, scene=scene))


def test_configurations_are_split_into_free_and_blocked():
    open_system, system = planar_system(), planar_system(tm.Scene([BALL]))
    goal = system.problem.goal
    every = Target(open_system, goal).configurations(20, np.random.default_rng(0))
    search = Target(system, goal).configurations(20, np.random.default_rng(0))
    assert not every.blocked and search.free and search.blocked
    assert len(search.free) + len(search.blocked) == len(every.free)
    assert all(is_free(system, q) for q in search.free)
    assert not any(is_free(system, q) for q in search.blocked)


def test_configurations_in_collision_are_used_if_all_collide():
    # The goal lies between balls that overlap: no link gets there.
    balls = [
        tm.Sphere(f"O{i}", radius=0.3, position=(4 + x, 1 + y, 0))
        for i, (x, y) in enumerate(0.4 * np.vstack([np.eye(2), -np.eye(2)]))
    ]
    system = planar_system(tm.Scene(balls))
    goal = system.problem.goal
    search = Target(system, goal).configurations(5, np.random.default_rng(0))
    assert not search.free and search.blocked


def test_configurations_far_apart_come_before_close_configurations():
    system = planar_system()
    search = Target(system, system.problem.goal).configurations(
        30, np.random.default_rng(0)
    )
    q = np.array(search.free)
    apart = np.abs(q[:, None] - q).max(axis=2) + np.eye(len(q)) * 10
    few = 1
    while few < len(q) and apart[few, :few].min() > SPREAD:
        few += 1
    assert 2 <= few < len(q)
    assert all(apart[i, :few].min() <= SPREAD for i in range(few, len(q)))


def test_search_for_an_unreachable_goal_returns_the_nearest_configuration():
    system = planar_system(goal=(-3.0, -4.9, 0.0))  # joint 1 stays above the ground
    target = Target(system, system.problem.goal)
    search = target.configurations(5, np.random.default_rng(0))
    assert not search.free and not search.blocked
    missing = target.violation(search.nearest)
    assert missing > 100 * REACHED
    assert target.miss(search.nearest) == f"{missing:.4g} m"


def test_an_unreachable_pose_is_missed_by_lengths_and_angles_apart():
    down = tm.PoseGoal("tool0", ((0.8, 0.0, 0.7), (0.0, 1.0, 0.0, 0.0)))
    problem = tm.Problem(tm.load_robot("ur5"), (0.0, -1.2, 1.4, -1.8, -1.6, 0.0), down)
    with pytest.raises(tm.ProblemError, match=r"misses it by \S+ m and \S+ rad$"):
        tm.plan(problem)


def test_guesses_among_obstacles_are_a_line_then_sampled_paths(tmp_path):
    system = maze(tmp_path, wall("block", 0.0, -0.8, 0.8))
    guesses = list(
        itertools.islice(GuessRequest(np.random.default_rng(0)).guesses(system), 6)
    )
    names = [guess.name for guess in guesses]
    assert names[0] == "straight line" and names[-1] == "via point"
    sampled = [guess for guess in guesses if guess.name == "sampled path"]
    assert names[1 : 1 + len(sampled)] == ["sampled path"] * len(sampled)
    sides = set()
    for guess in sampled:
        q = guess.position(np.linspace(0, guess.duration, 150))
        assert guess.timed and all(is_free(system, row) for row in q)
        sides.add(np.sign(q[np.argmin(np.abs(q[:, 0])), 1]))
    assert sides == {1.0, -1.0}


@pytest.fixture
def sampled_paths(monkeypatch):
    """Arguments of each call of `sample_path` during a test."""
    calls, sample = [], sampling.sample_path

    def count(*arguments, **options):
        calls.append(arguments)
        return sample(*arguments, **options)

    monkeypatch.setattr(sampling, "sample_path", count)
    return calls


def test_paths_are_sampled_only_when_the_next_guess_is_taken(tmp_path, sampled_paths):
    calls = sampled_paths
    system = maze(tmp_path, wall("block", 0.0, -0.8, 0.8))
    guesses = itertools.islice(
        GuessRequest(np.random.default_rng(0)).guesses(system), 3
    )
    assert next(guesses).name == "straight line" and not calls
    assert next(guesses).name == "sampled path" and calls


def test_the_fastest_of_a_few_sampled_paths_comes_first(tmp_path):
    system = maze(tmp_path, wall("block", 0.0, -0.6, 0.8))
    paths = sampled_guesses(
        system, [np.array(END)], GuessRequest(np.random.default_rng(0))
    )
    durations = [guess.duration for guess in itertools.islice(paths, 2)]
    assert len(durations) == 2 and durations[0] < durations[1]


def test_first_path_that_is_fast_enough_is_not_compared_with_others(
    tmp_path, sampled_paths
):
    calls = sampled_paths
    system, end = maze(tmp_path, wall("block", 0.0, -0.6, 0.8)), [np.array(END)]

    def first(enough):
        rng = np.random.default_rng(0)
        calls.clear()
        paths = sampled_guesses(system, end, GuessRequest(rng), enough=enough)
        return next(paths), len(calls), paths

    best, both, _ = first(0.0)
    alone, one, further = first(np.inf)
    assert one < both
    assert best.duration <= alone.duration
    assert next(further).duration != alone.duration


def test_no_path_is_sampled_where_the_straight_line_is_free(tmp_path):
    system = maze(tmp_path, wall("aside", 0.0, 1.0, 1.4))
    guesses = itertools.islice(
        GuessRequest(np.random.default_rng(0)).guesses(system), 3
    )
    assert [g.name for g in guesses] == ["straight line", "via point", "via point"]


def test_guesses_for_a_frame_among_obstacles_end_in_several_configurations():
    system = planar_system(tm.Scene([BALL]))
    guesses = list(
        itertools.islice(GuessRequest(np.random.default_rng(0)).guesses(system), 5)
    )
    names = [guess.name for guess in guesses]
    assert names[:3] == ["straight line", "at rest", "sampled path"]
    ends = [g.q[-1] for g in guesses if g.name == "sampled path"]
    assert max(np.abs(a - b).max() for a, b in itertools.combinations(ends, 2)) > 0.3
    for q in ends:
        error, _ = system.problem.goal.place_residual(system.kinematics, q)
        assert np.linalg.norm(error) < REACHED and is_free(system, q)


def test_a_segment_ends_in_the_elbow_branch_that_the_next_goal_needs() -> None:
    """Regression: with the nearest configuration the motion took a quarter longer."""
    bend = np.arccos(0.7)
    segments = [
        tm.Segment(tm.PositionGoal("tip", (1.4, 0.0, 0.0))),
        tm.Segment(tm.JointGoal((-1.2, 2.2))),
    ]
    problem = tm.Problem(two_link_arm(), (0.5, -1.2), segments=segments)
    system = ProblemFunctions.of(problem)
    guess = next(segmented_guesses(system, GuessRequest(np.random.default_rng(0))))
    assert guess.ends[0] == pytest.approx((-bend, 2.0 * bend), abs=1e-3)
