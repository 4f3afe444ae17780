"""Minimum times on a rail with limits of speed, acceleration, jerk and torque rate.

The durations of plans are compared with closed forms.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

import tominpmp as tm
from benchmarks.rails import KINDS, draw, minimum_time, problem

# Shares of the minimum by which T may exceed it, and fall below it by rounding.
EXCESS, BELOW = 3e-3, 1e-6


def test_minimum_time_is_that_of_the_phases_of_each_motion() -> None:
    jerk, acceleration, velocity = 20.0, 3.0, 0.8
    alone = minimum_time(1.0, jerk=jerk)
    assert alone == pytest.approx((32.0 / jerk) ** (1 / 3), rel=1e-12)
    alone = minimum_time(1.0, acceleration=acceleration)
    assert alone == pytest.approx(2.0 * math.sqrt(1.0 / acceleration), rel=1e-12)
    seven = minimum_time(1.0, velocity, acceleration, jerk)
    ramps = velocity / acceleration + acceleration / jerk
    assert seven == pytest.approx(1.0 / velocity + ramps, rel=1e-12)
    # Without the speed limit: four ramps of jerk and two plateaus of acceleration.
    ramp = acceleration / jerk
    plateau = 0.5 * (math.sqrt(ramp**2 + 4.0 / acceleration) - 3.0 * ramp)
    six = minimum_time(1.0, acceleration=acceleration, jerk=jerk)
    assert six == pytest.approx(4.0 * ramp + 2.0 * plateau, rel=1e-12)


def integrated_distance(
    drawn: dict[str, float], T: float, switches: list[float]
) -> float:
    """Distance of a motion whose jerk is constant but changes its sign at switches."""
    t = np.linspace(0.0, T, 200_001)
    sign = np.where(np.searchsorted(switches, t, side="right") % 2 == 0, 1.0, -1.0)
    q = drawn["jerk"] * sign
    for _ in range(3):
        q = np.concatenate([[0.0], np.cumsum(0.5 * (q[1:] + q[:-1]) * t[1])])
    return float(q[-1])


def test_minimum_time_with_a_jerk_limit_reaches_the_distance() -> None:
    T = minimum_time(1.7, jerk=9.0)
    reached = integrated_distance({"jerk": 9.0}, T, [0.25 * T, 0.75 * T])
    assert reached == pytest.approx(1.7, rel=1e-4)


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("kind", KINDS)
def test_default_options_reach_the_minimum_time(kind: str, number: int) -> None:
    drawn = draw(kind, np.random.default_rng([7, number]))
    limits = {
        key: drawn.get(key, math.inf) for key in ("velocity", "acceleration", "jerk")
    }
    minimum = minimum_time(drawn["distance"], **limits)
    solution = tm.plan(problem(kind, drawn))
    assert solution.success
    assert minimum * (1.0 - BELOW) < solution.T < minimum * (1.0 + EXCESS)
    assert solution.certificate is not None
    assert solution.certificate.ok, solution.certificate.message


@pytest.mark.parametrize("intervals", [21, 35, 50, 160])
@pytest.mark.parametrize("kind", ["jerk", "torque rate", "seven phases"])
def test_coarse_and_fine_grids_reach_the_minimum_time(
    kind: str, intervals: int
) -> None:
    """Regression: short first intervals made the programs of fine grids fail."""
    drawn = draw(kind, np.random.default_rng(1))
    limits = {
        key: drawn.get(key, math.inf) for key in ("velocity", "acceleration", "jerk")
    }
    minimum = minimum_time(drawn["distance"], **limits)
    solution = tm.plan(problem(kind, drawn), intervals=intervals)
    assert solution.success
    assert minimum * (1.0 - BELOW) < solution.T < minimum * (1.0 + EXCESS)


def test_spline_control_is_close_to_the_minimum_time() -> None:
    drawn = draw("seven phases", np.random.default_rng(3))
    limits = {key: drawn[key] for key in ("velocity", "acceleration", "jerk")}
    minimum = minimum_time(drawn["distance"], **limits)
    solution = tm.plan(problem("seven phases", drawn), control="spline")
    assert minimum < solution.T < minimum * (1.0 + 2.0 * EXCESS)
