"""Rows between the nodes join the running iteration; nothing restarts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import piqp
import pytest
from test_linear_programs import random_program, reference
from test_slp import Program

import tominpmp as tm
from tominpmp.linear_programs import USUALLY, Nearly, PiqpSolver, make_solver
from tominpmp.options import Options
from tominpmp.solvers.exchange import ITERATIONS, LEAST_RADIUS, RowExchange
from tominpmp.solvers.slp import SlpSolver
from tominpmp.solvers.trust_region import GROWTH
from tominpmp.status import Status


def shadow(angles):
    """Least t with x cos(angle) + y sin(angle) <= t for some angles, x y >= 1.

    For all angles t is the length of (x, y), at least 2 ** 0.5 at x = y = 1.
    """
    angles = np.array(angles)
    count = angles.size
    low, high = np.full(count + 1, -np.inf), np.zeros(count + 1)
    low[-1], high[-1] = 1.0, np.inf
    groups = np.append(np.zeros(count), 1).astype(int)

    def values(z):
        x, y, t = z
        return [*(x * np.cos(angles) + y * np.sin(angles) - t), x * y]

    def jacobian(z):
        rows = np.column_stack([np.cos(angles), np.sin(angles), np.full(count, -1.0)])
        return np.vstack([rows, [z[1], z[0], 0.0]])

    program = Program(
        [("torque", low, high, groups)], values, jacobian, [0.0] * 3, [9.0] * 3
    )
    program.angles = angles
    return program


def worst_angle(program, z):
    """The program with the angle at which the iterate breaks it."""
    worst = float(np.arctan2(z[1], z[0]))
    if np.hypot(z[0], z[1]) - z[2] < 1e-6:
        return None
    return shadow([*program.angles, worst]), z


def solve(exchange, **changes):
    options = Options(tolerance=1e-6, **changes)
    solver = SlpSolver(shadow([0.0, 1.5]), options, 0.0, make_solver("highs"))
    return replace(solver, exchange=exchange).run(np.array([2.0, 0.7, 2.5]))


def test_rows_join_until_none_is_missing():
    result = solve(RowExchange(revise=worst_angle))
    assert result.status is Status.CONVERGED
    assert result.best is not None
    assert result.best.duration == pytest.approx(2.0**0.5, rel=1e-4)
    assert result.program.rows.size > 3
    numbers = [record.iteration for record in result.history]
    assert numbers == list(range(len(numbers)))


def test_without_exchange_the_rows_are_as_they_were():
    result = solve(None)
    assert result.program.rows.size == 3
    assert result.best.duration < 1.4


def test_trust_region_goes_on():
    seen = []

    def revise(program, z):
        seen.append(len(seen))
        return worst_angle(program, z)

    result = solve(RowExchange(revise=revise))
    assert len(seen) >= 2
    radii = np.array([record.radius for record in result.history])
    # A restart would begin with the radius of a warm start each time: it neither falls
    # nor grows faster than steps alone make it, but for the least that rows may need.
    change = radii[1:] / radii[:-1]
    assert np.all(change > 0.3 - 1e-9)
    assert np.all((change < GROWTH + 1e-9) | (radii[1:] <= GROWTH * LEAST_RADIUS))


def test_rows_are_looked_for_again_once_those_that_joined_are_done():
    exchange = RowExchange(revise=worst_angle)
    iterate = at_rest([1.0, 1.0, 2.0**0.5])
    still = replace(exchange, level=0.0)
    assert not still.due(iterate, None)
    done, _ = still.extended(iterate, 10, 5)
    assert done.due(iterate, None)
    assert not done.looked.due(iterate, None)
    moved = at_rest([1.2, 1.2, 1.2 * 2.0**0.5])
    assert not done.due(moved, None)
    broken = at_rest([1.1, 1.0, 2.0**0.5])
    assert not done.due(broken, None)


def at_rest(z):
    """An iterate whose merit has not changed lately."""
    program = shadow([0.0, np.pi / 4])
    solver = SlpSolver(program, Options(), 0.0, make_solver("highs"))
    return replace(solver.init(np.array(z)), gains=(1e-9,))


def test_rows_that_join_bring_iterations_of_their_own():
    few = solve(RowExchange(revise=worst_angle), max_iterations=7)
    assert few.best is not None
    assert few.best.duration == pytest.approx(2.0**0.5, rel=1e-2)
    assert 7 < len(few.history) <= 7 + 12 * ITERATIONS


def test_rows_that_never_end_are_a_limit_that_is_said():
    def forever(program, z):
        return shadow([*program.angles, float(np.arctan2(z[1], z[0])) + 1e-3]), z

    result = solve(RowExchange(revise=forever), max_iterations=5)
    assert result.status is Status.ITERATION_LIMIT


def test_programs_that_are_hard_for_interior_points_go_to_the_simplex_method(
    monkeypatch,
):
    p = random_program(np.random.default_rng(2), rows=40, columns=30)
    solver = PiqpSolver(Nearly(iterations=2))
    found = solver.solve(p)
    assert found.optimal
    assert p.cost @ found.x == pytest.approx(reference(p).fun, abs=1e-7)
    again = solver.resolve(p.row_lower - 0.01, p.row_upper + 0.01)
    assert again.optimal
    assert p.cost @ again.x <= p.cost @ found.x + 1e-9
    # The next program is tried by interior points again.
    monkeypatch.setattr(solver, "_nearly", USUALLY)
    assert solver.solve(p).iterations < 60
    assert piqp.PIQP_SOLVED == solver._solver.result.info.status


def test_a_plan_needs_no_round_of_its_own_for_rows_between_the_nodes(monkeypatch):
    rounds, usual = [], SlpSolver.run

    def run(self, z, *, after=None):
        if self.exchange is not None:  # others are judged by certificates
            rounds.append(after is not None)
        return usual(self, z, after=after)

    monkeypatch.setattr(SlpSolver, "run", run)
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, [0.5, 0.4, 0.3], tm.JointGoal([2.0, -0.6, 0.4]))
    solution = tm.plan(problem, intervals=16, refine=None, effort="quick")
    assert solution.success, solution.message
    assert rounds
    assert sum(rounds) <= 1
