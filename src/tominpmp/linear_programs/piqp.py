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
from tominpmp.linear_programs.compressed import Compressed
from tominpmp.linear_programs.highs import HighsSolver
from tominpmp.linear_programs.program import LinearProgram, LpSolution
from tominpmp.linear_programs.solver import HUGE, MANY_COLUMNS, LpSolver
from tominpmp.stopping import check, seconds_left

# Iterations of PIQP at most. It needs 18 to 30; where it has not ended by then, it
# seldom does before its own limit of 250, and the simplex method is faster; not for
# programs of many columns: those get a second chance with refined linear systems,
# which is dearer an iteration.
PIQP_ITERATIONS = 60
# Where rounding keeps it from the last digits it stands still with the solution: rows
# are kept to the first, and multipliers to the second.
NEARLY_ROWS, NEARLY_DUALS = 1e-6, 1e-3
# What is asked for, of rows and of multipliers, in units of the limits.
RESIDUAL = 1e-7
# Passes of equilibration, after ours of equations: rows are in units of their limits.
# Two of them took 4 % more iterations for the same T (128 goals).
PIQP_SCALINGS = 0
# What regularises equations in the end: with less of it rounding grows.
PIQP_LAST = 1e-10
# How nearly multipliers prove that a program has no solution, in versions of PIQP that
# take their word for it (0.7 on). At their 1e-4 the last steps towards a solution did:
# 21 of 1059 programs of a Panda were called infeasible, and are solved from 1e-6 down.
PIQP_PROOF = 1e-10

# Systems are factorised stage by stage where coefficients are at most this share of all
# that rows might have.
STAGED, STAGED_SHARE = piqp.KKTSolver.sparse_multistage, 0.1


@dataclass(frozen=True)
class Nearly:
    """When an interior point is near enough to a solution, and how long to wait for it.

    Attributes:
        gap: Duality gap that will do, in units of the objective.
        share: The same as a share of the objective; the larger of both counts.
        iterations: Iterations at most.
        residual: Residual that is asked for. Rows are kept much better than that when
            the gap has closed; multipliers of limits that overlap are not, and waiting
            for their last digits took more than half of all iterations.
    """

    gap: float = 2e-5
    share: float = 0.0
    iterations: int = PIQP_ITERATIONS
    residual: float = 1e-4


USUALLY = Nearly()


def factorisation(program: LinearProgram, equations: bool) -> Any:
    """How PIQP factorises its linear systems for a program.

    Stage by stage where that has two thirds of the time and the same iterations and
    solutions: curvature in all unknowns, nothing but inequalities, and these of few
    unknowns each. Where nothing bends, or there are equations, rounding spoils it.

    Args:
        program: The program.
        equations: Whether it has any.
    """
    matrix = program.matrix
    few = matrix.nnz <= STAGED_SHARE * matrix.shape[0] * matrix.shape[1]
    staged = program.curvature is not None and not equations and few
    return STAGED if staged and _staged_works() else piqp.KKTSolver.sparse_ldlt


def in_order(matrix: sp.csc_matrix) -> sp.csc_matrix:
    """A matrix with its columns in the order of rows.

    Products of sparse matrices have them in any order, and PIQP writes beside its
    memory then.

    Args:
        matrix: By columns.
    """
    return matrix if matrix.has_sorted_indices else matrix.sorted_indices()


def equation_scale(equations: Compressed) -> Array:
    """Factors that make the largest coefficient of equations one at most, shape (m,).

    Second differences over short intervals have coefficients of 1e10.

    Args:
        equations: By columns.
    """
    return np.asarray(1.0 / np.maximum(1.0, equations.largest()))


@cache
def _staged_works() -> bool:
    """Whether this PIQP was built with what it takes, which not all are."""
    one, bound = sp.identity(2, format="csc"), np.ones(2)
    solver = piqp.SparseSolver()
    solver.settings.verbose = False
    solver.settings.kkt_solver = STAGED
    solver.setup(one, bound, None, None, one, -bound, bound, -bound, bound)
    return bool(solver.solve() == piqp.PIQP_SOLVED)


class PiqpSolver(LpSolver):
    """PIQP, a proximal interior-point method (Schwan, Jiang, Kuhn, Jones, 2023).

    Args:
        nearly: When a solution will do that it does not get to the last digits of.
    """

    curved = True

    def __init__(self, nearly: Nearly = USUALLY) -> None:
        self._nearly = nearly
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
        self._program: LinearProgram | None = None
        self._other: HighsSolver | None = None

    def solve(self, program: LinearProgram) -> LpSolution:
        """Solve a program; interior points have no warm start."""
        begin = time.perf_counter()
        self._program, self._other = program, None
        self._set_up(program)
        found = self._run(begin)
        if found.optimal:
            return found
        return self._solve_by_simplex(begin, found.iterations)

    def _set_up(self, program: LinearProgram) -> None:
        self._equal = equal = program.row_lower == program.row_upper
        others, equations = program.matrix, None
        self._scale = np.zeros(0)
        if equal.any():
            matrix = Compressed.of(program.matrix)
            others, own = matrix.chosen(~equal).columns(), matrix.chosen(equal)
            self._scale = equation_scale(own)
            equations = own.times(self._scale).columns()
        settings = self._solver.settings
        settings.kkt_solver = piqp.KKTSolver.sparse_ldlt
        if not self._stages_fail:
            settings.kkt_solver = factorisation(program, equations is not None)
        settings.eps_duality_gap_abs = program.accuracy
        self._solver.setup(
            in_order(program.curved),
            program.cost,
            None if equations is None else in_order(equations),
            None if equations is None else self._scale * program.row_lower[equal],
            in_order(others),
            np.maximum(program.row_lower[~equal], -HUGE),
            np.minimum(program.row_upper[~equal], HUGE),
            np.maximum(program.lower, -HUGE),
            np.minimum(program.upper, HUGE),
        )

    def resolve(self, row_lower: Array, row_upper: Array) -> LpSolution:
        """Solve again, with the symbolic factorisation kept."""
        begin = time.perf_counter()
        if self._other is not None:
            return self._other.resolve(row_lower, row_upper)
        equal, program = self._equal, self._program
        assert program is not None  # noqa: S101
        self._program = replace(program, row_lower=row_lower, row_upper=row_upper)
        self._solver.update(
            b=self._scale * row_lower[equal] if equal.any() else None,
            h_l=np.maximum(row_lower[~equal], -HUGE),
            h_u=np.minimum(row_upper[~equal], HUGE),
        )
        return self._run(begin)

    def _run(self, begin: float) -> LpSolution:
        assert self._program is not None  # noqa: S101
        spent = self._try(begin, self._nearly.residual)
        if not self._solved and self._solver.settings.kkt_solver == STAGED:
            # Without pivots between stages, coefficients of 1e9 beside those of one may
            # leave no number, or wrong ones; the other programs of the same motion have
            # them, too.
            self._stages_fail = True
            self._set_up(self._program)
            spent += self._try(begin, self._nearly.residual)
            self._stages_fail = self._solved
        if not self._solved and (self._ended or self._program.cost.size > MANY_COLUMNS):
            spent += self._try(begin, RESIDUAL, refined=True)
        result = self._solver.result
        duals = np.zeros(self._equal.size)
        duals[self._equal] = self._scale * result.y
        duals[~self._equal] = result.z_u - result.z_l
        return LpSolution(
            self._solved,
            np.array(result.x),
            duals,
            spent,
            time.perf_counter() - begin,
            curved=True,
        )

    def _try(self, begin: float, residual: float, *, refined: bool = False) -> int:
        """Iterate; returns how often."""
        settings = self._solver.settings
        settings.eps_abs = settings.eps_rel = residual
        settings.iterative_refinement_always_enabled = refined
        self._limit()
        self._solver.solve()
        count = int(self._solver.result.info.iter)
        self._pace = (time.perf_counter() - begin) / max(count, 1)
        check()
        return count

    @property
    def _solved(self) -> bool:
        """Whether there is a solution, but for the last digits."""
        result = self._solver.result
        info, nearly = result.info, self._nearly
        if not np.all(np.isfinite(result.x)) or info.primal_res > NEARLY_ROWS:
            return False
        gap = max(nearly.gap, nearly.share * abs(info.primal_obj))
        near = info.duality_gap <= gap and info.dual_res <= NEARLY_DUALS
        return self._ended or bool(near)

    @property
    def _ended(self) -> bool:
        """Whether it found what it was asked for."""
        return bool(self._solver.result.info.status == piqp.PIQP_SOLVED)

    def _solve_by_simplex(self, begin: float, spent: int) -> LpSolution:
        """Leave the program, and what follows from it, to the simplex method."""
        self._other, program = HighsSolver(), self._program
        assert program is not None  # noqa: S101
        found = self._other.solve(program)
        seconds = time.perf_counter() - begin
        return replace(found, iterations=spent + found.iterations, seconds=seconds)

    def _limit(self) -> None:
        """Bound the iterations by the time that is left: PIQP has no limit on time."""
        settings, left = self._solver.settings, seconds_left()
        settings.max_iter = self._nearly.iterations
        if np.isinf(left):
            return
        if self._pace == 0.0:
            # Iterations alike in time: the first tells how many there may be.
            begin = time.perf_counter()
            settings.max_iter = 1
            self._solver.solve()
            self._pace = time.perf_counter() - begin
            check()
            left = seconds_left()
        allowed = int(min(left / max(self._pace, 1e-9), self._nearly.iterations))
        settings.max_iter = max(allowed, 1)
