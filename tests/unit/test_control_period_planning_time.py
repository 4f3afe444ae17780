"""Planning with a control period takes little more time than planning without it.

Regression: an interior-point solver leaves the duration a trace above its bound, which
counted as another period, and was tried again and again.
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
from tominpmp.planner import candidate
from tominpmp.planner import control_period as clock
from tominpmp.planner.control_period import reaches_tick
from tominpmp.problem.segments import spans_of
from tominpmp.stopping import Stop
from tominpmp.transcription.curve import KnotVector, SplineMotion
from tominpmp.transcription.grid import ROUNDING, ticks_of
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.limit_violations import LimitViolation

# A small problem, solved fast.
QUICK: dict[str, Any] = {"control": "constant", "starts": 1, "intervals": 20}


def on_ticks(motion, period):
    """Whether all nodes of a motion are ticks of a clock."""
    ticks = motion.t / period
    return bool(np.all(np.abs(ticks - np.rint(ticks)) < 1e-9))


@pytest.fixture
def calls(monkeypatch):
    """Records the replayed motions, and the number of programs of the clock."""
    seen = SimpleNamespace(replayed=[], trials=0)
    original_verify, original_solve = candidate.verify, clock.solve

    def verify(problem, motion, *rest, **named):
        seen.replayed.append(motion)
        return original_verify(problem, motion, *rest, **named)

    def solve(*given, **named):
        seen.trials += 1
        return original_solve(*given, **named)

    monkeypatch.setattr(candidate, "verify", verify)
    monkeypatch.setattr(clock, "solve", solve)
    return seen


def with_violation(verification):
    """The verification with a violation of an effort limit."""
    fault = LimitViolation("effort", "joint1", 0.1, 1.0, "N m", 0.1, True)
    return replace(verification, ok=False, violations=(fault,))


def clocked_program(problem, motion, period):
    system = ProblemFunctions.of(problem).without_self_collision
    count = ticks_of(motion.duration, period) + 1
    layout = Layout.on_clock(motion, spans_of(motion, ()), period, [count], 0)
    program, z = layout.represented(system, motion)
    return replace(program, least_duration=float(layout.eta[0])), z


@pytest.mark.parametrize("control", ["constant", "linear", "spline"])
def test_trace_above_the_least_duration_is_not_another_period(planar3r, control):
    problem = planar_problem(planar3r)
    motion = tm.plan(problem, control=control, starts=1, intervals=20).trajectory
    program, z = clocked_program(problem, motion, 0.01)
    T = program.least_duration
    exact = np.append(z[:-1], T)
    for share in (-0.5 * ROUNDING, 1e-9, 1e-7, 0.9 * ROUNDING):
        off = np.append(z[:-1], T * (1.0 + share))
        timed = program.timed(off)
        assert timed[-1] == T
        np.testing.assert_array_equal(timed[:-1], off[:-1])
        # Constraints are evaluated with the duration on the clock.
        np.testing.assert_array_equal(program.evaluate(off), program.evaluate(exact))
    for share in (1.1 * ROUNDING, 1e-3):
        off = np.append(z[:-1], T * (1.0 + share))
        assert program.timed(off) is off
        assert np.any(program.evaluate(off) != program.evaluate(exact))


def ended(*iterations):
    """The status with which the rule ends iterations, or None.

    An iteration is its duration, its violation and its predicted gain.
    """
    history = [
        record(1, duration=T, violation=v, objective=T, predicted=p, actual=p)
        for T, v, p in iterations
    ]
    return reaches_tick(1.0, 1e-6)(SimpleNamespace(history=history))


def test_iterations_end_a_trace_above_the_last_tick():
    assert ended((1.0 + 1e-8, 0.0, 1.0)) is tm.Status.FEASIBLE
    assert ended((1.0 + 1e-8, 1e-3, 1.0)) is None
    assert ended((1.0 + 1e-4, 0.0, 1.0)) is None


def test_iterations_end_where_the_duration_stays_above_the_tick():
    """A smaller violation is no progress of the duration."""
    first = (1.005, 5e-3, 10.0)
    assert ended(first) is None
    assert ended(first, (1.0051, 1e-6, 0.1)) is tm.Status.STALLED
    falling = (1.003, 1e-3, 1.0)
    assert ended(first, falling) is None
    assert ended(first, falling, (1.003, 0.5, 1.0)) is None  # far from feasible
    assert ended(first, falling, (1.003, 1e-3, 1.0)) is tm.Status.STALLED


@pytest.mark.parametrize("period", [0.001, 0.004, 0.008])
def test_clock_takes_one_replay_and_few_programs(ur5, calls, period):
    problem, few = ur5_problem(ur5, motion_limits=LIMITS), {"intervals": 20}
    solution = tm.plan(problem, control_period=period, **few)
    assert solution.success and solution.verification.ok
    assert sum(on_ticks(motion, period) for motion in calls.replayed) == 1
    assert calls.trials <= 2
    records = [item for item in solution.history if item.programs]
    free = tm.plan(problem, **few)
    assert len(records) - len(free.history) <= 4
    assert solution.T <= ticks_of(free.T, period) * period + period * 1.001


def test_motion_off_the_clock_has_been_replayed(planar3r, monkeypatch):
    """Without a motion on the clock, the returned motion off the clock is verified."""
    monkeypatch.setattr(clock, "TRIALS", 1)
    less = lambda T, period: int(0.8 * T / period)  # noqa: E731
    monkeypatch.setattr(clock, "ticks_of", less)
    solution = tm.plan(planar_problem(planar3r), control_period=0.01, **QUICK)
    assert not solution.success
    assert solution.verification is not None and solution.verification.ok
    assert "keeps all else" in solution.message


def test_failed_replays_on_the_clock_keep_the_verified_motion(planar3r, monkeypatch):
    """The returned motion off the clock is verified."""
    original_verify = candidate.verify

    def verify(problem, motion, *rest, **named):
        found = original_verify(problem, motion, *rest, **named)
        return with_violation(found) if on_ticks(motion, 0.01) else found

    monkeypatch.setattr(clock, "TRIALS", 2)
    monkeypatch.setattr(candidate, "verify", verify)
    solution = tm.plan(planar_problem(planar3r), control_period=0.01, **QUICK)
    assert not solution.success
    assert solution.status is tm.Status.UNVERIFIED
    assert solution.verification.ok
    assert "keeps all else" in solution.message


def test_warm_start_on_the_clock_is_kept_if_the_time_is_used_up(planar3r, monkeypatch):
    """It solved the problem, and a motion off the clock was no solution."""

    def late(*given, **named):
        raise Stop(requested=False)

    problem = planar_problem(planar3r)
    former = tm.plan(problem, control_period=0.01, **QUICK)
    monkeypatch.setattr(clock, "solve", late)
    solution = tm.plan(problem, start=former, control_period=0.01, **QUICK)
    assert solution.success and solution.T == former.T, solution.message
    assert on_ticks(solution.trajectory, 0.01) and solution.verification.ok
    # It is no solution for another clock, nor beyond lower limits.
    slow = planar_problem(planar3r, motion_limits=tm.MotionLimits(effort_scale=0.6))
    for other, period in ((problem, 0.011), (slow, 0.01)):
        assert not tm.plan(other, start=former, control_period=period, **QUICK).success


@pytest.mark.parametrize("degree", [3, 5])
def test_derivatives_of_a_spline_basis_do_not_depend_on_former_calls(degree):
    nodes = np.array([0.0, 0.1, 0.35, 0.5, 0.9, 1.0])
    points = np.random.default_rng(3).normal(size=(nodes.size + degree - 1, 2))
    times, step, h = np.array([0.05, 0.2, 0.42, 0.7, 0.95]), 1e-6, np.diff(nodes)
    first, again = KnotVector(h, degree), KnotVector(h, degree)
    interval = np.searchsorted(nodes, times) - 1
    mine = points[interval[:, None] + np.arange(degree + 1)]
    near = np.zeros((len(points), 1), dtype=np.int64)
    motion = SplineMotion(points, np.zeros(2), np.ones(1), h[:, None], first, near)

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
