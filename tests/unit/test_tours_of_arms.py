"""Tests of tours of robots with several arms."""

from __future__ import annotations

import numpy as np
import pytest

import tests.sample_arms as arms
import tominpmp as tm
from tominpmp.cell.tours.station import least_stays, together
from tominpmp.kinematics import RobotKinematics

LIMITS = tm.MotionLimits(acceleration=6.0)


@pytest.fixture(scope="module")
def both() -> tm.Robot:
    """Two arms of two links each, far enough from each other."""
    arm = arms.two_link_arm()
    return tm.combine_robots([("left", arm, (0, 0, 0)), ("right", arm, (6, 0, 0))])


def test_arms_work_at_once(both: tm.Robot) -> None:
    home = both.stack(left=[0.3, 0.9], right=[2.5, 0.9])
    stations = [
        tm.Station("a", tm.PositionGoal("left/tip", (1.2, 0.5, 0)), dwell=0.4),
        tm.Station("b", tm.PositionGoal("right/tip", (6.3, 1.2, 0)), dwell=0.4),
    ]
    tour = tm.plan_tour(both, home, stations, motion_limits=LIMITS)
    assert tour.verified and tour.trajectory is not None
    assert tour.trajectory.duration == pytest.approx(tour.cycle_time)
    assert 0.4 < tour.lower_bound <= tour.cycle_time
    # Alone each takes as long as the slower one: neither waits for the other.
    alone = max(
        tm.plan_tour(both, home, [station], motion_limits=LIMITS).cycle_time
        for station in stations
    )
    assert tour.cycle_time == pytest.approx(alone, rel=0.02)


def test_stations_are_shared_by_arms(both: tm.Robot) -> None:
    home = both.stack(left=[0.3, 0.9], right=[2.5, 0.9])
    middle = tm.AnyGoal(
        [
            tm.PositionGoal("left/tip", (1.8, 0.2, 0)),
            tm.PositionGoal("right/tip", (4.2, 0.2, 0)),
        ]
    )
    tour = tm.plan_tour(both, home, {"either": middle}, motion_limits=LIMITS)
    assert tour.verified
    lack, _ = middle.place_residual(RobotKinematics(both), tour.visits[0].q)
    assert np.max(np.abs(lack)) < 1e-6
    assert tour.cycle_time < 1.0


def test_stays_that_begin_together() -> None:
    assert together([("a", 1.0), ("b", 2.0), ("a", 1.5)]) == 2.5
    assert together([("a", 1.0), (None, 2.0)]) == 3.0
    assert together([]) == 0.0


def test_least_stays_count_what_arms_may_share(both: tm.Robot) -> None:
    left = tm.PositionGoal("left/tip", (1, 0, 0))
    right = tm.PositionGoal("right/tip", (5, 0, 0))
    every = tm.JointGoal(np.zeros(4))
    stays = [(left, 3.0), (right, 1.0), (tm.AnyGoal([left, right]), 1.0), (every, 0.5)]
    assert least_stays(both, stays) == 3.5
    assert least_stays(both, [*stays, (tm.AnyGoal([left, right]), 4.0)]) == 5.0
