"""Lower bounds of arms with two joints, and the arithmetic behind them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sample_arms import DOWNWARD, make_arm, rod
from two_link_cases import CASES

from tominpmp.bounds import LowerBound, lower_bound
from tominpmp.bounds.intervals import Interval, Table
from tominpmp.bounds.tubes import Tube, known
from tominpmp.goals import JointGoal
from tominpmp.problem import Problem

PAIRS = {
    name: case
    for family in ("level", "vertical")
    for name, case in CASES[family].items()
    if "payload" not in name or "," not in name.split("payload")[1]
}


@pytest.mark.parametrize("name", PAIRS)
def test_two_links_take_no_less_than_three_fifths_of_what_they_need(name: str) -> None:
    case = PAIRS[name]
    found = lower_bound(case.problem())
    assert 0.6 * case.minimum < found.T <= case.minimum
    assert lower_bound(case.problem(), quick=True).T <= found.T


@pytest.mark.parametrize("name", ["payload, friction", "payload, moving ends"])
def test_payloads_with_friction_have_a_bound_too(name: str) -> None:
    case = CASES["vertical"][f"vertical rods, {name}"]
    found = lower_bound(case.problem())
    assert 0.54 * case.minimum < found.T <= case.minimum


def test_what_slows_the_arm_down_raises_the_bound() -> None:
    def bound(**changes: object) -> float:
        arm = make_arm(
            rod(1.0, 1.0), rod(1.0, 0.7), effort=np.array([30.0, 12.0]), **changes
        )
        problem = Problem(arm, np.array([-0.5, 0.4]), JointGoal([0.9, -0.3]))
        return lower_bound(problem, quick=True).T

    plain = bound()
    assert bound(velocity=1.0) > plain
    assert bound(armature=2.0) > plain
    # Whether it falls or rises is not known beforehand: the bound holds for both.
    assert 0.0 < bound(gravity=DOWNWARD) < 2.0 * plain


def test_arithmetic_of_intervals_encloses(rng: np.random.Generator) -> None:
    ends = np.sort(rng.normal(size=(2, 2, 500)), axis=1) * 3.0
    a, b = Interval(*ends[0]), Interval(*ends[1])
    x, y = (
        part.low + rng.uniform(size=500) * (part.high - part.low) for part in (a, b)
    )
    above = Interval(np.abs(b.low), np.abs(b.low) + np.abs(b.high) + 1e-3)
    z = above.low + rng.uniform(size=500) * (above.high - above.low)
    for found, value in (
        (a.plus(b), x + y),
        (a.minus(b), x - y),
        (a.times(b), x * y),
        (a.over(above), x / z),
        (a.squared(), x**2),
        (a.cosine(), np.cos(x)),
        (a.sine(), np.sin(x)),
    ):
        assert np.all(found.low <= value + 1e-12)
        assert np.all(value <= found.high + 1e-12)
    nothing, everything = Interval(np.zeros(1), np.zeros(1)), Interval.everything(1)
    assert nothing.times(everything) == nothing
    assert everything.cosine() == (-1.0, 1.0)


def test_ranges_of_functions_enclose(rng: np.random.Generator) -> None:
    x = np.linspace(-2.0, 3.0, 400)
    table = Table(x, np.array([np.sin(3.0 * x), x**2]))
    ends = np.sort(rng.uniform(-2.0, 3.0, (2, 200)), axis=0)
    at = ends[0] + rng.uniform(size=200) * (ends[1] - ends[0])
    for found, value in zip(
        table.ranges(Interval(*ends)), (np.sin(3.0 * at), at**2), strict=True
    ):
        assert np.all(found.low <= value)
        assert np.all(value <= found.high)


@pytest.mark.parametrize("drag", [0.0, 0.7, 4.0])
def test_tubes_enclose_motions_with_drag(drag: float, rng: np.random.Generator) -> None:
    """Under random rates within bounds, waiting now and then."""
    K, h, fine = 20, 0.05, 50
    for _ in range(20):
        u = rng.uniform(-1.0, 1.0, K * fine)
        x = [float(rng.normal())]
        for push in u * (rng.uniform(size=u.size) < 0.9):
            moves = push != 0.0
            x.append(x[-1] + h / fine * (push - drag * x[-1]) * moves)
        path = np.array(x)
        rate = Interval(-np.ones(K), np.ones(K))
        around = Interval(np.full(K, 0.9 * drag), np.full(K, 1.1 * drag))
        tube = Tube.damped(known((path[0], path[-1])), rate, around, h)
        assert not tube.empty
        within = tube.within()
        for k in range(K):
            part = path[k * fine : (k + 1) * fine + 1]
            assert within.low[k] <= part.min() + 1e-3
            assert part.max() <= within.high[k] + 1e-3
            way = tube.integral(h)
            mean = float(np.mean(part[:-1])) * h
            assert way.low[k] - 1e-3 * h <= mean <= way.high[k] + 1e-3 * h


def test_only_bounds_that_are_near_are_told() -> None:
    bound = LowerBound(1.0, "so it is")
    assert bound.comparison(1.05) == "5.0 % above what none can beat"
    assert bound.comparison(1.0 - 1e-5) == "0.0 % above what none can beat"
    assert bound.comparison(1.95) == ""
    assert bound.comparison(math.inf) == ""
    assert LowerBound(0.0, "nothing").comparison(1.0) == ""
