"""Linear programs and their solutions: input and output of the solvers."""

from __future__ import annotations

from dataclasses import dataclass

import scipy.sparse as sp

from tominpmp.arrays import Array


@dataclass(frozen=True, eq=False)
class LinearProgram:
    """Minimise cost @ x with row_lower <= A x <= row_upper, lower <= x <= upper.

    Attributes:
        matrix: A, shape (m, n).
        cost: Shape (n,).
        lower: Shape (n,).
        upper: Shape (n,).
        row_lower: Shape (m,); equal to ``row_upper`` for equations.
        row_upper: Shape (m,).
        curvature: P, positive semidefinite, shape (n, n). Solvers that are ``curved``
            add x^T P x / 2 to the objective; None, or a zero matrix, without curvature.
        accuracy: Duality gap below which the program counts as solved.
    """

    matrix: sp.csc_matrix
    cost: Array
    lower: Array
    upper: Array
    row_lower: Array
    row_upper: Array
    curvature: sp.csc_matrix | None = None
    accuracy: float = 1e-6

    @property
    def curved(self) -> sp.csc_matrix:
        """The curvature, a zero matrix for a program without curvature."""
        size = self.cost.size
        return sp.csc_matrix((size, size)) if self.curvature is None else self.curvature


@dataclass(frozen=True, eq=False)
class LpSolution:
    """Outcome of a linear program.

    Attributes:
        optimal: Whether the program was solved.
        x: Solution, shape (n,); meaningless unless optimal.
        row_duals: Multipliers of the rows, shape (m,): sensitivity of the optimum to
            the active bound, positive at an upper bound, negative at a lower one.
        iterations: Simplex pivots or interior-point iterations; 0 if not known.
        curved: Whether the solver took the curvature, if there is any, into account.
    """

    optimal: bool
    x: Array
    row_duals: Array
    iterations: int
    curved: bool = False
