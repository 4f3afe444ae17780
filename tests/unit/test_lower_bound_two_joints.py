"""Lower bounds of arms with two joints, and the arithmetic behind them."""

from __future__ import annotations

import importlib
import itertools
import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from sample_arms import DOWNWARD, FAR, make_arm, rod
from two_link_cases import CASES

from tominpmp.bounds import LowerBound, lower_bound
from tominpmp.bounds.enclosures import GATES, INTERVALS
from tominpmp.bounds.inertia import inertia_at
from tominpmp.bounds.intervals import Interval, Table
from tominpmp.bounds.narrowing import all_motions, narrowed
from tominpmp.bounds.tubes import Gates, Tube
from tominpmp.bounds.two_joints import TwoJoints
from tominpmp.bounds.two_joints_time import shaved
from tominpmp.exceptions import ProblemError
from tominpmp.goals import JointGoal
from tominpmp.problem import Problem
from tominpmp.robot import Robot
from tominpmp.stopping import Stop

PAIRS = {
    name: case
    for family in ("level", "vertical")
    for name, case in CASES[family].items()
}
# Those that telling motions apart halfway alone brought less of the minimum.
SHARES = {"vertical rods, payload, friction": 0.6, "rods, bent elbow": 0.88}


@pytest.mark.parametrize("name", PAIRS)
def test_two_links_take_no_less_than_three_fifths_of_what_they_need(name: str) -> None:
    case = PAIRS[name]
    found = lower_bound(case.problem())
    assert SHARES.get(name, 0.6) * case.minimum < found.T <= case.minimum
    assert lower_bound(case.problem(), quick=True).T <= found.T


def thrown(
    robot: Robot, start: np.ndarray, levels: np.ndarray, T: float
) -> tuple[np.ndarray, np.ndarray]:
    """States under torques of some levels in turn, shape (m, 2) each (Runge, Kutta)."""
    steps = 10 * INTERVALS * len(levels)
    h, data = T / steps, robot.model.createData()
    q, v = start
    states = [start]
    for k in range(steps):
        u = levels[k * len(levels) // steps]

        def a(q: np.ndarray, v: np.ndarray, u: np.ndarray = u) -> np.ndarray:
            return pin.aba(robot.model, data, q, v, u - robot.damping * v).copy()

        a1 = a(q, v)
        a2 = a(q + h / 2 * v, v + h / 2 * a1)
        a3 = a(q + h / 2 * (v + h / 2 * a1), v + h / 2 * a2)
        a4 = a(q + h * (v + h / 2 * a2), v + h * a3)
        q = q + h * v + h * h / 6 * (a1 + a2 + a3)
        v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        states.append(np.array([q, v]))
    both = np.array(states)
    return both[:, 0], both[:, 1]


@pytest.mark.parametrize("damping", [0.0, 0.6])
def test_no_motion_is_lost_in_any_set_that_it_is_in(
    damping: float, rng: np.random.Generator
) -> None:
    """Under full torques in turn, through ranges around what it is at the gates."""
    robot = make_arm(
        rod(1.0, 1.0),
        rod(1.5, 0.7),
        effort=np.array([25.0, 12.0]),
        gravity=DOWNWARD,
        damping=damping,
    )
    rest = Problem(robot, np.array([-1.5, 0.1]), JointGoal([-1.4, 0.2]))
    top = robot.limits.effort_upper
    looked_at = 0
    while looked_at < 5:
        T = float(rng.uniform(0.1, 0.6))
        start = np.array([rng.uniform(-1.5, 1.5, 2), rng.normal(size=2)])
        levels = np.clip(2.0 * rng.uniform(-1.0, 1.0, (4, 2)), -1.0, 1.0) * top
        q, v = thrown(robot, start, levels, T)
        if np.abs(q).max() > FAR["revolute"]:
            continue
        looked_at += 1
        arm = TwoJoints.of(rest, q[[0, -1]], v[[0, -1]])
        assert arm is not None
        M = inertia_at(robot, q)
        ratio = M[:, 0, 1] / M[:, 0, 0]
        p = M[:, 0, 0] * v[:, 0] + M[:, 0, 1] * v[:, 1]
        y = np.sqrt(M[:, 1, 1] - M[:, 0, 1] * ratio) * v[:, 1]
        rate = p / M[:, 0, 0]
        way = np.cumsum(0.5 * (rate[1:] + rate[:-1])) * T / len(rate[1:])
        c = arm.q[0] + arm.shift[0] + np.append(0.0, way)
        told = np.column_stack([np.interp(q[:, 1], arm.x, arm.arc), y, p, c])
        scale, size = np.ptp(told, axis=0), len(q) // INTERVALS
        truth = told[[size * node for node in GATES]]
        T *= 1.0 + 1e-5
        sets, _ = narrowed(arm, T, all_motions(arm, T), 5)
        assert sets.rows == 1
        rows = 20
        sets = sets.taken(np.zeros(rows, dtype=np.intp))
        wide = 10.0 ** rng.uniform(-3.5, 0.5, (rows, 2, 4)) * scale
        left = wide * rng.uniform(size=wide.shape) + 2e-4 * scale
        low = np.maximum(sets.low, truth - left)
        high = np.minimum(sets.high, truth + wide - left + 4e-4 * scale)
        sets, which = narrowed(arm, T, replace(sets, low=low, high=high), 6)
        assert which.size == rows
        for found, value in (
            (sets.q1, q[:, 0]),
            (sets.q2, q[:, 1]),
            (sets.p, p),
            (sets.y, y),
        ):
            of_interval = value[:-1].reshape(INTERVALS, size)
            slack = 1e-3 * np.ptp(value)
            assert np.all(found.low <= of_interval.min(axis=1) + slack)
            assert np.all(of_interval.max(axis=1) <= found.high + slack)
        shaved_sets = shaved(arm, T, sets.taken(np.zeros(1, dtype=np.intp)))
        assert shaved_sets.rows == 1


def test_motions_are_cut_in_parts_that_have_all_of_them() -> None:
    arm = make_arm(rod(1.0, 1.0), rod(1.0, 0.7), effort=np.array([30.0, 12.0]))
    problem = Problem(arm, np.array([-0.5, 0.4]), JointGoal([0.9, -0.3]))
    ends = np.array([[-0.5, 0.4], [0.9, -0.3]])
    pair = TwoJoints.of(problem, ends, np.zeros((2, 2)))
    assert pair is not None
    sets, _ = narrowed(pair, 0.6, all_motions(pair, 0.6), 5)
    width = (sets.high - sets.low)[0]
    halves = sets.halved(width).halved(width)
    assert halves.rows == 4
    np.testing.assert_allclose(
        np.sum(np.prod(halves.high - halves.low, (1, 2))), width.prod()
    )
    slices = sets.sliced(5)
    assert slices.rows == 5 * width.size
    for number in range(width.size):
        mine = slices.taken(np.arange(5 * number, 5 * number + 5))
        np.testing.assert_allclose(mine.hull.low, sets.low)
        np.testing.assert_allclose(mine.hull.high, sets.high)
        parts = np.prod(mine.high - mine.low, (1, 2))
        np.testing.assert_allclose(np.sum(parts), width.prod())


@pytest.mark.parametrize("name", ["rods, bent elbow", "vertical rods, friction"])
def test_several_times_are_looked_at_as_one_by_one(name: str) -> None:
    problem = PAIRS[name].problem()
    goal = problem.goal.configuration
    assert goal is not None
    ends = np.stack([problem.q_start, goal])
    arm = TwoJoints.of(problem, ends, np.zeros((2, 2)))
    assert arm is not None
    times = PAIRS[name].minimum * np.linspace(0.3, 1.2, 12)
    _, left = narrowed(arm, times, all_motions(arm, times), 5)
    alone = [narrowed(arm, T, all_motions(arm, T), 5)[0].rows for T in times]
    np.testing.assert_array_equal(left, np.flatnonzero(alone))
    assert 0 < left.size < times.size


def test_no_time_beyond_a_known_motion_is_looked_at(monkeypatch) -> None:
    case = PAIRS["rods, bent elbow"]
    problem, module = (
        case.problem(),
        importlib.import_module("tominpmp.bounds.two_joints_time"),
    )
    seen: list[float] = []
    before = module.narrowed

    def narrowed(arm: TwoJoints, T: object, *rest: object) -> object:
        seen.append(float(np.max(T)))
        return before(arm, T, *rest)

    monkeypatch.setattr(module, "narrowed", narrowed)
    bound = lower_bound(problem, known=case.minimum).T
    assert 0.8 * case.minimum < bound <= case.minimum
    assert max(seen) < case.minimum
    # Where something else tells as much, the two joints are not looked at.
    slow = Problem(
        problem.robot.with_changes(velocity=1e-3), problem.q_start, problem.goal
    )
    seen.clear()
    limited = lower_bound(slow, known=np.inf, quick=True).T
    seen.clear()
    assert lower_bound(slow, known=1.01 * limited).T == pytest.approx(limited)
    assert not seen


@pytest.mark.parametrize("known", [0.0, -1.0, np.nan, "long"])
def test_a_known_time_that_is_none_is_named(known: object) -> None:
    with pytest.raises(ProblemError, match="known"):
        lower_bound(PAIRS["rods, bent elbow"].problem(), known=known)  # type: ignore


@pytest.mark.parametrize("quick", [False, True])
def test_bounds_that_are_cut_short_are_what_is_known(quick, monkeypatch) -> None:
    """Of all looks of the search, every one asks whether it is time to stop."""
    module = importlib.import_module("tominpmp.bounds.two_joints_time")
    problem, looks = PAIRS["rods, bent elbow"].problem(), []

    def stopped_after(count: int) -> float:
        looks.clear()

        def check() -> None:
            looks.append(1)
            if len(looks) > count:
                raise Stop(requested=False)

        monkeypatch.setattr(module, "check", check)
        return lower_bound(problem, quick=quick).T

    bounds = [stopped_after(count) for count in (0, 1, 30)]
    assert bounds == sorted(bounds)
    assert 0.0 < bounds[1] < bounds[2] <= PAIRS["rods, bent elbow"].minimum


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
    K, h, fine, gates = 20, 0.05, 50, (4, 11)
    for _ in range(20):
        u = rng.uniform(-1.0, 1.0, K * fine)
        x = [float(rng.normal())]
        for push in u * (rng.uniform(size=u.size) < 0.9):
            moves = push != 0.0
            x.append(x[-1] + h / fine * (push - drag * x[-1]) * moves)
        path = np.array(x)
        rate = Interval(-np.ones((2, K)), np.ones((2, K)))
        around = Interval(np.full((2, K), 0.9 * drag), np.full((2, K), 1.1 * drag))
        # It may be anywhere at the gates in the first row, and is known in the second.
        there = path[[k * fine for k in gates]]
        far = np.full(2, np.inf)
        through = Gates(gates, np.array([-far, there - 1e-3]), np.array([far, there]))
        tube = Tube.damped((path[0], path[-1]), rate, around, h, through)
        assert not np.any(tube.empty)
        within, way = tube.within(), tube.integral(h)
        for row, k in itertools.product((0, 1), range(K)):
            part = path[k * fine : (k + 1) * fine + 1]
            assert within.low[row, k] <= part.min() + 1e-3
            assert part.max() <= within.high[row, k] + 1e-3
            mean = float(np.mean(part[:-1])) * h
            assert way.low[row, k] - 1e-3 * h <= mean <= way.high[row, k] + 1e-3 * h
        narrow = tube.at(gates[0])
        assert narrow.high[1] - narrow.low[1] <= 1e-3 + 1e-9
        assert narrow.low[0] < narrow.low[1] and narrow.high[0] > narrow.high[1]


@pytest.mark.parametrize("x", [0.0, 1.0])
def test_tubes_of_strong_drag_have_no_numbers_that_are_none(x: float) -> None:
    """Back in time it grows beyond all numbers, unless there is nothing to grow."""
    none, drag = np.zeros((1, 0)), np.full((1, 4), 1e6)
    rate = Interval(np.zeros((1, 4)), np.array([[0.0, 1.0, 0.0, 1.0]]))
    through = Gates((), none, none)
    tube = Tube.damped((x, x), rate, Interval(drag, drag), 1.0, through)
    for part in (*tube.onwards, *tube.back, tube.within(), tube.integral(1.0)):
        assert np.all(part.low <= part.high)


def test_only_bounds_that_are_near_are_told() -> None:
    bound = LowerBound(1.0, "so it is")
    assert bound.comparison(1.05) == "5.0 % above what none can beat"
    assert bound.comparison(1.0 - 1e-5) == "0.0 % above what none can beat"
    assert bound.comparison(1.95) == ""
    assert bound.comparison(math.inf) == ""
    assert LowerBound(0.0, "nothing").comparison(1.0) == ""
