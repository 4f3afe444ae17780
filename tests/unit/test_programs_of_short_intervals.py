"""Linear programs of short intervals: coefficients of 1e10 are no reason to give up."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from tominpmp.arrays import equation_scale
from tominpmp.linear_programs import HighsSolver, PiqpSolver
from tominpmp.linear_programs.piqp import PIQP_ITERATIONS
from tominpmp.program_records import LinearProgram


def second_differences(sharpest: float) -> LinearProgram:
    """The steepest descent of points whose second differences cost something."""
    n = 40
    rng = np.random.default_rng(0)
    scale = np.geomspace(sharpest, 1.0, n - 2)
    bend = sp.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n))
    eye = sp.identity(n - 2)
    matrix = sp.hstack([sp.diags(scale) @ bend, -eye, eye], format="csc")
    count = 3 * n - 4
    return LinearProgram(
        np.concatenate([rng.normal(size=n), np.full(2 * (n - 2), 1e-4)]),
        matrix,
        np.zeros(n - 2),
        np.zeros(n - 2),
        np.concatenate([np.full(n, -0.05), np.zeros(2 * (n - 2))]),
        np.concatenate([np.full(n, 0.05), np.full(2 * (n - 2), np.inf)]),
        np.arange(n - 2),
        np.arange(count),
    )


def test_interior_points_solve_them_without_the_simplex_method(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def never(self: PiqpSolver, begin: float, spent: int) -> None:
        raise AssertionError("left to the simplex method")

    program = second_differences(1e10)
    exact = HighsSolver().solve(second_differences(1e10))
    monkeypatch.setattr(PiqpSolver, "_solve_by_simplex", never)
    solver = PiqpSolver()
    found = solver.solve(program)
    assert found.optimal
    assert found.iterations < PIQP_ITERATIONS
    assert program.cost @ found.x == pytest.approx(program.cost @ exact.x, abs=1e-4)
    again = solver.resolve(program.row_lower, program.row_upper)
    assert program.cost @ again.x == pytest.approx(program.cost @ found.x, abs=1e-5)


def test_duals_are_those_of_the_equations_as_they_were_given() -> None:
    matrix = sp.csc_matrix(np.array([[1e6, 0.0], [1.0, 1.0]]))
    program = LinearProgram(
        np.array([1.0, 2.0]),
        matrix,
        np.array([2e6, 3.0]),
        np.array([2e6, 3.0]),
        np.full(2, -10.0),
        np.full(2, 10.0),
        np.arange(2),
        np.arange(2),
    )
    exact = HighsSolver().solve(program)
    found = PiqpSolver().solve(program)
    assert found.x == pytest.approx([2.0, 1.0], abs=1e-5)
    assert found.row_duals == pytest.approx(exact.row_duals, rel=1e-3)


def test_equations_have_coefficients_of_one_at_most() -> None:
    matrix = sp.csr_matrix(np.array([[1e10, -2.0], [0.5, 0.1]]))
    assert equation_scale(matrix) == pytest.approx([1e-10, 1.0])
    assert equation_scale(matrix[:0]).shape == (0,)
