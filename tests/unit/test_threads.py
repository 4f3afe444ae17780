"""Evaluations of one robot or scene in several threads at once."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.arrays import Array
from tominpmp.collision.checker import CollisionChecker
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import FrameMotions

THREADS, ROWS = 4, 50


@pytest.fixture
def often_switched() -> Iterator[None]:
    """Threads take turns as often as the interpreter allows."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


@pytest.fixture(scope="module")
def robot() -> tm.Robot:
    return tm.load_robot("ur5")


def distances(robot: tm.Robot) -> Callable[[Array], Array]:
    obstacles = [
        tm.Box("box", size=(0.3, 0.3, 0.6), position=(0.5, 0.3, 0.3)),
        tm.Sphere("sphere", radius=0.15, position=(-0.4, 0.4, 0.5)),
    ]
    checker = CollisionChecker(robot, tm.Scene(obstacles))
    return lambda q: checker.distances(q[:12])


def free(robot: tm.Robot) -> Callable[[Array], Array]:
    across = tm.ConstantVelocity((0.0, 0.5, 0.0))
    at = (0.2, -1.0, 0.3)
    sphere = tm.Sphere("sphere", radius=0.5, position=at, motion=across)
    checker = CollisionChecker(robot, tm.Scene([sphere]))
    return lambda q: np.array(list(checker.each_free(q, time=2.0 + q[0, 0])))


def torque_slopes(robot: tm.Robot) -> Callable[[Array], Array]:
    dynamics = RobotDynamics(robot)
    return lambda q: np.concatenate(dynamics.inverse_jacobians(q, q, q), axis=None)


def places(robot: tm.Robot) -> Callable[[Array], Array]:
    frame = FrameMotions(robot, "tool0")
    return lambda q: np.concatenate(frame.placements(q), axis=None)


@pytest.mark.parametrize("evaluation", [distances, free, torque_slopes, places])
def test_values_in_several_threads_equal_those_of_one_thread(
    evaluation: Callable[[tm.Robot], Callable[[Array], Array]],
    robot: tm.Robot,
    often_switched: None,
) -> None:
    """Regression: one plan in four threads had motions that differed by 1e-7 s."""
    evaluate = evaluation(robot)
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (4 * THREADS, ROWS, robot.n))
    expected = [evaluate(each) for each in q]
    with ThreadPoolExecutor(THREADS) as pool:
        found = list(pool.map(evaluate, q))
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
