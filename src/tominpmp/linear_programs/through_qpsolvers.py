"""All other solvers, called by their names through qpsolvers."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from tominpmp.linear_programs.highs import HighsSolver
from tominpmp.linear_programs.program import LinearProgram, LpSolution
from tominpmp.linear_programs.solver import NO_BOUND, LpSolver
from tominpmp.stopping import check, seconds_left

# Name of the time limit among the settings of these solvers [s].
TIME_SETTINGS = dict(clarabel="time_limit", osqp="time_limit", scs="time_limit_secs")


class QpsolversSolver(LpSolver):
    """Any solver that qpsolvers supports.

    Attributes:
        name: Name of the solver in qpsolvers.
    """

    curved = True

    def __init__(self, name: str) -> None:
        self.name = name

    def solve(self, program: LinearProgram) -> LpSolution:
        """Solve a program from scratch; if that fails, by the simplex method."""
        solution = self.resolve(program)
        return solution if solution.optimal else HighsSolver().solve(program)

    def resolve(self, program: LinearProgram) -> LpSolution:
        """Solve the last program from scratch with other row bounds."""
        import qpsolvers  # the import takes longer than most plans

        row_lower, row_upper = program.row_lower, program.row_upper
        rows, size = program.matrix.tocsr(), program.cost.size
        equal = row_lower == row_upper
        high = ~equal & (row_upper < NO_BOUND)
        low = ~equal & (row_lower > -NO_BOUND)
        problem = qpsolvers.Problem(
            program.curved,
            program.cost,
            sp.vstack([rows[high], -rows[low]], format="csc"),
            np.concatenate([row_upper[high], -row_lower[low]]),
            rows[equal].tocsc() if equal.any() else None,
            row_upper[equal] if equal.any() else None,
            program.lower,
            program.upper,
        )
        left = seconds_left()
        settings: dict[str, Any] = {}
        if self.name in TIME_SETTINGS and np.isfinite(left):
            settings[TIME_SETTINGS[self.name]] = left
        solution = qpsolvers.solve_problem(problem, solver=self.name, **settings)
        check()
        duals = np.zeros(row_lower.size)
        if solution.found and solution.z is not None:
            count = int(high.sum())
            duals[high] = solution.z[:count]
            duals[low] -= solution.z[count:]
        if solution.found and solution.y is not None and equal.any():
            duals[equal] = solution.y
        x = np.zeros(size) if solution.x is None else solution.x
        return LpSolution(bool(solution.found), x, duals, 0, curved=True)
