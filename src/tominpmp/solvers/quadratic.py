"""Sequential quadratic programming: what its objectives share.

The iteration, and a step of it once its program is built. Steps are corrected and
shortened as :mod:`~tominpmp.solvers.step_search` says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.linear_programs import solve_quadratic
from tominpmp.linear_programs.program import LinearProgram, LpSolution
from tominpmp.options import Options
from tominpmp.solvers.iterate import Iterate, SlpResult, Trial
from tominpmp.solvers.merit import Merit
from tominpmp.solvers.step_search import StepSearch
from tominpmp.solvers.subproblem import Subproblem
from tominpmp.solvers.trust_region import TrustRegion
from tominpmp.status import Status
from tominpmp.transcription.base import Program

# Solver of the quadratic programs, and its tolerances: looser where it fails.
QP_SOLVER = "piqp"
QP_TOLERANCES = (1e-9, 1e-7)
# Progress is judged over this many iterations.
WINDOW = 3
# Second-order corrections of a step at most.
CORRECTIONS = 4
LINE_SEARCH = (0.5, 0.25, 0.1, 0.03)


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """The quadratic program of an iteration.

    Attributes:
        frame: How its solution is read.
        program: Its rows, those of the frame first, its bounds and linear costs.
        curvature: Of its objective, positive semidefinite, shape (columns, columns).
    """

    frame: Subproblem
    program: LinearProgram
    curvature: sp.csc_matrix

    def solve(self) -> LpSolution | None:
        """Its solution; None if there is none."""
        for accuracy in QP_TOLERANCES:
            solution = solve_quadratic(
                self.program,
                self.curvature,
                QP_SOLVER,
                eps_abs=accuracy,
                eps_rel=accuracy,
            )
            if solution.optimal and np.all(np.isfinite(solution.x)):
                return solution
        return None

    def corrected(self, error: Array) -> Array | None:
        """Step with a second-order error of the rows put in; None if there is none."""
        low, high = self.frame.corrected(error)
        rest = slice(low.size, None)
        program = replace(
            self.program,
            row_lower=np.concatenate([low, self.program.row_lower[rest]]),
            row_upper=np.concatenate([high, self.program.row_upper[rest]]),
        )
        solution = replace(self, program=program).solve()
        return None if solution is None else self.frame.step(solution)


def first_iterate(nlp: Program, z: Array, cost: Array, weight: float) -> Iterate:
    """State at the start.

    Args:
        nlp: The nonlinear program.
        z: Where to begin.
        cost: Gradient of the duration in the merit, shape (size,).
        weight: Of violations, before any multiplier is known.
    """
    merit = Merit(cost, nlp.rows, 0.0, np.full(len(nlp.rows.kinds), weight))
    return Iterate(z, nlp.evaluate(z), merit, TrustRegion(), np.zeros(nlp.rows.size))


def iterate(
    state: Iterate,
    step: Callable[[Iterate], tuple[Iterate, float]],
    objective: Callable[[Iterate], float],
    options: Options,
    over: Callable[[], bool],
    settled: float,
) -> SlpResult:
    """Iterate until nothing more is to be had.

    Args:
        state: Where to begin.
        step: Makes an iteration; the next state, and by how much its program promised
            to lower the merit.
        objective: What is to be least.
        options: Tolerances and limits.
        over: Tells whether the time is up.
        settled: The iteration ends when a step promises less than this share of the
            objective, or the last few brought less.

    Returns:
        The outcome; the best iterate is that of the least objective that keeps all
        constraints.
    """
    best: tuple[float, Iterate] | None = None
    status = Status.ITERATION_LIMIT
    costs: list[float] = []
    for _ in range(options.max_iterations):
        state, promised = step(state)
        cost = objective(state)
        if np.isfinite(promised):  # that a program was not solved proves nothing
            costs = [*costs, cost][-WINDOW - 1 :]
        if state.violation <= options.feasibility:
            if best is None or cost < best[0]:
                best = cost, state
            gained = costs[0] - cost if len(costs) > WINDOW else np.inf
            if min(promised, gained) < settled * cost:
                status = Status.CONVERGED
                break
        if state.region.exhausted or over():
            status = Status.TIME_LIMIT if over() else Status.STALLED
            break
    found = None if best is None else best[1]
    return SlpResult(status, found or state, found, ())


def take_step(
    nlp: Program,
    state: Iterate,
    quadratic: QuadraticProgram,
    here: float,
    objective: Callable[[Array, Array], float],
    model: Callable[[Array], float],
    feasibility: float,
) -> tuple[Iterate, float]:
    """Solve the program of an iteration, correct, search, accept or shrink.

    Args:
        nlp: The nonlinear program.
        state: The state.
        quadratic: Its quadratic program.
        here: The objective at the state.
        objective: What is to be least, of unknowns and row values.
        model: What the quadratic program has it be after a step.
        feasibility: Violations that need no correction.

    Returns:
        The next state, and by how much the program promised to lower the merit.
    """
    solution = quadratic.solve()
    if solution is None:
        return replace(state, region=state.region.after(0.0, 0.3)), np.inf
    frame, z, values = quadratic.frame, state.z, state.values
    step = frame.step(solution)
    expected = values.copy()
    expected[frame.rows] += frame.change(step)

    def merit(z: Array, values: Array) -> float:
        return objective(z, values) + state.merit.penalty(values)

    now = here + state.merit.penalty(values)
    promised = max(now - (model(step) + state.merit.penalty(expected)), 0.0)
    outcome = StepSearch(nlp, merit, frame, CORRECTIONS, LINE_SEARCH).run(
        Trial(z, values, now),
        step,
        promised,
        quadratic.corrected,
        lambda _, violation: violation <= feasibility,
    )
    trial = outcome.trial
    multipliers = frame.multipliers(solution)
    raised = state.merit.raised(multipliers, values, expected)
    region = state.region.after(outcome.ratio, trial.damping)
    state = replace(state, merit=raised, region=region, multipliers=multipliers)
    if outcome.accepted:
        state = replace(state, z=trial.z, values=trial.values)
    return state, promised
