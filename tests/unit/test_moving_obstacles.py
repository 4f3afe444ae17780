"""Moving obstacles: their motions, rows of clearances, derivatives by time."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import tominpmp as tm
from tominpmp.transcription.adjoint import AdjointTranscription
from tominpmp.transcription.bspline import BSplineTranscription, InverseTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram, SampledRows

START = np.array([0.5, 1.0, -1.0])
END = np.array([1.0, 0.6, -0.8])
INTERVALS = 7


def orbit(time: float) -> pin.SE3:
    """A callable path: around a circle, turning on the way."""
    angle = 2.0 + 0.8 * time
    turn = pin.exp3(np.array([0.3 * time, 0.0, angle]))
    return pin.SE3(turn, np.array([5.0 * np.cos(angle), 5.0 * np.sin(angle), 0.0]))


STEADY = tm.ConstantVelocity(
    velocity=(0.5, -1.0, 0.2),
    angular=(0.1, 0.2, 1.5),
    pivot=(-4.0, 4.5, 0.0),
    begin=0.05,
)
WAY = tm.Waypoints(
    times=(0.0, 0.45, 1.3, 2.1),
    positions=[(-2.0, 6.0, 0.0), (-1.0, 5.5, 0.3), (0.5, 5.5, 0.0), (0.5, 6.5, 0.0)],
    rotations=Rotation.from_rotvec(
        [(0, 0, 0), (0.2, 0.1, 1.0), (0, 0.3, 2.0), (0.1, 0, 3.5)]
    ).as_quat(),
)
MOTIONS = {"steady": STEADY, "waypoints": WAY, "function": orbit}


def mover(motion, **place) -> tm.Capsule:
    return tm.Capsule("mover", radius=0.3, length=1.5, motion=motion, **place)


def obstacle(name: str) -> tm.Capsule:
    place = {"position": (-3.0, 5.0, 0.0)} if name == "steady" else {}
    return mover(MOTIONS[name], **place)


# Motions


@pytest.mark.parametrize("name", MOTIONS)
def test_velocities_are_derivatives_of_placements(name):
    item = obstacle(name)
    times = np.array([0.07, 0.3, 0.44, 0.46, 0.9, 1.29, 1.31, 2.0, 2.5])
    step = 1e-5
    before, after = item.poses(times - step), item.poses(times + step)
    twist = item.twists(times)
    linear = (after.p - before.p) / (2 * step)
    np.testing.assert_allclose(twist.linear, linear, atol=1e-5)
    turned = after.R @ np.swapaxes(before.R, 1, 2)
    angular = Rotation.from_matrix(turned).as_rotvec() / (2 * step)
    np.testing.assert_allclose(twist.angular, angular, atol=1e-5)


@pytest.mark.parametrize("name", MOTIONS)
def test_speeds_stay_within_their_bounds(name):
    item = obstacle(name)
    begin = np.linspace(0.0, 2.4, 9)
    linear, angular = item.speed_bounds(begin, begin + 0.3)
    for k, low in enumerate(begin):
        twist = item.twists(np.linspace(low, low + 0.3, 16))
        assert np.linalg.norm(twist.linear, axis=1).max() <= linear[k] + 1e-9
        assert np.linalg.norm(twist.angular, axis=1).max() <= angular[k] + 1e-9


def test_constant_angular_velocity_turns_about_the_pivot():
    gate = tm.Box(
        "gate",
        size=(2, 0.1, 1),
        position=(1, 0, 0),
        motion=tm.ConstantVelocity(
            angular=(0, 0, 0.5 * np.pi), pivot=(0, 0, 0), begin=1.0, end=2.0
        ),
    )
    found = gate.poses(np.array([0.0, 1.0, 1.5, 2.0, 9.0]))
    root = np.sqrt(0.5)
    expected = [(1, 0, 0), (1, 0, 0), (root, root, 0), (0, 1, 0), (0, 1, 0)]
    np.testing.assert_allclose(found.p, expected, atol=1e-12)
    np.testing.assert_allclose(found.R[-1] @ (1, 0, 0), (0, 1, 0), atol=1e-12)
    np.testing.assert_array_equal(gate.motion.kinks, [1.0, 2.0])
    still = gate.twists(np.array([0.5, 2.5]))
    np.testing.assert_array_equal(still.linear, 0.0)
    moving = gate.twists(np.array([1.0]))
    np.testing.assert_allclose(moving.linear, [(0.0, 0.5 * np.pi, 0.0)], atol=1e-12)


def test_waypoints_are_interpolated_and_held_at_the_end():
    item = mover(WAY)
    found = item.poses(np.asarray(WAY.times))
    np.testing.assert_allclose(found.p, WAY.positions, atol=1e-12)
    np.testing.assert_allclose(found.R, WAY.rotations, atol=1e-12)
    # The motion begins at the first waypoint, is linear, and stays at the last.
    np.testing.assert_array_equal(item.position, WAY.positions[0])
    middle = item.poses(np.array([0.225])).p[0]
    np.testing.assert_allclose(middle, np.mean(WAY.positions[:2], axis=0), atol=1e-12)
    np.testing.assert_allclose(item.poses(np.array([50.0])).p[0], WAY.positions[-1])


class Rising(tm.Motion):
    """A motion of a caller, which is absolute."""

    def poses(self, times, start):
        p = np.stack([0.0 * times + 1.0, 0.0 * times, 2.0 * times], axis=1)
        return type(start)(np.tile(np.eye(3), (times.size, 1, 1)), p)

    def twists(self, times, start):
        raise NotImplementedError

    def speed_bounds(self, begin, end, start):
        raise NotImplementedError


class Lifted(Rising):
    """A motion of a caller from its start, with one rotation for all times."""

    def poses(self, times, start):
        p = super().poses(times, start).p - [1.0, 0.0, 0.0]
        return type(start)(start.R, start.p + p)


class Ahead(Rising):
    """A motion of a caller from its start, which begins elsewhere."""

    def poses(self, times, start):
        R, p = super().poses(times, start)
        return type(start)(R, start.p + p)


class Lost(Rising):
    """A motion of a caller to no place."""

    def poses(self, times, start):
        R, p = super().poses(times, start)
        return type(start)(R, np.nan * p)


def test_obstacle_begins_where_the_motion_of_a_caller_begins():
    """Regression: it had its position, or the origin, at the start; and one rotation
    for all times was not understood.
    """
    np.testing.assert_array_equal(mover(Rising()).position, [1.0, 0.0, 0.0])
    with pytest.raises(tm.SceneError, match=r"motion begins with \[1.0, 0.0, 0.0\]"):
        mover(Rising(), position=(0.0, 3.0, 0.0))
    with pytest.raises(tm.SceneError, match=r"position \[1.* begins with \[2.0, 0.0"):
        mover(Ahead())
    with pytest.raises(tm.SceneError, match=r"'mover': .* at 0 s is not finite"):
        mover(Lost())
    lifted = mover(Lifted(), position=(0.0, 3.0, 0.0))
    np.testing.assert_array_equal(lifted.rotation, np.eye(3))
    np.testing.assert_array_equal(lifted.poses(np.ones(1)).p, [[0.0, 3.0, 2.0]])


def test_speed_bounds_of_a_pose_function_are_used_and_checked():
    def slide(time: float) -> np.ndarray:
        place = np.eye(4)
        place[0, 3] = 2.0 * time
        return place

    fine = mover(tm.PoseFunction(slide, speed=2.5, angular_speed=0.0))
    linear, angular = fine.speed_bounds(np.array([0.0, 1.0]), np.array([1.0, 1.2]))
    np.testing.assert_array_equal(linear, 2.5)
    np.testing.assert_array_equal(angular, 0.0)
    wrong = mover(tm.PoseFunction(slide, speed=1.5))
    with pytest.raises(tm.SceneError, match=r"'mover'.*speed is 1\.5.*speed 2:"):
        wrong.twists(np.array([0.3]))


def test_scene_at_a_time_has_its_obstacles_at_rest():
    scene = tm.Scene([tm.Sphere("rest", radius=1.0, position=(9, 0, 0)), mover(WAY)])
    assert [item.name for item in scene.moving] == ["mover"]
    later = scene.at(1.3)
    assert not later.moving
    np.testing.assert_allclose(later["mover"].position, WAY.positions[2])
    assert [item.name for item in scene.resting()] == ["rest"]
    for motion in (STEADY, WAY):
        assert pickle.loads(pickle.dumps(motion)) == motion
    assert mover(WAY) == mover(WAY)
    assert mover(WAY) != mover(STEADY)


# Wrong input

WRONG = [
    (lambda: tm.Waypoints([0.5, 1.0], np.zeros((2, 3))), "begins at 0.5 s, expected 0"),
    (
        lambda: tm.Waypoints([0, 1, 1], np.zeros((3, 3))),
        r"not increasing: 1 s is followed by 1 s \(waypoints 1 and 2",
    ),
    (lambda: tm.Waypoints([0, 2, 1], np.zeros((3, 3))), "2 s is followed by 1 s"),
    (
        lambda: tm.Waypoints([0, 1], np.zeros((3, 3))),
        r"positions has shape \(3, 3\), expected \(2, 3\), as there are 2 times",
    ),
    (
        lambda: tm.Waypoints([0, 1], [(0, 0, 0), (np.nan, 0, 0)]),
        r"positions has a value that is not finite, at index \[1, 0\]",
    ),
    (lambda: tm.Waypoints([0], [(0, -1e200, 0)]), r"1e\+200 m away, expected at most"),
    (
        lambda: tm.Waypoints([0, np.inf], np.zeros((2, 3))),
        "times has a value",
    ),
    (lambda: tm.Waypoints([], np.zeros((0, 3))), "expected one time or more"),
    (lambda: tm.Waypoints([0, 1]), "needs positions, rotations, or both"),
    (
        lambda: tm.Waypoints([0, 1], rotations=[(0, 0, 0, 1), (0, 0, 0, 0)]),
        r"waypoint 1 \(counted from 0\) is .*other than zero",
    ),
    (
        lambda: tm.Waypoints([0, 1], rotations=[(0, 0, 0, 1), (0, 0, 1, 0)]),
        "half a turn from waypoint 0 to 1",
    ),
    (lambda: tm.ConstantVelocity((1, 2)), r"velocity is \(1, 2\), expected three"),
    (lambda: tm.ConstantVelocity(pivot="here"), "pivot is .here., expected three"),
    (
        lambda: tm.ConstantVelocity(begin=-1.0),
        "begin is -1.0, expected a finite number >= 0",
    ),
    (lambda: tm.ConstantVelocity(begin=2, end=1), "end is 1, .*the beginning at 2 s"),
    (lambda: tm.ConstantVelocity(end=np.nan), "end is nan, expected a number"),
    (lambda: tm.PoseFunction(3), "function is 3, expected one"),
    (
        lambda: tm.PoseFunction(orbit, speed=-1),
        "speed is -1, expected a finite number >= 0",
    ),
    (lambda: mover((1, 0, 0)), r"'mover': motion is \(1, 0, 0\), expected a Const"),
    (lambda: mover(tm.ConstantVelocity), "motion is <class.*expected a ConstantV"),
    (lambda: mover(lambda t: 1 / t), "'mover': motion: the function fails at 0 s"),
    (lambda: mover(lambda t: None), "'mover': motion: .* at 0 s is None, expected a"),
    (lambda: mover(lambda t: np.eye(3)), "placement at 0 s is array.*a 4x4 matrix"),
    (lambda: mover(lambda t: 2 * np.eye(4)), "placement at 0 s is .*a 4x4 matrix"),
    (lambda: mover(lambda t: np.diag([2, 2, 2, 1])), "at 0 s is .*orthonor"),
    (lambda: mover(lambda t: np.eye(4) + np.eye(4, k=-3)), "at 0 s is .*a 4x4 matrix"),
    (
        lambda: mover(WAY, position=(1, 2, 3)),
        r"position is \[1.*motion begins with \[-2",
    ),
    (lambda: mover(WAY, position=(-2, 6 + 5e-5, 0)), "begins with .* the same, or no"),
    (lambda: mover(WAY, rotation=(0, 0, 1, 1)), "rotation is .*begins with"),
]


@pytest.mark.parametrize(("make", "message"), WRONG)
def test_invalid_motions_are_refused(make, message):
    with pytest.raises(tm.SceneError, match=message):
        make()


def test_failure_of_a_pose_function_is_named_with_its_time():
    def gap(time: float) -> np.ndarray:
        if time > 0.4:
            raise KeyError("no placement is known")
        return np.eye(4)

    item = mover(gap)
    with pytest.raises(tm.SceneError, match=r"'mover': .*at 0\.5 s: KeyError"):
        item.poses(np.array([0.1, 0.5]))


def test_start_is_checked_against_obstacles_at_time_zero():
    robot = tm.load_robot("planar3r")
    away = tm.ConstantVelocity(velocity=(0.0, 9.0, 0.0))
    scene = tm.Scene([tm.Sphere("ball", radius=0.5, position=(1, 0.5, 0), motion=away)])
    with pytest.raises(tm.ProblemError, match="start in collision"):
        tm.Problem(robot, [0.5, 0, 0], tm.JointGoal([1.5, 0, 0]), scene)
    # The ball has left the goal when the arm arrives.
    tm.Problem(robot, [1.5, 0, 0], tm.JointGoal([0.5, 0, 0]), scene)


# Rows


def with_clearances(program: NonlinearProgram, more: Instants) -> NonlinearProgram:
    """The program with rows of clearances at more instants."""
    blocks = tuple(
        replace(block, fixed=block.fixed.joined(more))
        if isinstance(block, SampledRows) and block.name == "clearance"
        else block
        for block in program.blocks
    )
    return replace(program, blocks=blocks)


def build(kind: str, problem: tm.Problem, seed: int):
    """A transcription and a random motion near the way from START to END."""
    system, rng = ProblemFunctions.of(problem), np.random.default_rng(seed)
    shares = interval_shares("cosine", INTERVALS)
    way = np.linspace(0.0, 1.0, INTERVALS + 1)[:, None]
    q = START + way * (END - START) + 0.05 * rng.normal(size=(INTERVALS + 1, 3))
    q[0] = START
    effort = problem.robot.limits.effort_upper
    u = effort * rng.uniform(-0.1, 0.1, (INTERVALS, 3))
    T = np.array([1.1])
    if kind in ("inverse", "free lengths"):
        more = Instants(np.array([0, 2, 6]), np.array([0.3, 0.7, 0.2]))
        free = kind == "free lengths"
        lengths = np.eye(INTERVALS) if free else shares
        nlp = InverseTranscription(system, lengths, 1.1)
        eta = rng.uniform(0.1, 0.2, INTERVALS) if free else T
        program = with_clearances(NonlinearProgram.of(nlp), more)
        return program, nlp.unknowns(np.vstack([q[:1], q[:-1], q[-2:-1]]), eta)
    if kind == "collocation":
        nlp = CollocationTranscription(system, shares, 1.1)
        v = 0.3 * rng.normal(size=q.shape)
        return NonlinearProgram.of(nlp), nlp.pack(np.hstack([q, v]), u, T)
    if kind == "adjoint":
        nlp = AdjointTranscription(system, shares, 1.1)
        return NonlinearProgram.of(nlp), nlp.pack(u, np.array([0.3]))
    nlp = BSplineTranscription(system, shares, 5)
    points = np.pad(q, ((2, 2), (0, 0)), mode="edge")
    return NonlinearProgram.of(nlp), nlp.unknowns(points, T)


KINDS = ("inverse", "free lengths", "collocation", "adjoint", "bspline")


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_of_clearance_rows_match_finite_differences(
    kind, name, monkeypatch
):
    # All rows are in the program and exact, however far the obstacle is.
    for scheme in (BSplineTranscription, AdjointTranscription):
        monkeypatch.setattr(scheme, "cutoff", 10.0)
        monkeypatch.setattr(scheme, "moving_attention", 10.0)
    problem = tm.Problem(
        tm.load_robot("planar3r"), START, tm.JointGoal(END), tm.Scene([obstacle(name)])
    )
    nlp, z = build(kind, problem, 3)
    values = nlp.evaluate(z)
    linearization = nlp.linearize(z, values, nlp.step_bounds(z, 10.0))
    matrix = linearization.matrix.toarray()
    clearance = nlp.rows.kind == nlp.rows.kinds.index("clearance")
    chosen = clearance[linearization.rows]
    assert np.all(values[clearance] < -1e-3)
    step, steps = 1e-6, nlp.step_bounds(z, 10.0)
    free = np.flatnonzero(np.asarray(steps.upper) > np.asarray(steps.lower))
    worst, by_time = 0.0, 0.0
    for i in free:
        shift = np.zeros(nlp.size)
        shift[i] = step
        up, down = nlp.evaluate(z + shift), nlp.evaluate(z - shift)
        expected = ((up - down) / (2 * step))[linearization.rows][chosen]
        found = matrix[chosen, i]
        scale = max(1.0, float(np.abs(expected).max(initial=0.0)))
        worst = max(worst, float(np.abs(found - expected).max(initial=0.0)) / scale)
        if nlp.cost[i]:
            by_time = max(by_time, float(np.abs(expected).max(initial=0.0)))
    assert np.count_nonzero(chosen) == np.count_nonzero(clearance) > 10
    assert by_time > 1e-3
    assert worst < 2e-5
