"""Warm starts from motions of neighbouring problems: choice, result, stop rule."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import tests.sample_arms as arms
import tominpmp as tm
from tests.schedules import loop_with
from tominpmp.cell.batch.neighbours import nearest_start
from tominpmp.kinematics import RobotKinematics
from tominpmp.planner.descent import PATIENCE, _stop_if_hopeless
from tominpmp.status import Status

HOME, TURN = np.array([0.3, 0.9]), np.array([1.0, -0.4])
LIMITS = tm.MotionLimits(acceleration=12.0)
QUICK = {"intervals": 12, "effort": "quick", "method": "inverse"}


def motion(middle: float) -> tm.Trajectory:
    """One joint from 0 to 1, by way of the middle."""
    t, rest = np.array([0.0, 0.5, 1.0]), np.zeros((3, 1))
    return tm.Trajectory(("j",), t, np.array([[0.0], [middle], [1.0]]), rest, rest)


@pytest.mark.parametrize(
    ("middles", "expected"),
    [
        ({1: 0.5, 2: 0.6}, 1),
        ({2: 0.5}, 2),
        ({1: 0.5, 2: 2.5}, None),
        ({1: 2.5, 3: 0.5}, 1),  # neighbour 3 is so far that its path may differ
        ({}, None),
    ],
)
def test_near_neighbours_of_different_paths_give_no_warm_start(
    middles: dict[int, float], expected: int | None
) -> None:
    near = [(1, 0.2), (2, 0.4), (3, 2.9)]
    found = {number: motion(middle) for number, middle in middles.items()}
    start = None if expected is None else (expected, found[expected])
    assert nearest_start(near, found) == start


@pytest.fixture(scope="module")
def arm() -> tm.Robot:
    return arms.two_link_arm(1.0)


def problem(robot: tm.Robot, goal: tm.Goal) -> tm.Problem:
    return tm.Problem(robot, HOME, goal, motion_limits=LIMITS)


def test_warm_start_that_misses_the_goal_is_not_returned(arm: tm.Robot) -> None:
    place = np.array([0.2, 1.4, 0.0])
    former = tm.plan(problem(arm, tm.PositionGoal("tip", place)), **QUICK)
    # The farther goal takes longer than the former motion, which would be returned if
    # it reached the goal.
    farther = place - np.array([0.3, 0.1, 0.0])
    found = tm.plan(
        problem(arm, tm.PositionGoal("tip", farther)), start=former, **QUICK
    )
    assert found.success and found.T > former.T
    end = RobotKinematics(arm).placement(found.trajectory.q[-1], "tip").translation
    assert np.linalg.norm(end - farther) < 1e-3
    # For its own goal the former motion is returned unless a faster motion is found.
    again = tm.plan(former.problem, start=former, **QUICK)
    assert again.success and again.T <= former.T * (1.0 + 1e-9)


def test_warm_start_at_speed_limits_is_as_fast_as_a_cold_start() -> None:
    robot = tm.load_robot("planar3r", gravity=(0, 0, 0), velocity=0.5)
    near, far = (
        tm.Problem(robot, (0.5, 1.7, -1.7), tm.JointGoal(end), self_collision=False)
        for end in ((0.9, 1.3, -1.2), (0.92, 1.28, -1.18))
    )
    former = tm.plan(near, refine=None, **QUICK).trajectory
    assert former is not None
    cold = tm.plan(far, **QUICK)
    warm = tm.plan(far, start=former, **QUICK)
    assert warm.success and warm.T <= 1.0005 * cold.T


@pytest.mark.parametrize(
    ("violations", "over"),
    [
        ([0.3] * PATIENCE, True),
        ([0.3] * (PATIENCE - 1), False),
        # Links that overlap on all motions nearby: slower motions overlap hardly less.
        ([0.07 * 0.99**k for k in range(PATIENCE)], True),
        ([0.3 * 0.7**k for k in range(PATIENCE)], False),
        ([0.3, *[1e-3] * PATIENCE], False),
        # Missing rows have joined a nearly feasible program.
        ([*[0.3 * 0.5**k for k in range(PATIENCE)], *[0.1] * 5], False),
    ],
)
def test_hopeless_starts_are_stopped(violations: list[float], over: bool) -> None:
    """Unless they are faster than the incumbent (a Fetch: 3.91 s, now 3.07 s)."""
    records = [SimpleNamespace(violation=value, duration=1.0) for value in violations]
    for best, stops in ((0.9, over), (1.1, False), (np.inf, over)):
        rule = partial(_stop_if_hopeless, SimpleNamespace(best_duration=best))
        counts = range(1, len(records) + 1)
        statuses = [rule(loop_with(records[:count])) for count in counts]
        assert statuses[-1] is (Status.STALLED if stops else None)
        assert not any(statuses[:-1])
