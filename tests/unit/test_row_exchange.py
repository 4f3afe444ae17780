"""Row exchange: rows between the nodes join the running iteration without a restart."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_linear_programs import random_program, reference
from test_slp import Program, least_time

from tominpmp.linear_programs.choice import make_solver
from tominpmp.linear_programs.piqp import RESIDUAL, USUAL_TERMINATION, PiqpSolver
from tominpmp.options import Options
from tominpmp.solvers import loop as loops
from tominpmp.solvers.exchange import LEAST_RADIUS, SETTLED, RowExchange
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.loop import ITERATIONS, Loop
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.trust_region_step import GROWTH, trust_regions
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
    """The program with a row at the angle of the largest violation, or None."""
    worst = float(np.arctan2(z[1], z[0]))
    if np.hypot(z[0], z[1]) - z[2] < 1e-6:
        return None
    return shadow([*program.angles, worst]), z


def solve(exchange, **changes):
    options = Options(tolerance=1e-6, **changes)
    start = [2.0, 0.7, 2.5]
    return least_time(shadow([0.0, 1.5]), start, "highs", options, exchange=exchange)


def test_rows_join_until_no_row_is_violated():
    result = solve(RowExchange(revise=worst_angle))
    assert result.status is Status.CONVERGED
    assert result.best is not None
    assert result.best.duration == pytest.approx(2.0**0.5, rel=1e-4)
    assert result.program.rows.size > 3
    numbers = [record.iteration for record in result.history]
    assert numbers == list(range(len(numbers)))


def test_rows_do_not_change_without_row_exchange():
    result = solve(None)
    assert result.program.rows.size == 3
    assert result.best.duration < 1.4


def test_trust_region_radius_is_kept_when_rows_join():
    seen = []

    def revise(program, z):
        seen.append(len(seen))
        return worst_angle(program, z)

    result = solve(RowExchange(revise=revise))
    assert len(seen) >= 2
    radii = np.array([record.radius for record in result.history])
    durations = np.array([record.duration for record in result.history])
    # A restart would begin with the radius of a warm start each time: the radius
    # neither falls nor grows faster than by steps alone, except up to the least radius
    # that rows may need, and for motions whose duration has settled.
    change = radii[1:] / radii[:-1]
    moving = np.abs(np.diff(durations)) > SETTLED * durations[1:]
    # The radius of a record was limited before its step, by the steps before it.
    moving[1:] &= moving[:-1].copy()
    assert np.all(change[moving] > 0.3 - 1e-9)
    assert radii[-1] < LEAST_RADIUS
    assert np.all((change < GROWTH + 1e-9) | (radii[1:] <= GROWTH * LEAST_RADIUS))


@pytest.mark.parametrize(("last", "settled"), [(1.0, False), (2.0, True)])
def test_radius_shrinks_once_the_objective_has_settled(last, settled):
    """Where the duration is fixed, only the objective shows whether it has settled."""
    values = iter([2.0, last])
    objective = SimpleNamespace(value=lambda *_: next(values))
    program = shadow([0.0, 1.5])
    loop = Loop(program, objective, Iterate.of(program, np.array([2.0, 0.7, 2.5]), 1.0))
    exchange = RowExchange(revise=lambda program, z: (program, z))
    for _ in range(2):
        exchange, _ = exchange.join(loop, None)
    assert (exchange.radius < LEAST_RADIUS) == settled


def test_rows_that_join_bring_additional_iterations():
    few = solve(RowExchange(revise=worst_angle), max_iterations=7)
    assert few.best is not None
    assert few.best.duration == pytest.approx(2.0**0.5, rel=1e-2)
    assert 7 < len(few.history) <= 7 + 12 * ITERATIONS


def test_endless_row_exchange_ends_at_the_iteration_limit():
    def forever(program, z):
        return shadow([*program.angles, float(np.arctan2(z[1], z[0])) + 1e-3]), z

    result = solve(RowExchange(revise=forever), max_iterations=5)
    assert result.status is Status.ITERATION_LIMIT


def test_piqp_tries_hard_programs_with_refinement(monkeypatch):
    """Later changes of the bounds of a program are solved in the same way."""
    p, residuals = random_program(np.random.default_rng(2), rows=40, columns=30), []
    solver, known = PiqpSolver(), PiqpSolver._iterate

    def fails_without_refinement(self, most):
        settings = self._solver.settings
        residuals.append(settings.eps_abs)
        refined = settings.iterative_refinement_always_enabled
        return known(self, most if refined else 2)

    monkeypatch.setattr(PiqpSolver, "_iterate", fails_without_refinement)
    found = solver.solve(p)
    assert found.optimal and residuals == [USUAL_TERMINATION.residual, RESIDUAL]
    assert p.cost @ found.x == pytest.approx(reference(p).fun, abs=1e-6)
    wider = replace(p, row_lower=p.row_lower - 0.01, row_upper=p.row_upper + 0.01)
    again = solver.resolve(wider)
    assert again.optimal and residuals[2:] == [RESIDUAL]
    assert p.cost @ again.x <= p.cost @ found.x + 1e-9
    # The next program is tried without refinement again.
    solver.solve(p)
    assert residuals[3] == USUAL_TERMINATION.residual


def test_final_motion_is_inspected_between_its_rows():
    """Also at the iteration limit, a motion may need rows that are missing."""
    result = solve(RowExchange(revise=worst_angle), max_iterations=3)
    assert result.best is not None
    assert result.best.duration == pytest.approx(2.0**0.5, rel=1e-4)


def test_abandoned_motion_is_not_inspected_between_its_rows():
    looks = []

    def revise(program, z):
        looks.append(z)

    options = Options(max_iterations=3)
    step, usual = trust_regions(options, make_solver("highs"))
    rules = (usual, 1), (Loop.drop, 0), (lambda _: Status.TIME_LIMIT, 0)
    for rule, count in rules:
        looks.clear()
        given = shadow([0.0, 1.5]), MinimumTime.of(options), np.array([2.0, 0.7, 2.5])
        loops.solve(*given, step, rule, exchange=RowExchange(revise=revise))
        assert len(looks) >= count if count else not looks
