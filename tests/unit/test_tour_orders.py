"""The order of tours: times of legs, exact and searched orders, rules, bounds."""

from __future__ import annotations

from itertools import pairwise, permutations, product

import numpy as np
import pytest

from tominpmp.bounds.least_time import OneWay, Ramp
from tominpmp.cell.tours.legs import JointTimes, LegTable
from tominpmp.cell.tours.lower_bound import _one_tree
from tominpmp.cell.tours.orders import Route, exact_order, search_order
from tominpmp.cell.tours.station import Rules, Station, checked_stations
from tominpmp.exceptions import ProblemError
from tominpmp.goals.joints import JointGoal

LIMITS = JointTimes(np.array([2.0, 3.0]), np.array([5.0, 4.0]), np.full(2, np.inf))
ANY = JointGoal([0.0])


def table(sizes: list[int], seed: int, rules: Rules, **known: bool) -> LegTable:
    """A table of legs between nodes with the given numbers of random configurations."""
    rng = np.random.default_rng(seed)
    nodes = [rng.uniform(-2.0, 2.0, (size, 2)) for size in sizes]
    out = LegTable(nodes, [True] * len(sizes), LIMITS, rules)
    if known.get("known"):
        # The times of the two directions differ.
        for i, j in permutations(range(len(sizes)), 2):
            for a, b in product(range(sizes[i]), range(sizes[j])):
                out.known[(i, a), (j, b)] = float(rng.uniform(0.2, 3.0))
    return out


def exact(legs: LegTable) -> tuple[float, Route]:
    """The best route through the nodes of a table, and its time."""
    sizes = [len(rows) for rows in legs.nodes[1 : legs.rules.count + 1]]
    return exact_order(sizes, legs.block, legs.rules)


def brute_force(legs: LegTable) -> float:
    """The least time of all orders and configurations, by enumeration."""
    best, rules = np.inf, legs.rules
    n = rules.count
    for order in permutations(range(1, n + 1)):
        if rules.allow(order):
            nodes = rules.along(0, order, n + 1)
            for chosen in product(*(range(len(legs.nodes[k])) for k in nodes)):
                places = list(zip(nodes, chosen, strict=True))
                total = sum(map(legs.time, pairwise(places)))
                best = min(best, total)
    return best


def rules_of(
    count: int, before: set[tuple[int, int]], then: dict, ends: bool = True
) -> Rules:
    stations = [
        Station(
            str(k),
            ANY,
            after=[str(i) for i, j in before if j == k],
            then=[str(i) for i in then.get(k, ())],
        )
        for k in range(1, count + 1)
    ]
    return Rules.of(stations, (), ends)


@pytest.mark.parametrize("resting", [0, 1, 2])
def test_joint_times_match_the_lower_bound_of_one_joint(resting: int) -> None:
    rng = np.random.default_rng(resting)
    way = rng.uniform(0.0, 3.0, (40, 2))
    # An end without rest may have any speed.
    ends = {2: (0.0, 0.0), 1: (0.0, np.inf), 0: (np.inf, np.inf)}[resting]
    found = LIMITS.of_joints(way, resting)
    for row, times in zip(way, found, strict=True):
        for k in range(2):
            v, ramp = float(LIMITS.velocity[k]), Ramp(float(LIMITS.acceleration[k]))
            known = OneWay(ramp, ramp, v, ends).least_time(float(row[k]))
            assert times[k] == pytest.approx(known, rel=1e-6)


@pytest.mark.parametrize("resting", [0, 1, 2])
def test_joint_without_limits_takes_no_time(resting: int) -> None:
    """Regression: the time was NaN for a joint with neither limit."""
    none = np.full(1, np.inf)
    for way in (0.0, 1.0):
        assert JointTimes(none, none, none).of_joints(np.array([way]), resting) == 0.0


@pytest.mark.parametrize("jerk", [3.0, 20.0, 1e4])
@pytest.mark.parametrize("acceleration", [5.0, np.inf])
def test_joint_times_with_jerk_match_the_lower_bound(
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
        ({(4, 1), (3, 2)}, {}),
        (set(), {1: frozenset({3, 4}), 2: frozenset({3, 4})}),
    ],
)
def test_exact_order_matches_enumeration(
    ends: bool, known: bool, before: set[tuple[int, int]], then: dict
) -> None:
    rules = rules_of(4, before, then, ends)
    legs = table([1, 2, 3, 2, 2, *([1] if ends else [])], 4, rules, known=known)
    total, route = exact(legs)
    assert total == pytest.approx(brute_force(legs), rel=1e-12)
    assert rules.allow([node for node, _ in route[1:5]])
    assert [node for node, _ in (route[0], *route[5:])] == ([0, 5] if ends else [0])
    assert total == pytest.approx(sum(map(legs.time, pairwise(route))))


def test_contradictory_rules_leave_no_order() -> None:
    # After each station another one has to come, so that no station is the last one.
    every = {1, 2, 3}
    rules = rules_of(3, set(), {k: every - {k} for k in every})
    legs = table([1, 1, 1, 1, 1], 0, rules)
    assert exact(legs) == (np.inf, [])
    rng = np.random.default_rng(0)
    assert search_order(legs, rng) == (np.inf, [])
    # An order that the rules allow, whose legs have no motion.
    legs = table([1, 1, 1, 1], 0, rules_of(2, set(), {}))
    legs.known |= {((0, 0), (k, 0)): np.inf for k in (1, 2)}
    assert exact(legs) == search_order(legs, rng) == (np.inf, [])


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("before", [set(), {(8, 1), (1, 4), (6, 3)}])
def test_searched_order_is_within_ten_per_cent_of_the_exact_order(
    known: bool, before: set[tuple[int, int]]
) -> None:
    for seed in range(3):
        # Random times belong to no arm; there only the order is searched.
        rules = rules_of(8, before, {})
        legs = table([1, *[1 if known else 2] * 8, 1], seed, rules, known=known)
        best = exact(legs)[0]
        found, route = search_order(legs, np.random.default_rng(0))
        assert best - 1e-9 <= found <= 1.1 * best
        assert rules.allow([node for node, _ in route[1:9]])


@pytest.mark.parametrize("ends", [True, False])
def test_one_tree_bound_is_below_the_exact_order(ends: bool) -> None:
    for seed in range(6):
        rules = rules_of(5, set() if seed % 3 else {(1, 5), (3, 2)}, {}, ends)
        legs = table([1] * (7 if ends else 6), seed, rules, known=seed % 2 == 0)
        least = legs.fixed([0] * len(legs.nodes))
        best = exact(legs)[0]
        assert 0.3 * best < _one_tree(np.minimum(least, least.T), ends) <= best + 1e-9


def test_cycles_and_unknown_names_in_precedence_are_named() -> None:
    circle = [
        Station("a", ANY, after=["c"]),
        Station("b", ANY, after=["a"]),
        Station("c", ANY),
    ]
    with pytest.raises(ProblemError, match=r"cycle: .*'?a before b before c before a"):
        Rules.of(circle, [("b", "c")])
    with pytest.raises(ProblemError, match="precedence: there is no station 'x'"):
        Rules.of(circle, [("a", "x")])
    with pytest.raises(ProblemError, match="precedence"):
        Rules.of(circle, "ab")  # type: ignore[arg-type]
    with pytest.raises(ProblemError, match="after: there is no other station 'x'"):
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
def test_wrong_field_of_a_station_is_named(field: str, value: object) -> None:
    with pytest.raises(ProblemError, match=f"{field}|velocity") as error:
        Station(**{"name": "a", "goal": ANY, field: value})
    assert error.value.field == f"station.{field}"


@pytest.mark.parametrize("given", [[], "ab", 3, [3], {"a": 3}, ANY])
def test_wrong_stations_are_rejected(given: object) -> None:
    with pytest.raises(ProblemError, match=r"stations|station 1 \('a'\)"):
        checked_stations(given)
