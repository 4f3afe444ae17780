"""Rows of the certificate at the closest approaches of pairs of bodies."""

from __future__ import annotations

import numpy as np
import pytest

from tominpmp.arrays import Array
from tominpmp.certificate.limits import LimitRows, limits_of
from tominpmp.certificate.motion import GridMotion
from tominpmp.dynamics import RobotDynamics
from tominpmp.goals.joints import JointGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import load_robot
from tominpmp.scene.motion import ConstantVelocity
from tominpmp.scene.obstacles import Box, Sphere
from tominpmp.scene.scene import Scene
from tominpmp.transcription.problem_functions import ProblemFunctions

START = np.array([-0.9, 0.2, 0.1])
SPEED = np.array([1.5, 0.3, -0.2])
N, H = 24, 0.05
# Pairs nearer than this share of the reach are compared.
CLOSE = 0.01
# Accelerations that jump.
WAVES = 0.1 * (-1.0) ** np.arange(N)[:, None] * np.ones(3)
OBSTACLES = {
    "ball": Sphere("O", radius=0.3, position=(6.23, 0.21, 0.0)),
    "corner": Box("O", size=(1.0, 0.4, 0.4), position=(6.43, 0.1, 0.0)),
    "moving": Sphere(
        "O",
        radius=0.3,
        position=(6.22, 0.41, 0.0),
        motion=ConstantVelocity(velocity=(0.05, -0.4, 0.0)),
    ),
}


def passing(name: str) -> Problem:
    """An arm whose tip passes an obstacle at the end of its reach."""
    robot = load_robot(
        "planar3r", velocity=100.0, position_lower=-50.0, position_upper=50.0
    )
    goal = JointGoal(START + SPEED * N * H)
    return Problem(robot, START, goal, Scene([OBSTACLES[name]]), v_start=SPEED)


def build(problem: Problem, a: Array, h: Array) -> Trajectory:
    """The motion of accelerations that are constant on the intervals."""
    inverse = RobotDynamics(problem.robot).inverse
    q, v = [START], [SPEED]
    for k in range(h.size):
        q.append(q[-1] + h[k] * v[-1] + 0.5 * h[k] ** 2 * a[k])
        v.append(v[-1] + h[k] * a[k])
    t, every = np.append(0.0, np.cumsum(h)), np.vstack([a, a[-1:]])
    u = inverse(np.array(q), np.array(v), every)
    names = problem.robot.joint_names
    return Trajectory(names, t, np.array(q), np.array(v), u, a, inverse)


def approaches(problem: Problem, motion: Trajectory) -> dict[int, tuple[float, float]]:
    """Instant [s] and distance of the closest approach of each pair.

    The distances are sampled every 50 microseconds.
    """
    t = np.linspace(0.4, 0.7, 6_001)
    distances = problem.checker.distances(motion(t).q, times=t)
    return {
        pair: (float(t[k]), float(distances[k, pair]))
        for pair, k in enumerate(np.argmin(distances, axis=0))
        if 0 < k < t.size - 1
    }


def rows_of(problem: Problem, motion: Trajectory) -> tuple[GridMotion, LimitRows]:
    seen = GridMotion.of(ProblemFunctions.of(problem), motion)
    every = limits_of(seen)
    return seen, every.selected(every.of("clearance"))


@pytest.mark.parametrize("name", OBSTACLES)
def test_closest_approach_of_a_pair_is_a_row(name: str) -> None:
    """Regression: the row was at the next node or midpoint, millimetres too far.

    That instant was also too late.
    """
    problem = passing(name)
    motion = build(problem, WAVES, np.full(N, H))
    seen, rows = rows_of(problem, motion)
    times, compared = rows.at.times(seen.changes.h), 0
    for pair, (time, distance) in approaches(problem, motion).items():
        room = distance - float(problem.margins[pair])
        if room > CLOSE * seen.system.reach:
            continue
        mine = rows.subject == pair
        found = list(zip(times[mine], rows.upper[mine], strict=True))
        when, left = min(found, key=lambda item: abs(item[0] - time))
        assert when == pytest.approx(time, abs=2e-4)
        assert left * seen.system.reach == pytest.approx(room, abs=2e-4)
        compared += 1
    assert compared


@pytest.mark.parametrize("name", OBSTACLES)
def test_contact_row_is_the_derivative_of_the_least_distance(
    name: str, rng: np.random.Generator
) -> None:
    """The row is the derivative of the least distance over time.

    A change of the pace alone changes this distance only among moving obstacles.
    """
    problem = passing(name)
    h = np.full(N, H)
    base = build(problem, WAVES, h)
    seen, rows = rows_of(problem, base)
    times = rows.at.times(seen.changes.h)
    step, compared = 2e-4, 0
    before = approaches(problem, base)
    for da, dh in (
        (rng.normal(size=(N, 3)), np.zeros(N)),
        (rng.normal(size=(N, 3)), 0.05 * rng.normal(size=N)),
    ):
        high = build(problem, WAVES + step * da, h + step * dh)
        low = build(problem, WAVES - step * da, h - step * dh)
        ends = approaches(problem, high), approaches(problem, low)
        dx = np.concatenate([high.q - low.q, high.v - low.v], axis=1)[1:] / (2 * step)
        counts = np.maximum(np.rint(np.diff(seen.changes.t) / H), 1).astype(int)
        assert counts.size == N  # no interval was cut
        z = np.concatenate([dx.ravel(), da.ravel(), dh])
        slope = rows.change @ z
        for k, pair in enumerate(rows.subject.tolist()):
            if pair not in before or abs(times[k] - before[pair][0]) > 2e-4:
                continue
            found = (ends[0][pair][1] - ends[1][pair][1]) / (2 * step)
            assert -slope[k] * seen.system.reach == pytest.approx(found, abs=6e-3)
            compared += 1
    assert compared >= 2


def test_each_closest_approach_has_one_row() -> None:
    """A second row of the same approach would restrict the pace, which is free."""
    problem = passing("ball")
    motion = build(problem, WAVES, np.full(N, H))
    pairs = rows_of(problem, motion)[1].subject
    assert pairs.size == np.unique(pairs).size
    assert pairs.size


def test_joint_reversal_between_nodes_has_a_position_row(
    rng: np.random.Generator,
) -> None:
    """Position rows at the nodes alone would leave slack that does not exist."""
    free = load_robot(
        "planar3r", velocity=100.0, position_lower=-50.0, position_upper=50.0
    )
    problem = Problem(free, START, JointGoal(START), v_start=SPEED)
    h, a = np.full(N, H), rng.normal(0.0, 1.0, (N, 3))
    a[:, 0] = -SPEED[0] / (7.5 * H)  # turns back in the middle of the eighth interval
    motion = build(problem, a, h)
    top = START[0] + 0.5 * 7.5 * H * SPEED[0]
    assert top > motion.q[:, 0].max() + 1e-3
    robot = load_robot(
        "planar3r",
        velocity=100.0,
        position_lower=-50.0,
        position_upper={"joint1": top, "joint2": 50.0, "joint3": 50.0},
    )
    bounded = Problem(robot, START, JointGoal(START), v_start=SPEED)
    found = limits_of(GridMotion.of(ProblemFunctions.of(bounded), motion))
    rows = found.selected(found.of("position") & (found.at.share < 1.0))
    assert rows.subject.tolist() == [0]
    assert rows.at.interval.tolist() == [7]
    assert rows.upper[0] == pytest.approx(0.0, abs=1e-9)
