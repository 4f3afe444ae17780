"""Plans among moving obstacles, checked by distances that are computed here."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.initial_guess import path_velocity, rrt
from tominpmp.initial_guess.guess import GuessRequest
from tominpmp.initial_guess.path_velocity import guesses_of
from tominpmp.options import Tolerances
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.verification import verify

# Other tests cover the search for the best motion.
plan_quickly = partial(tm.plan, effort="quick", refine=None)

# The planar arm: lengths of its links, half their width, and the gate [m].
LENGTHS, THICK = (3.0, 2.0, 1.0), 0.001
HINGE, LENGTH, WIDTH = np.array([6.0, 2.5]), 5.0, 0.2
START, END = np.array([0.2, 0.0, 0.0]), np.array([1.6, 0.0, 0.0])
MARGIN = 0.02
QUICK = tm.Options(intervals=12, starts=1, seed=0)
# Strong motors, so that the gate limits the motion [N m].
EFFORT = (60.0, 30.0, 15.0)
OPENS, LATE, TAKES = 0.3, 0.8, 0.3  # [s]


def gate(opens: float, takes: float = TAKES) -> tm.Box:
    """A gate that begins, at the time `opens`, to turn upwards by a right angle."""
    swing = tm.ConstantVelocity(
        angular=(0.0, 0.0, -0.5 * np.pi / takes),
        pivot=(*HINGE, 0.0),
        begin=opens,
        end=opens + takes,
    )
    centre = (HINGE[0] - LENGTH / 2, HINGE[1], 0.0)
    return tm.Box("gate", size=(LENGTH, WIDTH, 1.0), position=centre, motion=swing)


def problem(*obstacles: tm.Obstacle) -> tm.Problem:
    robot = tm.load_robot("planar3r", effort=EFFORT)
    return tm.Problem(
        robot, START, tm.JointGoal(END), tm.Scene(obstacles), margin=MARGIN
    )


def points_of_arm(q: np.ndarray) -> np.ndarray:
    """Points on the axes of the links 2 cm apart, shape (k, 2)."""
    corner, angle, found = np.zeros(2), 0.0, []
    for length, turn in zip(LENGTHS, q, strict=True):
        angle += turn
        along = np.array([np.cos(angle), np.sin(angle)])
        found.append(
            corner + np.linspace(0, length, int(length / 0.02))[:, None] * along
        )
        corner = corner + length * along
    return np.concatenate(found)


def room_beside_gate(q: np.ndarray, t: float, opens: float, takes: float) -> float:
    """Distance of the arm from the rectangle of the gate at a time [m]."""
    angle = np.pi - 0.5 * np.pi * np.clip((t - opens) / takes, 0.0, 1.0)
    along = np.array([np.cos(angle), np.sin(angle)])
    offset = points_of_arm(q) - (HINGE + 0.5 * LENGTH * along)
    local = np.stack([offset @ along, offset @ np.array([-along[1], along[0]])])
    outside = np.abs(local) - [[LENGTH / 2], [WIDTH / 2]]
    return float(np.min(np.linalg.norm(np.maximum(outside, 0.0), axis=0)) - THICK)


@pytest.fixture(scope="module")
def alone() -> tm.Solution:
    return plan_quickly(problem(), QUICK)


@pytest.fixture(scope="module")
def through() -> tm.Solution:
    return plan_quickly(problem(gate(OPENS)), QUICK)


def test_motion_passes_the_gate_while_it_swings(through, alone):
    assert through.success
    motion = through.trajectory
    np.testing.assert_allclose(motion.q[0], START)
    np.testing.assert_allclose(motion.q[-1], END, atol=1e-6)
    times = np.linspace(0.0, motion.duration, 1500)
    # The arm is nearest when the gate begins to swing; links move by millimetres
    # between the samples.
    opening = OPENS + np.linspace(-1e-3, 1e-3, 201)
    times = np.union1d(times, opening[opening < motion.duration])
    rooms = [
        room_beside_gate(q, t, OPENS, TAKES)
        for t, q in zip(times.tolist(), motion(times).q, strict=True)
    ]
    # The arm keeps the margin and has no clearance to spare: the gate limits it.
    assert min(rooms) > MARGIN - 1e-4
    assert min(rooms) < MARGIN + 5e-3
    found = through.verification.min_clearance
    assert found == pytest.approx(min(rooms), abs=1e-3)
    # Time counts from the start: the motion is not faster than without the gate, and
    # the last link, which points along the arm at first, cannot pass the closed gate.
    assert motion.t[0] == 0.0
    assert motion.duration > OPENS
    assert through.T >= alone.T * (1.0 - 1e-6)


def test_gate_that_opens_later_delays_the_motion(through):
    later = plan_quickly(problem(gate(LATE)), QUICK)
    assert later.success
    assert later.T > LATE
    # An arm that waits for the difference can then do the same motion.
    assert through.T < later.T < through.T + (LATE - OPENS) + 0.01
    times = np.linspace(0.0, later.T, 1500)
    rooms = [
        room_beside_gate(q, t, LATE, TAKES)
        for t, q in zip(times.tolist(), later.trajectory(times).q, strict=True)
    ]
    assert min(rooms) > MARGIN - 1e-4


def test_replay_refuses_the_motion_if_the_gate_opens_later(through):
    """A motion that is too early for a gate collides with it."""
    late = problem(gate(OPENS + 0.1))
    judged = verify(late, through.trajectory, Tolerances())
    assert not judged.ok
    assert {item.kind for item in judged.violations} == {"clearance"}
    assert verify(problem(gate(OPENS)), through.trajectory, Tolerances()).ok
    # If the gate stays closed, the motion collides as well.
    assert not verify(problem(gate(50.0)), through.trajectory, Tolerances()).ok


def test_triangles_at_rest_beside_a_moving_gate_have_a_plan():
    """The search for a place to wait asked Coal for a depth that meshes do not have."""
    corners = np.array([[2.4, 0.0, -1.0], [2.6, 0.0, -1.0], [2.5, 0.1, 1.0]])
    pane = tm.Mesh("pane", vertices=corners, triangles=[[0, 1, 2]], convex="none")
    assert plan_quickly(problem(gate(OPENS), pane), QUICK).success


def test_distant_moving_obstacle_does_not_change_the_motion_time():
    ball = tm.Sphere(
        "ball",
        radius=0.5,
        position=(-9.0, -9.0, 0.0),
        motion=tm.ConstantVelocity(velocity=(3.0, 0.0, 0.0)),
    )
    # Rounding may decide which rows join; the iterations converge to the same motion if
    # the jumps of the controls have the same weight in free space as among obstacles.
    exact = replace(QUICK, tolerance=1e-5, smoothing=1e-4)
    alone, beside = plan_quickly(problem(), exact), plan_quickly(problem(ball), exact)
    assert beside.T == pytest.approx(alone.T, rel=1e-5)


def test_equal_motions_of_three_types_give_the_same_replay(alone):
    """A constant velocity, waypoints and a function describe the same motion."""
    first, speed = np.array([1.5, 2.0, 0.0]), np.array([0.9, 1.2, 0.0])

    def function(time: float) -> np.ndarray:
        place = np.eye(4)
        place[:3, 3] = first + time * speed
        return place

    motions = (
        tm.ConstantVelocity(velocity=speed),
        tm.Waypoints((0.0, 8.0), [first, first + 8.0 * speed]),
        function,
    )
    tasks = [
        problem(tm.Sphere("ball", radius=0.6, position=first, motion=motion))
        for motion in motions
    ]
    solution = plan_quickly(tasks[0], QUICK)
    assert solution.success
    times = np.linspace(0.0, solution.T, 1500)
    rooms = [
        np.linalg.norm(points_of_arm(q) - (first + t * speed)[:2], axis=1).min()
        for t, q in zip(times.tolist(), solution.trajectory(times).q, strict=True)
    ]
    room = min(rooms) - 0.6 - THICK
    assert room > MARGIN - 1e-4
    for task in tasks:
        judged = verify(task, solution.trajectory, Tolerances())
        assert judged.ok
        assert judged.min_clearance == pytest.approx(room, abs=1e-3)
        # The motion that was planned without the ball collides with it.
        assert not verify(task, alone.trajectory, Tolerances()).ok


def test_searches_past_a_shut_gate_are_short(monkeypatch):
    """While the gate is shut no path is found, and a motion that waits is known."""
    allowed: list[int] = []

    def search(system, q_end, seed, searches):
        allowed.append(searches.checks)

    monkeypatch.setattr(rrt, "sample_path", search)
    system = ProblemFunctions.of(problem(gate(3.0)))
    guesses = guesses_of(system, GuessRequest(np.random.default_rng(0)))
    assert next(guesses).delay > 1.0
    assert len([*itertools.islice(guesses, 8)]) == 8
    assert len(allowed) >= len(path_velocity.MOMENTS)
    assert max(allowed) <= rrt.LONG
