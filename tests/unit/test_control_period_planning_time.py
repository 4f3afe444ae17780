"""Planning for a controller's clock takes little more than planning without one.

An interior-point solver leaves the duration a trace above its bound: that was taken for
another period, and tried again and again.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from clock_samples import LIMITS, planar_problem, ur5_problem
from record_samples import record
from scipy.interpolate import BSpline

import tominpmp as tm
from tominpmp.initial_guess.warm_start import warm_start
from tominpmp.planner import candidate as attempts
from tominpmp.planner import control_period as clock
from tominpmp.planner import control_period_segments
from tominpmp.planner.control_period import ClockCallback
from tominpmp.stopping import Deadline
from tominpmp.transcription.curve import KnotVector, SplineMotion
from tominpmp.transcription.grid import Ticks, ticks_of
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import TRACE
from tominpmp.verification.limit_violations import LimitViolation

# A small problem, solved fast.
QUICK: dict[str, Any] = {"control": "constant", "starts": 1, "intervals": 20}


@pytest.fixture
def calls(monkeypatch):
    """Replays of the search and of the clock, and programs of the clock, counted."""
    seen = SimpleNamespace(search=0, clock=0, tries=0)

    def counted(name, function):
        def count(*given, **named):
            setattr(seen, name, getattr(seen, name) + 1)
            return function(*given, **named)

        return count

    monkeypatch.setattr(attempts, "verify", counted("search", attempts.verify))
    monkeypatch.setattr(clock, "verify", counted("clock", clock.verify))
    monkeypatch.setattr(clock, "_solve", counted("tries", clock._solve))
    return seen


def not_right(verification):
    """A verdict that finds fault with a motion."""
    fault = LimitViolation("effort", "joint1", 0.1, 1.0, "N m", 0.1, True)
    return replace(verification, ok=False, violations=(fault,))


def clocked_program(problem, trajectory, period):
    system = ProblemFunctions.of(problem).without_self_collision
    count = ticks_of(trajectory.duration, period) + 1
    ticks = Ticks.near(period, count, trajectory.t, trajectory.t.size - 1)
    return warm_start(system, trajectory).clocked_program(system, ticks)


@pytest.mark.parametrize("control", ["constant", "linear", "spline"])
def test_a_trace_of_time_is_no_period(planar3r, control):
    problem = planar_problem(planar3r)
    motion = tm.plan(problem, control=control, starts=1, intervals=20).trajectory
    program, z = clocked_program(problem, motion, 0.01)
    T = program.least_duration
    exact = np.append(z[:-1], T)
    for share in (-0.5 * TRACE, 1e-9, 1e-7, 0.9 * TRACE):
        off = np.append(z[:-1], T * (1.0 + share))
        kept = program.timed(off)
        assert kept[-1] == T
        np.testing.assert_array_equal(kept[:-1], off[:-1])
        # Constraints are judged in the time that there will be.
        np.testing.assert_array_equal(program.evaluate(off), program.evaluate(exact))
    for share in (1.1 * TRACE, 1e-3):
        off = np.append(z[:-1], T * (1.0 + share))
        assert program.timed(off) is off
        assert np.any(program.evaluate(off) != program.evaluate(exact))


def told(duration, violation, predicted):
    numbers = {"objective": duration, "predicted": predicted, "actual": predicted}
    return record(1, duration=duration, violation=violation, **numbers)


def callback():
    progress = SimpleNamespace(start=0, seconds=0.0)
    return ClockCallback(tm.Options(), progress, Deadline(), goal=1.0)


def test_the_iteration_ends_at_the_goal_but_for_a_trace():
    assert callback()(told(1.0 + 1e-8, 0.0, 1.0)) is tm.Status.FEASIBLE
    assert callback()(told(1.0 + 1e-8, 1e-3, 1.0)) is None
    assert callback()(told(1.0 + 1e-4, 0.0, 1.0)) is None


def test_the_iteration_ends_where_the_duration_stays_above():
    """Removing what violates limits is no progress of the duration."""
    see = callback()
    assert see(told(1.005, 5e-3, 10.0)) is None
    assert see(told(1.0051, 1e-6, 0.1)) is tm.Status.STALLED
    see = callback()
    assert see(told(1.005, 5e-3, 10.0)) is None
    assert see(told(1.003, 1e-3, 1.0)) is None  # it still falls
    assert see(told(1.003, 0.5, 1.0)) is None  # and may be far from admissible


@pytest.mark.parametrize("period", [0.001, 0.004, 0.008])
def test_one_replay_on_the_clock_and_few_programs(ur5, calls, period):
    problem, few = ur5_problem(ur5, motion_limits=LIMITS), {"intervals": 20}
    solution = tm.plan(problem, control_period=period, **few)
    assert solution.success and solution.verification.ok
    assert calls.clock == 1
    assert calls.tries <= 2
    records = [item for item in solution.history if item.programs]
    free = tm.plan(problem, **few)
    assert len(records) - len(free.history) <= 4
    assert solution.T <= ticks_of(free.T, period) * period + period * 1.001


def test_a_motion_off_the_clock_is_one_that_was_replayed(planar3r, monkeypatch):
    """Where none on the clock is found, what is kept is known to hold."""
    monkeypatch.setattr(clock, "TRIES", 1)
    less = lambda T, period: int(0.8 * T / period)  # noqa: E731
    monkeypatch.setattr(control_period_segments, "ticks_of", less)
    solution = tm.plan(planar_problem(planar3r), control_period=0.01, **QUICK)
    assert not solution.success
    assert solution.verification is not None and solution.verification.ok
    assert "keeps all else" in solution.message


def test_nothing_on_the_clock_is_right_though_the_motion_is(planar3r, monkeypatch):
    """What is kept was replayed."""
    judged = clock.verify

    def verify(problem, motion, *rest, **named):
        found = judged(problem, motion, *rest, **named)
        ticks = motion.t / 0.01
        on_clock = np.all(np.abs(ticks - np.rint(ticks)) < 1e-9)
        return not_right(found) if on_clock else found

    monkeypatch.setattr(clock, "TRIES", 2)
    monkeypatch.setattr(clock, "verify", verify)
    solution = tm.plan(planar_problem(planar3r), control_period=0.01, **QUICK)
    assert not solution.success
    assert solution.status is tm.Status.UNVERIFIED
    assert solution.verification.ok
    assert "keeps all else" in solution.message


@pytest.mark.parametrize("degree", [3, 5])
def test_derivatives_of_a_basis_are_the_same_however_often_asked(degree):
    nodes = np.array([0.0, 0.1, 0.35, 0.5, 0.9, 1.0])
    points = np.random.default_rng(3).normal(size=(nodes.size + degree - 1, 2))
    times, step, h = np.array([0.05, 0.2, 0.42, 0.7, 0.95]), 1e-6, np.diff(nodes)
    first, again = KnotVector(h, degree), KnotVector(h, degree)
    interval = np.searchsorted(nodes, times) - 1
    mine = points[interval[:, None] + np.arange(degree + 1)]
    motion = SplineMotion(points, np.zeros(2), np.ones(1), h[:, None], first)

    def at(knots, times, order):
        weights = knots.weights(Instants.at_times(times, h), order)
        return np.einsum("mk,mkn->mn", weights, mine)

    for order in (3, 1, 2):
        found = at(first, times, order)
        before = at(again, times - step, order - 1)
        after = at(again, times + step, order - 1)
        slope = (after - before) / (2.0 * step)
        np.testing.assert_allclose(found, slope, rtol=1e-5, atol=1e-4)
        np.testing.assert_array_equal(found, at(first, times, order))
        control, knots = motion.derivative(order), first.knots
        curve = BSpline(knots[order:-order], control, degree - order)
        np.testing.assert_allclose(found, curve(times), rtol=1e-9, atol=1e-9)
