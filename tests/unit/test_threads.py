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
from tominpmp.collision.narrow import NarrowPhase
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


def test_distances_while_another_thread_sets_up_the_same_pairs(
    robot: tm.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: bodies were placed in one narrow phase, and measured in another.

    From Python 3.12 on, two threads that use a checker for the first time each set up
    its narrow phase, and the later one replaces the other.
    """
    checker = CollisionChecker(robot, tm.Scene([tm.Sphere("ball", radius=0.2)]))
    q, place = np.random.default_rng(0).uniform(-1.5, 1.5, (3, robot.n)), []
    expected = checker.distances(q)
    usual = NarrowPhase.place

    def replaced(narrow: NarrowPhase, *given: Array) -> None:
        usual(narrow, *given)
        place.append(given)
        vars(checker)["narrow"] = NarrowPhase(robot.model, *checker.watched)

    monkeypatch.setattr(NarrowPhase, "place", replaced)
    np.testing.assert_array_equal(checker.distances(q), expected)
    assert len(place) == len(q)
