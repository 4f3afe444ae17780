"""Tours of robots with several arms."""

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


def test_arms_visit_their_stations_at_the_same_time(both: tm.Robot) -> None:
    home = both.stack(left=[0.3, 0.9], right=[2.5, 0.9])
    stations = [
        tm.Station("a", tm.PositionGoal("left/tip", (1.2, 0.5, 0)), dwell=0.4),
        tm.Station("b", tm.PositionGoal("right/tip", (6.3, 1.2, 0)), dwell=0.4),
    ]
    tour = tm.plan_tour(both, home, stations, motion_limits=LIMITS)
    assert tour.verified and tour.trajectory is not None
    assert tour.trajectory.duration == pytest.approx(tour.cycle_time)
    assert 0.4 < tour.lower_bound <= tour.cycle_time
    # The tour takes as long as that of the slower arm: neither waits for the other.
    alone = max(
        tm.plan_tour(both, home, [station], motion_limits=LIMITS).cycle_time
        for station in stations
    )
    assert tour.cycle_time == pytest.approx(alone, rel=0.02)


def test_either_arm_may_visit_a_station(both: tm.Robot) -> None:
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


def test_together_adds_the_dwells_of_each_arm() -> None:
    assert together([("a", 1.0), ("b", 2.0), ("a", 1.5)]) == 2.5
    assert together([("a", 1.0), (None, 2.0)]) == 3.0
    assert together([]) == 0.0


def test_least_dwells_account_for_stations_of_either_arm(both: tm.Robot) -> None:
    left = tm.PositionGoal("left/tip", (1, 0, 0))
    right = tm.PositionGoal("right/tip", (5, 0, 0))
    every = tm.JointGoal(np.zeros(4))
    stays = [(left, 3.0), (right, 1.0), (tm.AnyGoal([left, right]), 1.0), (every, 0.5)]
    assert least_stays(both, stays) == 3.5
    assert least_stays(both, [*stays, (tm.AnyGoal([left, right]), 4.0)]) == 5.0
