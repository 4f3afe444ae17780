"""Sensitivities of the cycle time, compared with cycles of moved stations and other
limits.
"""

from __future__ import annotations

import numpy as np
import pytest

import tests.sample_arms as arms
import tominpmp as tm
from tominpmp.cell.tours.legs import JointTimes

HOME = np.array([0.3, 0.9])
PLACES = {"far": np.array([0.1, 1.6]), "near": np.array([-0.9, 0.7])}
LIMITS = tm.MotionLimits(acceleration=6.0)
DWELL, STEP = 0.4, 1e-5


@pytest.fixture(scope="module")
def arm() -> tm.Robot:
    """Two turning joints with a frame at the end, whose torques never limit it."""
    return arms.two_link_arm()


@pytest.fixture(scope="module")
def tour(arm: tm.Robot) -> tm.Tour:
    tip = arm.frame_names[-1]
    stations = [
        tm.Station(name, tm.PositionGoal(tip, (*place, 0.0)), dwell=DWELL)
        for name, place in PLACES.items()
    ]
    return tm.plan_tour(arm, HOME, stations, motion_limits=LIMITS)


def reached(place: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The configuration nearest in posture to q whose tip is at the place."""
    x, y = place
    bend = np.arccos(0.5 * (x * x + y * y) - 1.0) * np.sign(q[1])
    first = np.arctan2(y, x) - np.arctan2(np.sin(bend), 1.0 + np.cos(bend))
    return np.array([first, bend])


def cycle(tour: tm.Tour, moved: str, by: np.ndarray) -> float:
    """Sum of the motion times if a station is moved, in the same order."""
    times, way = JointTimes.of(tour.problem), [HOME]
    for visit in tour.visits:
        shift = by if visit.station == moved else np.zeros(2)
        way.append(reached(PLACES[visit.station] + shift, visit.q))
    places = np.stack([*way, HOME])
    return float(np.sum(times.between(places[:-1], places[1:])))


def test_sensitivities_to_station_places_match_differences(tour: tm.Tour) -> None:
    assert tour.direct == 3
    for name in PLACES:
        (record,) = tour.sensitivities.of("goal", name)
        assert record.vector is not None
        expected = [
            (cycle(tour, name, STEP * axis) - cycle(tour, name, -STEP * axis))
            / (2.0 * STEP * tour.cycle_time)
            for axis in np.eye(2)
        ]
        assert np.max(np.abs(expected)) > 0.01
        assert record.vector[:2] == pytest.approx(expected, rel=0.05, abs=5e-3)


def test_sensitivities_of_limits_add_up_to_the_moving_time(tour: tm.Tour) -> None:
    found = tour.sensitivities
    assert found.T == tour.cycle_time
    moving = 1.0 - 2.0 * DWELL / tour.cycle_time
    scaled = found.total("velocity") + 2.0 * found.total("acceleration")
    assert -scaled == pytest.approx(moving, rel=1e-3)
    # Configurations at the ends of legs are no goals of their own.
    assert {r.subject for r in found if r.kind == "goal"} <= set(PLACES)
    assert "far" in found.table()


def test_sensitivities_reject_a_missing_tour(tour: tm.Tour) -> None:
    nothing = tm.Tour(tour.problem, tour.stations, tour.status, "It was stopped.")
    with pytest.raises(tm.ProblemError, match=r"no tour: It was stopped\."):
        _ = nothing.sensitivities
