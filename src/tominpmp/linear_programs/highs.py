"""HiGHS, called directly, as the interface of qpsolvers cannot pass a basis on."""

from __future__ import annotations

from typing import Any

import highspy
import numpy as np

from tominpmp.linear_programs.program import LinearProgram, LpSolution
from tominpmp.linear_programs.solver import LpSolver
from tominpmp.stopping import check, due, seconds_left

# Programs with more rows and columns may take a simplex method tens of thousands of
# pivots, and a minute.
MANY = 3000


def _interrupt(event: Any) -> None:
    """Interrupt a run of HiGHS once a stop is due."""
    if due():
        event.interrupt()


class HighsSolver(LpSolver):
    """Bounded dual simplex of HiGHS, warm started (Huangfu and Hall, 2018).

    A basis fits a program with as many rows and columns. Large programs for which none
    is known are solved by its interior-point method and a crossover to a basis (Schork
    and Gondzio, 2020): 2 to 10 times as fast.
    """

    def __init__(self) -> None:
        highs = highspy.Highs()
        highs.setOptionValue("output_flag", False)
        highs.setOptionValue("threads", 1)
        highs.setOptionValue("primal_feasibility_tolerance", 1e-9)
        highs.setOptionValue("dual_feasibility_tolerance", 1e-9)
        # The callback is called after each pivot; before the first one, during presolve
        # and factorisation, only the time limit applies.
        highs.cbSimplexInterrupt += _interrupt
        highs.cbIpmInterrupt += _interrupt
        self._highs = highs
        self._basis: highspy.HighsBasis | None = None

    def solve(self, program: LinearProgram) -> LpSolution:
        """Solve a program, warm started from the basis of the last one if it fits."""
        matrix = program.matrix
        lp = highspy.HighsLp()
        lp.num_row_, lp.num_col_ = matrix.shape
        lp.col_cost_ = program.cost
        lp.col_lower_, lp.col_upper_ = program.lower, program.upper
        lp.row_lower_, lp.row_upper_ = program.row_lower, program.row_upper
        lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
        lp.a_matrix_.start_ = matrix.indptr
        lp.a_matrix_.index_ = matrix.indices
        lp.a_matrix_.value_ = matrix.data
        self._highs.passModel(lp)
        basis = self._basis
        if basis and (len(basis.row_status), len(basis.col_status)) == matrix.shape:
            self._highs.setBasis(basis)
        elif sum(matrix.shape) > MANY:
            found = self._run("ipm")
            if found.optimal:
                return found
        return self._run()

    def resolve(self, program: LinearProgram) -> LpSolution:
        """Solve again: as the basis remains dual feasible, a few pivots suffice."""
        lower, upper = program.row_lower, program.row_upper
        indices = np.arange(lower.size, dtype=np.int32)
        self._highs.changeRowsBounds(lower.size, indices, lower, upper)
        return self._run()

    def _run(self, method: str = "simplex") -> LpSolution:
        self._highs.setOptionValue("solver", method)
        # The time limit of HiGHS counts all runs of the same object.
        limit = self._highs.getRunTime() + seconds_left()
        self._highs.setOptionValue("time_limit", limit)
        self._highs.run()
        check()
        optimal = self._highs.getModelStatus() == highspy.HighsModelStatus.kOptimal
        solution, info = self._highs.getSolution(), self._highs.getInfo()
        self._basis = self._highs.getBasis() if optimal else None
        return LpSolution(
            optimal,
            np.array(solution.col_value),
            -np.array(solution.row_dual),
            max(int(info.simplex_iteration_count), 0),
        )
