"""Linear programs: one record, a few solvers. The only module that knows them.

Some of them take a convex curvature of the objective, too.

HiGHS is called directly, since the portable interface of qpsolvers cannot hand over a
basis; PIQP is an interior-point method whose cost grows linearly with the grid; every
other solver is reached through qpsolvers by its name.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import highspy
import numpy as np
import piqp
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, equation_scale
from tominpmp.exceptions import SolverNotFound
from tominpmp.program_records import LinearProgram, LpSolution
from tominpmp.stopping import check, due, seconds_left

# Bounds beyond this are none, for solvers that have no infinity.
HUGE = 1e30
# Iterations of PIQP at most. It needs 18 to 30; where it has not ended by then, it
# seldom does before its own limit of 250, and the simplex method is faster; not for
# programs of many columns, of which it needs thousands of pivots and seconds: those get
# a second chance with refined linear systems, which is dearer an iteration.
PIQP_ITERATIONS, MANY_COLUMNS = 60, 1000
# Where rounding keeps it from the last digits it stands still with the solution: rows
# are kept to the first, and multipliers to the second.
NEARLY_ROWS, NEARLY_DUALS = 1e-6, 1e-3
# Passes of equilibration, and what regularises equations in the end: more passes after
PIQP_SCALINGS, PIQP_LAST = 2, 1e-10  # ours cost iterations, less lets rounding grow
# What solvers behind qpsolvers call their limit on time [s].
TIME_LIMITS = dict.fromkeys(("clarabel", "highs", "osqp"), "time_limit")
TIME_LIMITS["scs"] = "time_limit_secs"


@dataclass(frozen=True)
class Nearly:
    """When an interior point is near enough to a solution, and how long to wait for it.

    Attributes:
        gap: Duality gap that will do, in units of the objective.
        share: The same as a share of the objective; the larger of both counts.
        iterations: Iterations at most.
    """

    gap: float = 2e-5
    share: float = 0.0
    iterations: int = PIQP_ITERATIONS


USUALLY = Nearly()


class LpSolver(ABC):
    """A solver of a sequence of related linear programs.

    Attributes:
        curved: Whether it heeds the curvature of a program.
    """

    curved: bool = False

    @abstractmethod
    def solve(self, program: LinearProgram) -> LpSolution:
        """Solve a program, warm started from the last one where that is possible."""

    @abstractmethod
    def resolve(self, row_lower: Array, row_upper: Array) -> LpSolution:
        """Solve the last program again with other row bounds."""


def _interrupt(event: Any) -> None:
    """End a run of HiGHS when it is time to stop."""
    if due():
        event.interrupt()


class HighsSolver(LpSolver):
    """HiGHS' bounded dual simplex, warm started (Huangfu and Hall, 2018).

    Programs of many columns, of which no basis is known, are solved by its interior
    points and a crossover to a basis (Schork and Gondzio, 2020): 2 to 10 times as fast.
    """

    def __init__(self) -> None:
        highs = highspy.Highs()
        for option, value in (
            ("output_flag", False),
            ("threads", 1),
            ("primal_feasibility_tolerance", 1e-9),
            ("dual_feasibility_tolerance", 1e-9),
        ):
            highs.setOptionValue(option, value)
        # Asked after each pivot; the time limit is for what comes before the first.
        highs.cbSimplexInterrupt += _interrupt
        highs.cbIpmInterrupt += _interrupt
        self._highs = highs
        self._program: LinearProgram | None = None
        self._basis: highspy.HighsBasis | None = None

    def solve(self, program: LinearProgram) -> LpSolution:
        """Solve a program from the basis of the last one."""
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
        if self._basis is not None and self._program is not None:
            self._carry_basis(self._program, program)
        cold = self._basis is None and program.cost.size > MANY_COLUMNS
        self._program = program
        found = self._run("ipm") if cold else self._run()
        return found if found.optimal or not cold else self._run()

    def _carry_basis(self, old: LinearProgram, new: LinearProgram) -> None:
        basis = self._basis
        assert basis is not None  # noqa: S101
        before_rows = dict(zip(old.row_keys.tolist(), basis.row_status, strict=True))
        before = dict(zip(old.column_keys.tolist(), basis.col_status, strict=True))
        basic, at_lower = (
            highspy.HighsBasisStatus.kBasic,
            highspy.HighsBasisStatus.kLower,
        )
        carried = highspy.HighsBasis()
        carried.row_status = [before_rows.get(k, basic) for k in new.row_keys.tolist()]
        carried.col_status = [before.get(k, at_lower) for k in new.column_keys.tolist()]
        carried.valid = True
        self._highs.setBasis(carried)

    def resolve(self, row_lower: Array, row_upper: Array) -> LpSolution:
        """Solve again; the basis stays dual feasible, so that a few pivots do."""
        indices = np.arange(row_lower.size, dtype=np.int32)
        self._highs.changeRowsBounds(row_lower.size, indices, row_lower, row_upper)
        return self._run()

    def _run(self, method: str = "simplex") -> LpSolution:
        begin = time.perf_counter()
        self._highs.setOptionValue("solver", method)
        # Its limit counts all runs of the same object.
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
            time.perf_counter() - begin,
        )


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
        # Residuals are in units of the limits; a duality gap is in seconds, of which
        # the steps of sequential linear programming need no more than the microseconds.
        solver.settings.eps_abs = 1e-7
        solver.settings.eps_rel = 1e-7
        solver.settings.check_duality_gap = True
        solver.settings.eps_duality_gap_abs = 1e-6
        solver.settings.eps_duality_gap_rel = 1e-6
        solver.settings.preconditioner_iter = PIQP_SCALINGS
        solver.settings.reg_finetune_lower_limit = PIQP_LAST
        self._solver = solver
        self._scale: Array = np.zeros(0)
        self._equal: BoolArray = np.zeros(0, dtype=bool)
        self._pace = 0.0
        self._program: LinearProgram | None = None
        self._other: HighsSolver | None = None

    def solve(self, program: LinearProgram) -> LpSolution:
        """Solve a program; interior points have no warm start."""
        begin = time.perf_counter()
        equal = program.row_lower == program.row_upper
        self._equal, self._program, self._other = equal, program, None
        rows = program.matrix.tocsr()
        equations = rows[equal]
        self._scale = equation_scale(equations)
        self._solver.setup(
            program.curved,
            program.cost,
            (sp.diags(self._scale) @ equations).tocsc() if equal.any() else None,
            self._scale * program.row_lower[equal] if equal.any() else None,
            rows[~equal].tocsc(),
            np.maximum(program.row_lower[~equal], -HUGE),
            np.minimum(program.row_upper[~equal], HUGE),
            np.maximum(program.lower, -HUGE),
            np.minimum(program.upper, HUGE),
        )
        return self._run(begin)

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
        spent = self._try(begin)
        if not self._solved and self._program.cost.size > MANY_COLUMNS:
            spent += self._try(begin, refined=True)
        if not self._solved:
            return self._solve_by_simplex(begin, spent)
        result = self._solver.result
        duals = np.zeros(self._equal.size)
        duals[self._equal] = self._scale * result.y
        duals[~self._equal] = result.z_u - result.z_l
        return LpSolution(
            True,
            np.array(result.x),
            duals,
            spent,
            time.perf_counter() - begin,
            curved=True,
        )

    def _try(self, begin: float, *, refined: bool = False) -> int:
        """Iterate; returns how often."""
        self._solver.settings.iterative_refinement_always_enabled = refined
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
        if not np.all(np.isfinite(result.x)):
            return False
        gap = max(nearly.gap, nearly.share * abs(info.primal_obj))
        return info.status == piqp.PIQP_SOLVED or bool(
            info.primal_res <= NEARLY_ROWS
            and info.duality_gap <= gap
            and info.dual_res <= NEARLY_DUALS
        )

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


class QpsolversSolver(LpSolver):
    """Any solver that qpsolvers knows.

    Attributes:
        name: Its name there.
    """

    curved = True

    def __init__(self, name: str) -> None:
        self.name = name
        self._program: LinearProgram | None = None

    def solve(self, program: LinearProgram) -> LpSolution:
        """Solve a program from scratch."""
        self._program = program
        return self.resolve(program.row_lower, program.row_upper)

    def resolve(self, row_lower: Array, row_upper: Array) -> LpSolution:
        """Solve the last program from scratch with other row bounds."""
        program = self._program
        assert program is not None  # noqa: S101
        changed = replace(program, row_lower=row_lower, row_upper=row_upper)
        return solve_quadratic(changed, program.curved, self.name)


def solve_quadratic(
    program: LinearProgram, curvature: sp.csc_matrix, name: str, **settings: Any
) -> LpSolution:
    """Solve a program with x^T P x / 2 added to its objective, through qpsolvers.

    Args:
        program: Linear objective, rows and bounds.
        curvature: P, positive semidefinite, shape (n, n).
        name: Name of the solver.
        **settings: Its own settings.
    """
    import qpsolvers  # takes longer to import than most plans take

    begin = time.perf_counter()
    rows, size = program.matrix.tocsr(), program.cost.size
    row_lower, row_upper = program.row_lower, program.row_upper
    equal = row_lower == row_upper
    high = ~equal & (row_upper < HUGE)
    low = ~equal & (row_lower > -HUGE)
    problem = qpsolvers.Problem(
        curvature,
        program.cost,
        sp.vstack([rows[high], -rows[low]], format="csc"),
        np.concatenate([row_upper[high], -row_lower[low]]),
        rows[equal].tocsc() if equal.any() else None,
        row_upper[equal] if equal.any() else None,
        program.lower,
        program.upper,
    )
    left = seconds_left()
    if name in TIME_LIMITS and np.isfinite(left):
        settings = {TIME_LIMITS[name]: left, **settings}
    solution = qpsolvers.solve_problem(problem, solver=name, **settings)
    check()
    duals = np.zeros(row_lower.size)
    if solution.found and solution.z is not None:
        count = int(high.sum())
        duals[high] = solution.z[:count]
        duals[low] -= solution.z[count:]
    if solution.found and solution.y is not None and equal.any():
        duals[equal] = solution.y
    x = np.zeros(size) if solution.x is None else solution.x
    seconds = time.perf_counter() - begin
    return LpSolution(bool(solution.found), x, duals, 0, seconds, curved=True)


def available_solvers() -> tuple[str, ...]:
    """Names of the solvers that are installed."""
    import qpsolvers

    return tuple(dict.fromkeys(["highs", "piqp", *qpsolvers.available_solvers]))


def make_solver(name: str) -> LpSolver:
    """Make a solver by its name.

    Args:
        name: "highs", "piqp" or a name that qpsolvers knows.

    Raises:
        SolverNotFound: If it is not installed.
    """
    if name == "highs":
        return HighsSolver()
    if name == "piqp":
        return PiqpSolver()
    if name not in available_solvers():
        raise SolverNotFound(name, available_solvers())
    return QpsolversSolver(name)
