"""Solvers of linear programs agree with SciPy and with solutions by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import linprog

from tominpmp.exceptions import SolverNotFound
from tominpmp.linear_programs import piqp as piqp_module
from tominpmp.linear_programs.choice import available_solvers, make_solver
from tominpmp.linear_programs.piqp import PIQP_ITERATIONS, PiqpSolver, Termination
from tominpmp.linear_programs.program import LinearProgram
from tominpmp.stopping import bounded

SOLVERS = ["highs", "piqp", "clarabel"]


def program(cost, matrix, row_lower, row_upper, lower, upper):
    matrix = sp.csc_matrix(np.atleast_2d(np.array(matrix, dtype=float)))
    arrays = [
        np.array(part, dtype=float) for part in (row_lower, row_upper, lower, upper)
    ]
    return LinearProgram(matrix, np.array(cost, dtype=float), *arrays[2:], *arrays[:2])


def random_program(rng, rows=12, columns=8):
    matrix = rng.normal(size=(rows, columns))
    center = matrix @ rng.uniform(-0.5, 0.5, columns)
    lower, upper = (
        center - rng.uniform(0.1, 1, rows),
        center + rng.uniform(0.1, 1, rows),
    )
    lower[:3], upper[3:5] = -np.inf, np.inf
    lower[6] = upper[6] = center[6]
    ones = np.ones(columns)
    return program(rng.normal(size=columns), matrix, lower, upper, -ones, ones)


def reference(p):
    rows = p.matrix.toarray()
    equal = p.row_lower == p.row_upper
    high, low = ~equal & np.isfinite(p.row_upper), ~equal & np.isfinite(p.row_lower)
    return linprog(
        p.cost,
        np.vstack([rows[high], -rows[low]]),
        np.concatenate([p.row_upper[high], -p.row_lower[low]]),
        rows[equal],
        p.row_upper[equal],
        list(zip(p.lower, p.upper, strict=True)),
    )


def installed(name):
    if name not in available_solvers():
        pytest.skip(f"the optional solver {name} is not installed")
    return make_solver(name)


@pytest.mark.parametrize("name", SOLVERS)
def test_duals_are_sensitivities_to_the_active_bound(name):
    # min -x - 2y, x + y <= 3, x - y >= -1, x, y in [0, 10]: optimum at (1, 2).
    p = program(
        [-1, -2], [[1, 1], [1, -1]], [-np.inf, -1], [3, np.inf], [0, 0], [10, 10]
    )
    solution = installed(name).solve(p)
    assert solution.optimal
    np.testing.assert_allclose(solution.x, [1, 2], atol=1e-5)
    # d cost / d bound = -dual at an upper bound; the lower bound has a negative dual.
    np.testing.assert_allclose(solution.row_duals, [1.5, -0.5], atol=1e-4)


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("seed", range(5))
def test_solvers_agree_with_scipy(name, seed):
    p = random_program(np.random.default_rng(seed))
    expected = reference(p)
    solution = installed(name).solve(p)
    assert solution.optimal == (expected.status == 0)
    if solution.optimal:
        assert p.cost @ solution.x == pytest.approx(expected.fun, abs=1e-5)
        rows = p.matrix @ solution.x
        assert np.all(rows <= p.row_upper + 1e-6)
        assert np.all(rows >= p.row_lower - 1e-6)


@pytest.mark.parametrize("name", SOLVERS)
def test_resolving_equals_solving_afresh(name):
    rng = np.random.default_rng(7)
    p = random_program(rng)
    solver = installed(name)
    assert solver.solve(p).optimal
    shift = 0.02 * rng.normal(size=p.row_lower.size)
    fresh = replace(p, row_lower=p.row_lower + shift, row_upper=p.row_upper + shift)
    again = solver.resolve(fresh)
    assert again.optimal
    assert p.cost @ again.x == pytest.approx(reference(fresh).fun, abs=1e-5)


def test_highs_starts_from_the_last_basis():
    rng = np.random.default_rng(3)
    p = random_program(rng, rows=60, columns=40)
    solver = make_solver("highs")
    first, second = solver.solve(p), solver.solve(p)
    assert first.iterations > 5
    assert second.iterations == 0


def test_highs_solves_a_program_that_its_last_basis_does_not_fit():
    rng = np.random.default_rng(4)
    solver = make_solver("highs")
    for rows, columns in ((60, 40), (59, 40), (59, 41)):
        p = random_program(rng, rows, columns)
        found = solver.solve(p)
        assert found.optimal
        assert p.cost @ found.x == pytest.approx(reference(p).fun, abs=1e-7)


@pytest.mark.parametrize("name", ["highs", "piqp"])
def test_infeasible_program_is_not_reported_as_optimal(name):
    p = program([1.0], [[1.0], [1.0]], [2.0, -np.inf], [np.inf, 1.0], [-5], [5])
    assert not make_solver(name).solve(p).optimal


def test_error_on_an_unknown_solver_lists_the_known_solvers():
    with pytest.raises(SolverNotFound) as caught:
        make_solver("simplicissimus")
    assert caught.value.name == "simplicissimus"
    assert "highs" in caught.value.available


def test_highs_solves_large_programs_by_interior_points_first(monkeypatch):
    """A crossover yields the basis from which the simplex method starts afterwards."""
    monkeypatch.setattr("tominpmp.linear_programs.highs.MANY", 90)
    p = random_program(np.random.default_rng(5), rows=60, columns=40)
    solver = make_solver("highs")
    first = solver.solve(p)
    assert first.optimal
    assert first.iterations == 0
    assert p.cost @ first.x == pytest.approx(reference(p).fun, abs=1e-7)
    slope = p.cost + p.matrix.T @ first.row_duals
    inside = (first.x > p.lower + 1e-7) & (first.x < p.upper - 1e-7)
    np.testing.assert_allclose(slope[inside], 0.0, atol=1e-7)
    shift = np.random.default_rng(8).normal(scale=0.05, size=60)
    shifted = replace(p, row_lower=p.row_lower + shift, row_upper=p.row_upper + shift)
    again = solver.resolve(shifted)
    cold = make_solver("piqp").solve(shifted)
    assert again.optimal
    assert 0 < again.iterations < 40
    assert p.cost @ again.x == pytest.approx(p.cost @ cold.x, abs=1e-5)


@pytest.mark.parametrize("curvature", [None, 1e-3])
@pytest.mark.parametrize(("rows", "columns"), [(60, 40), (90, 10)])
def test_piqp_leaves_no_large_program_to_the_simplex_method(
    monkeypatch, rows, columns, curvature
):
    """Regression: one step of a Panda on a finer grid took 4 to 17 s of pivots, and one
    of a TALOS with 5362 rows and 555 columns 50 s.
    """
    p = random_program(np.random.default_rng(6), rows=rows, columns=columns)
    if curvature is not None:
        p = replace(p, curvature=curvature * sp.identity(columns, format="csc"))
    unfinished = Termination(iterations=3)
    assert PiqpSolver(unfinished).solve(p).optimal  # after few pivots
    monkeypatch.setattr(piqp_module, "MANY", 90)
    assert not PiqpSolver(unfinished).solve(p).optimal


def test_piqp_accepts_a_gap_of_a_share_of_the_objective():
    p = random_program(np.random.default_rng(6), rows=60, columns=40)
    best = reference(p).fun
    needed = PiqpSolver().solve(p).iterations
    few = Termination(gap=1e-9, iterations=needed - 1)
    exact = PiqpSolver(few).solve(p)
    assert exact.iterations > few.iterations  # left to the simplex method
    assert p.cost @ exact.x == pytest.approx(best, abs=1e-7)
    rough = PiqpSolver(replace(few, share=0.9)).solve(p)
    assert rough.optimal
    assert rough.iterations == few.iterations
    assert abs(p.cost @ rough.x - best) < 0.9 * abs(best)


def test_staged_factorisation_gives_the_same_solution(
    monkeypatch,
):
    rng = np.random.default_rng(3)
    columns = 60
    near = sum(sp.diags(rng.normal(size=columns), k, (60, 60)) for k in range(3))
    wide = 0.1 * np.ones(columns)
    flat = program(
        rng.normal(size=columns),
        near.toarray(),
        -np.ones(60),
        np.ones(60),
        -wide,
        wide,
    )
    curved = replace(flat, curvature=sp.identity(columns, format="csc"))
    full = replace(curved, matrix=sp.csc_matrix(np.ones((60, 60))))
    staged, usual = piqp_module.STAGED, piqp_module.piqp.KKTSolver.sparse_ldlt
    choose = piqp_module.factorisation
    assert choose(curved, False) in (staged, usual)  # not all builds have it
    assert {choose(p, False) for p in (flat, full)} == {usual}
    assert choose(curved, True) == usual
    one = PiqpSolver().solve(curved)
    monkeypatch.setattr(piqp_module, "factorisation", lambda *_: usual)
    other = PiqpSolver().solve(curved)
    assert one.optimal and one.iterations == other.iterations
    np.testing.assert_allclose(one.x, other.x, atol=1e-9)
    np.testing.assert_allclose(one.row_duals, other.row_duals, atol=1e-9)


@pytest.mark.parametrize("largest", [1e6, 1e9, 1e10])
def test_curved_programs_of_huge_coefficients_are_solved_by_piqp(largest):
    """Third differences over short intervals: staged, PIQP yields NaN from 1e9 on."""
    rng, columns = np.random.default_rng(0), 60
    rows = columns - 3
    jerks = sp.diags([1.0, -3.0, 3.0, -1.0], range(4), (rows, columns))
    sizes = rng.permutation(np.geomspace(1e3, largest, rows))
    places = sp.diags(rng.normal(size=columns))
    matrix = sp.vstack([sp.diags(sizes) @ jerks, places, places]).toarray()
    ones, wide = np.ones(len(matrix)), 1e-3 * np.ones(columns)
    cost = rng.normal(size=columns)
    flat = program(cost, matrix, -ones, ones, -wide, wide)
    curved = replace(flat, curvature=2e-4 * sp.identity(columns, format="csc"))
    solver = PiqpSolver()
    found = solver.solve(curved)
    assert found.optimal
    assert found.curved  # the simplex method leaves the curvature out
    exact = make_solver("highs").solve(flat)
    assert cost @ found.x == pytest.approx(cost @ exact.x, abs=1e-4)
    # Later programs do not try the staged factorisation again.
    begun = found.iterations
    lower, upper = 0.9 * flat.row_lower, 0.9 * flat.row_upper
    again = solver.resolve(replace(curved, row_lower=lower, row_upper=upper))
    assert again.optimal and again.iterations <= begun
    assert solver.solve(curved).iterations < 60


def test_matrices_with_unsorted_indices_are_solved():
    """Products of sparse matrices are unsorted; PIQP itself may end the process."""
    rng = np.random.default_rng(1)
    root = sp.random(80, 60, 0.1, format="csr", random_state=rng)
    product = sp.csc_matrix(root.T @ root)
    assert not product.has_sorted_indices
    ones, cost = np.ones(60), rng.normal(size=60)
    whole = program(cost, product.toarray(), -ones, ones, -ones, ones)
    ordered = replace(whole, curvature=product.sorted_indices())
    mixed = replace(whole, matrix=product, curvature=product.copy())
    one, other = (PiqpSolver().solve(p) for p in (ordered, mixed))
    assert one.optimal and one.iterations == other.iterations
    np.testing.assert_array_equal(one.x, other.x)


def test_piqp_iterations_are_limited_by_the_time_of_an_iteration(clock, monkeypatch):
    """The time of the set-up of the first program is no measure of an iteration."""
    limits = []

    class Slow(piqp_module.piqp.SparseSolver):
        def setup(self, *parts):
            clock.advance(30.0)
            super().setup(*parts)

        def solve(self):
            limits.append(self.settings.max_iter)
            status = super().solve()
            clock.advance(self.result.info.iter)
            return status

    monkeypatch.setattr(piqp_module.piqp, "SparseSolver", Slow)
    p = random_program(np.random.default_rng(0))
    solver = PiqpSolver()
    with bounded(90.0):
        spent = solver.solve(p).iterations
        solver.resolve(p)
    assert limits == [1, 59, 59 - spent]


def test_feasible_program_of_a_panda_is_not_called_infeasible():
    """Regression: PIQP 0.7 took its last steps for a proof of infeasibility.

    The program, the first of a plan with jerks of 1000 rad/s^3, was then left to 1094
    pivots of the simplex method.
    """
    with np.load(Path(__file__).parent / "panda_jerk_program.npz") as kept:
        parts = {name: kept[name].astype(float) for name in kept.files}
    columns = tuple(parts.pop(name) for name in ("data", "indices", "indptr"))
    matrix = sp.csc_matrix(columns, shape=parts.pop("shape").astype(int))
    p = LinearProgram(matrix=matrix, **parts)
    exact, found = make_solver("highs").solve(p), make_solver("piqp").solve(p)
    assert found.optimal
    assert found.iterations <= PIQP_ITERATIONS
    assert p.cost @ found.x == pytest.approx(p.cost @ exact.x, abs=2e-5)
    at = matrix @ found.x
    assert np.all(at <= p.row_upper + 1e-6) and np.all(at >= p.row_lower - 1e-6)
