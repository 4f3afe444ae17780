"""PIQP, an interior-point method whose cost grows linearly with the grid."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import piqp
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray
from tominpmp.linear_programs.highs import MANY, HighsSolver
from tominpmp.linear_programs.program import LinearProgram, LpSolution
from tominpmp.linear_programs.solver import NO_BOUND, LpSolver
from tominpmp.stopping import check, seconds_left

# Most iterations of PIQP, which usually needs 18 to 30. If it has not converged within
# this limit, it seldom does before its default limit of 250. It then tries a second
# time, with iterative refinement of the linear systems, or without it if the first try
# had it: of the programs that one way does not solve the other one solves most. The
# simplex method solves the others, unless it would take thousands of pivots.
PIQP_ITERATIONS = 60
# If rounding prevents convergence to the last digits, PIQP stalls at the solution. It
# is accepted up to these residuals of rows and of multipliers.
NEARLY_ROWS, NEARLY_DUALS = 1e-6, 1e-3
# Requested residual of rows and of multipliers, in units of the limits, up to which the
# linear systems are refined: without it, certificates of several segments fail.
RESIDUAL = 1e-7
# Passes of equilibration by PIQP: equations are scaled here already, and other rows are
# in units of their limits. Two passes took 4 % more iterations for the same T (128
# goals).
PIQP_SCALINGS = 0
# Final regularisation of equations: with less of it rounding errors grow.
PIQP_LAST = 1e-10
# Tolerance of the proof, by multipliers, that a program is infeasible, in versions of
# PIQP that test it (0.7 and later). With their default of 1e-4 the last steps towards a
# solution met it: 21 of 1059 programs of a Panda were called infeasible, which are
# solved with 1e-6 and below.
PIQP_PROOF = 1e-10

# Systems are factorised stage by stage if the density of the matrix is at most this.
STAGED, STAGED_SHARE = piqp.KKTSolver.sparse_multistage, 0.1


@dataclass(frozen=True)
class Termination:
    """Termination of the interior-point method: tolerances and iteration limit.

    Attributes:
        gap: Sufficient duality gap, in units of the objective.
        share: Sufficient duality gap, as a share of the objective; the larger of both
            counts.
        iterations: Iteration limit.
        residual: Requested residual. Rows are satisfied much better once the gap has
            closed. Multipliers of overlapping limits are not, and more than half of all
            iterations would be spent on their last digits.
    """

    gap: float = 2e-5
    share: float = 0.0
    iterations: int = PIQP_ITERATIONS
    residual: float = 1e-4


USUAL_TERMINATION = Termination()


def factorisation(program: LinearProgram, fragile: bool) -> Any:
    """The method by which PIQP factorises the linear systems of a program.

    Factorisation stage by stage takes two thirds of the time, with the same iterations
    and solutions, if most unknowns have curvature and all rows are inequalities of few
    unknowns each. Without curvature, or with equations, rounding errors spoil it.

    Args:
        program: The program.
        fragile: Whether the program has equations, or stages have failed before.
    """
    matrix = program.matrix
    sparse = matrix.nnz <= STAGED_SHARE * matrix.shape[0] * matrix.shape[1]
    most = 2 * np.count_nonzero(program.curved.diagonal()) > program.cost.size
    staged = most and not fragile and sparse
    return STAGED if staged and _staged_works() else piqp.KKTSolver.sparse_ldlt


def equation_scale(equations: sp.csc_matrix) -> Array:
    """Factors that scale the largest coefficient of each equation to 1, shape (m,).

    Equations with smaller coefficients are not scaled. Second differences over short
    intervals have coefficients of 1e10.

    Args:
        equations: The equations.
    """
    return np.asarray(1.0 / np.maximum(1.0, abs(equations).max(axis=1).toarray()[:, 0]))


@cache
def _staged_works() -> bool:
    """Whether this build of PIQP supports factorisation stage by stage."""
    unit, bound = sp.identity(2, format="csc"), np.ones(2)
    solver = piqp.SparseSolver()
    solver.settings.verbose = False
    solver.settings.kkt_solver = STAGED
    solver.setup(unit, bound, None, None, unit, -bound, bound, -bound, bound)
    return bool(solver.solve() == piqp.PIQP_SOLVED)


class PiqpSolver(LpSolver):
    """PIQP, a proximal interior-point method (Schwan, Jiang, Kuhn, Jones, 2023).

    Args:
        termination: Tolerances and iteration limit.
    """

    curved = True

    def __init__(self, termination: Termination = USUAL_TERMINATION) -> None:
        self._termination = termination
        solver = piqp.SparseSolver()
        solver.settings.verbose = False
        solver.settings.check_duality_gap = True
        solver.settings.eps_duality_gap_rel = 1e-6
        solver.settings.preconditioner_iter = PIQP_SCALINGS
        solver.settings.reg_finetune_lower_limit = PIQP_LAST
        for name in ("eps_primal_inf", "eps_dual_inf"):
            if hasattr(solver.settings, name):
                setattr(solver.settings, name, PIQP_PROOF)
        self._solver = solver
        self._scale: Array = np.zeros(0)
        self._equal: BoolArray = np.zeros(0, dtype=bool)
        self._pace, self._stages_fail = 0.0, False

    def solve(self, program: LinearProgram) -> LpSolution:
        """Solve a program; the interior-point method has no warm start."""
        self._set_up(program)
        residual = self._termination.residual
        first = self._run(program, residual)
        if first.optimal:
            return first
        other = USUAL_TERMINATION.residual if residual <= RESIDUAL else RESIDUAL
        second = self._run(program, other)
        spent = first.iterations + second.iterations
        if not second.optimal and sum(program.matrix.shape) <= MANY:
            second = HighsSolver().solve(program)
            spent += second.iterations
        return replace(second, iterations=spent)

    def _set_up(self, program: LinearProgram) -> None:
        self._equal = equal = program.row_lower == program.row_upper
        equations, others = program.matrix[equal], program.matrix[~equal]
        self._scale = equation_scale(equations)
        equations.data *= self._scale[equations.indices]
        equations.eliminate_zeros()  # stored zeros change the order of elimination
        settings, fragile = self._solver.settings, self._stages_fail or equal.any()
        settings.kkt_solver = factorisation(program, fragile)
        settings.eps_duality_gap_abs = program.accuracy
        # Products of sparse matrices have unsorted entries, with which PIQP would write
        # outside its memory.
        self._solver.setup(
            program.curved.sorted_indices(),
            program.cost,
            equations.sorted_indices(),
            self._scale * program.row_lower[equal],
            others.sorted_indices(),
            np.maximum(program.row_lower[~equal], -NO_BOUND),
            np.minimum(program.row_upper[~equal], NO_BOUND),
            np.maximum(program.lower, -NO_BOUND),
            np.minimum(program.upper, NO_BOUND),
        )

    def resolve(self, program: LinearProgram) -> LpSolution:
        """Solve again with other row bounds; the symbolic factorisation is kept."""
        equal, lower, upper = self._equal, program.row_lower, program.row_upper
        self._solver.update(
            b=self._scale * lower[equal],
            h_l=np.maximum(lower[~equal], -NO_BOUND),
            h_u=np.minimum(upper[~equal], NO_BOUND),
        )
        return self._run(program, self._solver.settings.eps_abs)

    def _run(self, program: LinearProgram, residual: float) -> LpSolution:
        spent = self._try(residual)
        if not self._solved and self._solver.settings.kkt_solver == STAGED:
            # Without pivoting between stages, coefficients of 1e9 next to others of 1
            # may lead to NaN or wrong numbers. Other programs of the same motion have
            # such coefficients, too.
            self._stages_fail = True
            self._set_up(program)
            spent += self._try(residual)
            self._stages_fail = self._solved
        result = self._solver.result
        duals = np.zeros(self._equal.size)
        duals[self._equal] = self._scale * result.y
        duals[~self._equal] = result.z_u - result.z_l
        return LpSolution(self._solved, np.array(result.x), duals, spent, curved=True)

    def _try(self, residual: float) -> int:
        """Run PIQP; returns the number of iterations."""
        settings, most = self._solver.settings, self._termination.iterations
        settings.eps_abs = settings.eps_rel = residual
        settings.iterative_refinement_always_enabled = residual <= RESIDUAL
        left = seconds_left()
        if np.isfinite(left):
            # PIQP has no time limit, but all iterations take the same time.
            if self._pace == 0.0:
                self._iterate(1)
                left = seconds_left()
            most = max(int(min(left / max(self._pace, 1e-9), most)), 1)
        return self._iterate(most)

    def _iterate(self, most: int) -> int:
        """Run PIQP for some iterations at most, and time them; returns their number."""
        self._solver.settings.max_iter = most
        begin = time.perf_counter()
        self._solver.solve()
        count = int(self._solver.result.info.iter)
        self._pace = (time.perf_counter() - begin) / max(count, 1)
        check()
        return count

    @property
    def _solved(self) -> bool:
        """Whether the last run has reached a solution, up to its last digits."""
        result = self._solver.result
        info, termination = result.info, self._termination
        if not np.all(np.isfinite(result.x)) or info.primal_res > NEARLY_ROWS:
            return False
        gap = max(termination.gap, termination.share * abs(info.primal_obj))
        nearly = info.duality_gap <= gap and info.dual_res <= NEARLY_DUALS
        return self._exact or bool(nearly)

    @property
    def _exact(self) -> bool:
        """Whether the last run has converged to the requested residual."""
        return bool(self._solver.result.info.status == piqp.PIQP_SOLVED)
