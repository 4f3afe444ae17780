r"""The paper's iteration, word for word: fixed steps, every one of them taken.

At torques u and duration T the linear program (equations 14 and 15)

.. math::
    \min \; T + \delta T \quad s.t. \quad g + \delta g = 0, \quad
    h + \delta h \le 0, \quad u_l \le u + \delta u \le u_u, \\
    |\delta u| \le \rho, \quad |\delta T| \le \epsilon, \quad 0 \le T + \delta T

is solved, with rows for the goal g and for path constraints h at the active instants S,
and the step is taken whatever it brings. As long as the linearised
equations cannot be met within such a step, elastic variables with a large weight take
up the rest: "at initial iterations the trajectory is forced to satisfy (8) and (9), and
then the proper minimization of the functional (10) follows".
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.linear_programs import LpSolver
from tominpmp.linear_programs.program import LinearProgram
from tominpmp.options import Options
from tominpmp.solvers.callbacks import Callback, Keep, go_on, keep_nothing
from tominpmp.solvers.iterate import Effort, Iterate, SlpResult
from tominpmp.solvers.merit import Merit
from tominpmp.solvers.trust_region import TrustRegion
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import check
from tominpmp.transcription.adjoint import AdjointTranscription
from tominpmp.transcription.base import Linearization, StepBounds
from tominpmp.transcription.program import NonlinearProgram

# Weight of the elastic variables, in shares of T; far above the multipliers, so that
# violations are reduced as fast as the steps allow before the duration counts.
ELASTIC_WEIGHT = 10.0
# The iteration ends when T has varied by less than this share over a window.
SETTLED = 1e-6
WINDOW = 20


@dataclass(frozen=True, eq=False)
class PaperSolver:
    """The paper's fixed-step iteration on the adjoint transcription.

    Attributes:
        nlp: The nonlinear program.
        options: ``control_step`` (rho), ``time_step`` (epsilon), limits and tolerances.
        lp: Solver of the linear programs.
        callback: Sees every record; a status ends the iteration.
        keep: Is given the best motion so far, or the present one.
    """

    nlp: NonlinearProgram
    options: Options
    lp: LpSolver
    callback: Callback = go_on
    keep: Keep = keep_nothing

    def run(self, z: Array) -> SlpResult:
        """Iterate from a start until the duration no longer changes.

        Args:
            z: Initial torques and duration, the paper's u^0 and T^0.

        Raises:
            Stop: If it was told to; what it had is kept.
        """
        begin = time.perf_counter()
        iterate, solver = self.init(z), self
        self.keep(self.nlp, iterate)
        best: Iterate | None = None
        history: list[IterationRecord] = []
        status: Status | None = None
        while status is None:
            check()
            effort = Effort()
            solver = replace(solver, nlp=solver.nlp.near(iterate.z))
            following = solver.step(iterate, effort)
            if following is None:
                status = Status.NUMERICAL_FAILURE
                break
            iterate = following
            best = iterate.better_than(best, self.options.feasibility)
            self.keep(self.nlp, best or iterate)
            record = self.record(len(history), iterate, effort, begin)
            history.append(record)
            status = self.terminate(history) or self.callback(record)
        return SlpResult(status, iterate, best, tuple(history))

    def init(self, z: Array) -> Iterate:
        """Iterate at the start."""
        nlp = self.nlp
        weights = np.full(len(nlp.rows.kinds), ELASTIC_WEIGHT * float(nlp.cost @ z))
        merit = Merit(nlp.cost, nlp.rows, 0.0, weights)
        return Iterate(
            z, nlp.evaluate(z), merit, TrustRegion(), np.zeros(nlp.rows.size)
        )

    def step(self, iterate: Iterate, effort: Effort) -> Iterate | None:
        """One linear program, its step taken; None if it could not be solved."""
        nlp, z, options = self.nlp, iterate.z, self.options
        torques = nlp.transcription
        assert isinstance(torques, AdjointTranscription)  # noqa: S101
        steps = torques.fixed_steps(z, options.control_step, options.time_step)
        linearization = nlp.linearize(z, iterate.values, steps)
        program = _build_program(iterate.merit, iterate.values, linearization, steps)
        solution = effort.add(self.lp.solve(program))
        if not solution.optimal:
            return None
        z = z + solution.x[: z.size]
        multipliers = np.zeros(nlp.rows.size)
        multipliers[linearization.rows] = solution.row_duals
        return replace(iterate, z=z, values=nlp.evaluate(z), multipliers=multipliers)

    def terminate(self, history: list[IterationRecord]) -> Status | None:
        """Status if the iteration is to end, else None."""
        last = history[-WINDOW:]
        if len(last) == WINDOW and last[-1].violation <= self.options.feasibility:
            durations = [record.duration for record in last]
            if max(durations) - min(durations) < SETTLED * durations[-1]:
                return Status.CONVERGED
        if len(history) >= self.options.max_iterations:
            return Status.ITERATION_LIMIT
        return None

    def record(
        self, number: int, iterate: Iterate, effort: Effort, begin: float
    ) -> IterationRecord:
        """Record of an iteration."""
        merit = iterate.merit(iterate.z, iterate.values, None)
        return IterationRecord(
            iteration=number,
            duration=iterate.duration,
            violation=iterate.violation,
            objective=merit,
            predicted=0.0,
            actual=0.0,
            radius=1.0,
            accepted=True,
            programs=effort.programs,
            pivots=effort.pivots,
            program_seconds=effort.seconds,
            seconds=time.perf_counter() - begin,
        )


def _build_program(
    merit: Merit, values: Array, linearization: Linearization, steps: StepBounds
) -> LinearProgram:
    """The linear program (14)-(15) with an elastic variable for each constraint.

    Args:
        merit: Objective, and weights of the elastic variables.
        values: Row values, shape (m,).
        linearization: Jacobian of the rows of the program.
        steps: Box for the step.
    """
    rows, chosen = merit.rows, linearization.rows
    here, group = values[chosen], rows.group[chosen]
    low, high = rows.lower[chosen] - here, rows.upper[chosen] - here
    # Elastic variables, one upwards and one downwards: for each equation, and for each
    # path constraint at all of its instants.
    equation = low == high
    column = np.where(equation, chosen, rows.size + group)
    used, column = np.unique(column, return_inverse=True)
    shape = (chosen.size, used.size)
    index = np.arange(chosen.size)
    ones = np.ones(chosen.size)
    over = sp.csr_matrix((-ones, (index, column)), shape=shape)
    under = sp.csr_matrix((ones, (index, column)), shape=shape)
    weights = np.zeros(used.size)
    weights[column] = merit.weights[rows.kind[chosen]]
    count = used.size
    size = steps.lower.size
    keys = np.concatenate([np.arange(size), size + used, size + 2 * rows.size + used])
    return LinearProgram(
        np.concatenate([merit.cost, weights, weights]),
        sp.hstack([linearization.matrix, over, under], format="csc"),
        low,
        high,
        np.concatenate([steps.lower, np.zeros(2 * count)]),
        np.concatenate([steps.upper, np.full(2 * count, np.inf)]),
        chosen,
        keys,
    )
