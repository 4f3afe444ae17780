"""Tests of the order of tours: times, exact and searched orders, rules, bounds."""

from __future__ import annotations

from itertools import pairwise, permutations, product

import numpy as np
import pytest

from tominpmp.bounds.least_time import OneWay, Ramp
from tominpmp.cell.tours.legs import JointTimes, LegTable
from tominpmp.cell.tours.lower_bound import _one_tree
from tominpmp.cell.tours.orders import Order, exact_order, search_order
from tominpmp.cell.tours.station import Rules, Station, checked_stations
from tominpmp.exceptions import ProblemError
from tominpmp.goals.joints import JointGoal

LIMITS = JointTimes(np.array([2.0, 3.0]), np.array([5.0, 4.0]), np.full(2, np.inf))
ANY = JointGoal([0.0])


def table(sizes: list[int], seed: int, rules: Rules, **known: bool) -> LegTable:
    """Nodes with so many random configurations each."""
    rng = np.random.default_rng(seed)
    nodes = [rng.uniform(-2.0, 2.0, (size, 2)) for size in sizes]
    out = LegTable(nodes, [True] * len(sizes), LIMITS, rules)
    if known.get("known"):
        # Times that differ there and back.
        for i, j in permutations(range(len(sizes)), 2):
            for a, b in product(range(sizes[i]), range(sizes[j])):
                out.known[i, a, j, b] = float(rng.uniform(0.2, 3.0))
    return out


def exact(legs: LegTable) -> Order:
    """The best order of the stations of a table."""
    sizes = [len(rows) for rows in legs.nodes[1 : legs.rules.count + 1]]
    return exact_order(sizes, legs.block, legs.rules)


def brute_force(legs: LegTable) -> float:
    """The best of all orders and configurations, one by one."""
    best, rules = np.inf, legs.rules
    n = rules.count
    for order in permutations(range(n)):
        if rules.allow(order):
            nodes = [0, *(i + 1 for i in order), *([n + 1] if rules.ends else [])]
            for chosen in product(*(range(len(legs.nodes[k])) for k in nodes)):
                places = list(zip(nodes, chosen, strict=True))
                total = sum(legs.time((*a, *b)) for a, b in pairwise(places))
                best = min(best, total)
    return best


def rules_of(
    count: int, before: set[tuple[int, int]], then: dict, ends: bool = True
) -> Rules:
    return Rules(count, frozenset(before), then, ends)


@pytest.mark.parametrize("resting", [0, 1, 2])
def test_times_of_joints_are_those_of_the_bounds(resting: int) -> None:
    rng = np.random.default_rng(resting)
    way = rng.uniform(0.0, 3.0, (40, 2))
    # Where it does not rest, it may have any speed.
    ends = {2: (0.0, 0.0), 1: (0.0, np.inf), 0: (np.inf, np.inf)}[resting]
    found = LIMITS.of_joints(way, resting)
    for row, times in zip(way, found, strict=True):
        for k in range(2):
            v, ramp = float(LIMITS.velocity[k]), Ramp(float(LIMITS.acceleration[k]))
            known = OneWay(ramp, ramp, v, ends).least_time(float(row[k]))
            assert times[k] == pytest.approx(known, rel=1e-6)


@pytest.mark.parametrize("resting", [0, 1, 2])
def test_a_joint_without_limits_takes_no_time(resting: int) -> None:
    """It was no number for a joint that has neither limit."""
    none = np.full(1, np.inf)
    for way in (0.0, 1.0):
        assert JointTimes(none, none, none).of_joints(np.array([way]), resting) == 0.0


@pytest.mark.parametrize("jerk", [3.0, 20.0, 1e4])
@pytest.mark.parametrize("acceleration", [5.0, np.inf])
def test_times_with_jerk_are_those_of_the_bounds(
    jerk: float, acceleration: float
) -> None:
    limits = JointTimes(np.array([2.0]), np.array([acceleration]), np.array([jerk]))
    for way in (1e-4, 0.1, 0.7, 5.0):
        ramp = Ramp(acceleration, jerk)
        known = OneWay(ramp, ramp, 2.0, (0.0, 0.0)).least_time(way)
        found = float(limits.of_joints(np.array([way]))[0])
        assert found == pytest.approx(known, rel=1e-5)


@pytest.mark.parametrize("ends", [True, False])
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    ("before", "then"),
    [
        (set(), {}),
        ({(3, 0), (2, 1)}, {}),
        (set(), {0: frozenset({2, 3}), 1: frozenset({2, 3})}),
    ],
)
def test_exact_orders_are_the_best_of_all(
    ends: bool, known: bool, before: set[tuple[int, int]], then: dict
) -> None:
    rules = rules_of(4, before, then, ends)
    legs = table([1, 2, 3, 2, 2, *([1] if ends else [])], 4, rules, known=known)
    total, order, chosen = exact(legs)
    assert total == pytest.approx(brute_force(legs), rel=1e-12)
    assert rules.allow(order)
    nodes = [0, *(i + 1 for i in order), *([5] if ends else [])]
    places = list(zip(nodes, chosen, strict=True))
    assert total == pytest.approx(sum(legs.time((*a, *b)) for a, b in pairwise(places)))


def test_no_order_where_rules_leave_none() -> None:
    rules = rules_of(2, set(), {0: frozenset({1}), 1: frozenset({0})})
    legs = table([1, 1, 1, 1], 0, rules)
    assert exact(legs)[0] == np.inf
    rng = np.random.default_rng(0)
    assert search_order(legs, rng)[0] == np.inf


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("before", [set(), {(7, 0), (0, 3), (5, 2)}])
def test_searched_orders_are_near_the_best(
    known: bool, before: set[tuple[int, int]]
) -> None:
    for seed in range(3):
        # Times at random are those of no arm: there the order alone is looked for.
        rules = rules_of(8, before, {})
        legs = table([1, *[1 if known else 2] * 8, 1], seed, rules, known=known)
        best = exact(legs)[0]
        found, order, _ = search_order(legs, np.random.default_rng(0))
        assert best - 1e-9 <= found <= 1.1 * best
        assert rules.allow(order)


@pytest.mark.parametrize("ends", [True, False])
def test_bounds_are_below_the_best_order(ends: bool) -> None:
    for seed in range(6):
        rules = rules_of(5, set() if seed % 3 else {(0, 4), (2, 1)}, {}, ends)
        legs = table([1] * (7 if ends else 6), seed, rules, known=seed % 2 == 0)
        least = legs.fixed([0] * len(legs.nodes))
        best = exact(legs)[0]
        assert 0.3 * best < _one_tree(np.minimum(least, least.T), ends) <= best + 1e-9


def test_circles_and_unknown_names_are_told() -> None:
    circle = [
        Station("a", ANY, after=["c"]),
        Station("b", ANY, after=["a"]),
        Station("c", ANY),
    ]
    with pytest.raises(ProblemError, match=r"cycle: .*'?a before b before c before a"):
        Rules.of(circle, [("b", "c")])
    with pytest.raises(ProblemError, match="precedence names 'x'"):
        Rules.of(circle, [("a", "x")])
    with pytest.raises(ProblemError, match="precedence"):
        Rules.of(circle, "ab")  # type: ignore[arg-type]
    with pytest.raises(ProblemError, match="after names 'x'"):
        checked_stations([Station("a", ANY, after=["x"])])
    with pytest.raises(ProblemError, match="both called 'a'"):
        checked_stations([Station("a", ANY), Station("a", ANY)])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("name", ""),
        ("name", 3),
        ("goal", "there"),
        ("goal", JointGoal([0.0], v=[1.0])),
        ("dwell", -1.0),
        ("dwell", "long"),
        ("after", 3),
        ("then", [4]),
        ("payload", "box"),
        ("stop", 1),
    ],
)
def test_wrong_fields_of_stations_are_named(field: str, value: object) -> None:
    with pytest.raises(ProblemError, match=f"{field}|velocity") as error:
        Station(**{"name": "a", "goal": ANY, field: value})
    assert error.value.field == f"station.{field}"


@pytest.mark.parametrize("given", [[], "ab", 3, [3], {"a": 3}, ANY])
def test_wrong_stations_are_told(given: object) -> None:
    with pytest.raises(ProblemError, match=r"stations|station 1 \('a'\)"):
        checked_stations(given)
