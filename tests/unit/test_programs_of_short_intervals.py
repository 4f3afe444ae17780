"""Linear programs of short intervals: PIQP copes with coefficients of 1e10."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from tominpmp.linear_programs.highs import HighsSolver
from tominpmp.linear_programs.piqp import (
    PIQP_ITERATIONS,
    PiqpSolver,
    Termination,
    equation_scale,
)
from tominpmp.linear_programs.program import LinearProgram


def second_differences(sharpest: float) -> LinearProgram:
    """The steepest descent of points whose second differences have a cost."""
    n = 40
    rng = np.random.default_rng(0)
    scale = np.geomspace(sharpest, 1.0, n - 2)
    bend = sp.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n))
    eye = sp.identity(n - 2)
    matrix = sp.hstack([sp.diags(scale) @ bend, -eye, eye], format="csc")
    return LinearProgram(
        matrix,
        np.concatenate([rng.normal(size=n), np.full(2 * (n - 2), 1e-4)]),
        np.concatenate([np.full(n, -0.05), np.zeros(2 * (n - 2))]),
        np.concatenate([np.full(n, 0.05), np.full(2 * (n - 2), np.inf)]),
        np.zeros(n - 2),
        np.zeros(n - 2),
    )


def test_piqp_solves_huge_coefficients_without_the_simplex_method(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def never(self: HighsSolver, program: LinearProgram) -> None:
        raise AssertionError("left to the simplex method")

    program = second_differences(1e10)
    exact = HighsSolver().solve(second_differences(1e10))
    monkeypatch.setattr(HighsSolver, "solve", never)
    solver = PiqpSolver()
    found = solver.solve(program)
    assert found.optimal
    assert found.iterations < PIQP_ITERATIONS
    assert program.cost @ found.x == pytest.approx(program.cost @ exact.x, abs=1e-4)
    again = solver.resolve(program)
    assert program.cost @ again.x == pytest.approx(program.cost @ found.x, abs=1e-5)


def test_duals_refer_to_the_unscaled_equations() -> None:
    matrix = sp.csc_matrix(np.array([[1e6, 0.0], [1.0, 1.0]]))
    program = LinearProgram(
        matrix,
        np.array([1.0, 2.0]),
        np.full(2, -10.0),
        np.full(2, 10.0),
        np.array([2e6, 3.0]),
        np.array([2e6, 3.0]),
    )
    exact = HighsSolver().solve(program)
    found = PiqpSolver().solve(program)
    assert found.x == pytest.approx([2.0, 1.0], abs=1e-5)
    assert found.row_duals == pytest.approx(exact.row_duals, rel=1e-3)


def test_stored_zeros_of_equations_do_not_change_the_solution() -> None:
    """Regression: with stored zeros, rounding errors led to other motions."""
    plain = second_differences(1e5)
    entries, (rows, columns) = plain.matrix.tocoo(), plain.matrix.shape
    rng = np.random.default_rng(1)
    more = rng.integers(0, rows, 200), rng.integers(0, columns, 200)
    places = (np.append(entries.row, more[0]), np.append(entries.col, more[1]))
    stored = sp.csc_matrix((np.append(entries.data, np.zeros(200)), places))
    assert stored.nnz > plain.matrix.nnz
    found = PiqpSolver().solve(replace(plain, matrix=stored))
    np.testing.assert_array_equal(found.x, PiqpSolver().solve(plain).x)


def test_equation_scale_makes_coefficients_one_at_most() -> None:
    matrix = sp.csr_matrix(np.array([[1e10, -2.0], [0.5, 0.1]]))
    assert equation_scale(matrix) == pytest.approx([1e-10, 1.0])
    assert equation_scale(matrix[:0]).shape == (0,)


def overlapping_limits() -> LinearProgram:
    """Steep rows, each of which occurs three times: multipliers are not unique."""
    rng = np.random.default_rng(0)
    rows = 1e5 * np.tile(rng.normal(size=(60, 30)), (3, 1))
    return LinearProgram(
        sp.csc_matrix(rows),
        rng.normal(size=30),
        np.full(30, -1.0),
        np.ones(30),
        np.full(180, -np.inf),
        np.ones(180),
    )


def test_termination_does_not_wait_for_exact_multipliers() -> None:
    program = overlapping_limits()
    found, exact = (
        PiqpSolver(n).solve(program)
        for n in (Termination(), Termination(residual=1e-9))
    )
    assert found.iterations < exact.iterations
    assert program.cost @ found.x == pytest.approx(program.cost @ exact.x, abs=1e-6)
    assert np.all(program.matrix @ found.x <= 1.0 + 1e-6)


def test_program_is_solved_again_if_its_rows_are_not_kept_closely(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    program = second_differences(1e2)
    once = PiqpSolver().solve(program)
    monkeypatch.setattr("tominpmp.linear_programs.piqp.NEARLY_ROWS", 0.0)
    again = PiqpSolver().solve(program)
    assert again.iterations >= 2 * once.iterations
    assert program.cost @ again.x == pytest.approx(program.cost @ once.x, abs=1e-6)
