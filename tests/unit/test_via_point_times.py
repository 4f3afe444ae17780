"""Motions past via points whose motion times are known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide

EXACT = {"intervals": 8, "control": "constant", "effort": "quick", "starts": 1}


def rail() -> tm.Robot:
    """A mass of 1 kg that takes 1 N: accelerations of 1 m/s^2."""
    return make_arm(slide(1.0), effort=np.array([1.0]))


def time_past(*places: float, stop: bool = False, **options) -> float:
    """Motion time T from 0 past via points to the last of the places."""
    parts = [tm.Segment(tm.JointGoal([q]), stop=stop) for q in places]
    solution = tm.plan(tm.Problem(rail(), [0.0], segments=parts), **EXACT | options)
    assert solution.success, solution.message
    return solution.T


def test_a_via_point_on_the_optimum_leaves_the_time_unchanged():
    alone = tm.plan(tm.Problem(rail(), [0.0], tm.JointGoal([1.0])), **EXACT)
    assert pytest.approx(2.0, abs=1e-6) == alone.T
    assert time_past(0.5, 1.0) == pytest.approx(2.0, abs=1e-6)


def test_motion_there_and_back_takes_four_seconds():
    assert time_past(1.0, 0.0) == pytest.approx(4.0, abs=1e-5)


@pytest.mark.parametrize("places", [(1.0, 3.0), (0.5, 1.5, 0.5, 2.5)])
def test_segments_with_stops_take_the_sum_of_the_single_plans(places):
    ways = np.abs(np.diff([0.0, *places]))
    assert time_past(*places, stop=True) == pytest.approx(
        float(np.sum(2.0 * np.sqrt(ways))), abs=1e-5
    )


def test_passing_without_a_stop_takes_the_time_without_the_via_point():
    expected = 2.0 * math.sqrt(3.0)
    found = time_past(1.0, 3.0, intervals=40)
    assert found == pytest.approx(expected, rel=1e-3)
