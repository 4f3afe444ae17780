"""Linear programs and their solutions, as solvers take and give them."""

from __future__ import annotations

from dataclasses import dataclass

import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray


@dataclass(frozen=True, eq=False)
class LinearProgram:
    """Minimise cost @ x with row_lower <= A x <= row_upper, lower <= x <= upper.

    Attributes:
        cost: Shape (n,).
        matrix: A, shape (m, n).
        row_lower: Shape (m,); equal to ``row_upper`` for equations.
        row_upper: Shape (m,).
        lower: Shape (n,).
        upper: Shape (n,).
        row_keys: Names of the rows, which tie the bases of successive programs, (m,).
        column_keys: Names of the columns, shape (n,).
        curvature: P, positive semidefinite, shape (n, n): x^T P x / 2 is added to the
            objective by solvers that are ``curved``; None for none.
        accuracy: A duality gap of the objective that is none to whoever asks.
    """

    cost: Array
    matrix: sp.csc_matrix
    row_lower: Array
    row_upper: Array
    lower: Array
    upper: Array
    row_keys: IntArray
    column_keys: IntArray
    curvature: sp.csc_matrix | None = None
    accuracy: float = 1e-6

    @property
    def curved(self) -> sp.csc_matrix:
        """Its curvature, zero if there is none."""
        size = self.cost.size
        return sp.csc_matrix((size, size)) if self.curvature is None else self.curvature


@dataclass(frozen=True, eq=False)
class LpSolution:
    """Outcome of a linear program.

    Attributes:
        optimal: Whether it was solved.
        x: Solution, shape (n,); meaningless unless optimal.
        row_duals: Sensitivity of the optimum to the bound that is active, shape (m,):
            positive at an upper bound, negative at a lower one.
        iterations: Simplex pivots or interior-point iterations.
        seconds: Time taken [s].
        curved: Whether the curvature of the program was heeded, if it has any.
    """

    optimal: bool
    x: Array
    row_duals: Array
    iterations: int
    seconds: float
    curved: bool = False
