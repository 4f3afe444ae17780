r"""The paper's iteration, unchanged: fixed steps, each of which is accepted.

At torques u and duration T the linear program (equations 14 and 15)

.. math::
    \min \; T + \delta T \quad s.t. \quad g + \delta g = 0, \quad
    h + \delta h \le 0, \quad u_l \le u + \delta u \le u_u, \\
    |\delta u| \le \rho, \quad |\delta T| \le \epsilon, \quad 0 \le T + \delta T

is solved, with rows for the goal g and for path constraints h at the active instants S,
and the step is always accepted. As long as the linearised equations cannot be satisfied
within one step, elastic variables with a large weight take up the residual: "at initial
iterations the trajectory is forced to satisfy (8) and (9), and then the proper
minimization of the functional (10) follows".
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from tominpmp.linear_programs.choice import make_solver
from tominpmp.linear_programs.program import LinearProgram
from tominpmp.linear_programs.solver import LpSolver
from tominpmp.options import Options
from tominpmp.solvers.iterate import HIGH_WEIGHT, Iterate, StepOutcome, TrialPoint
from tominpmp.solvers.loop import Loop, Rule, collapsed, first_of, iterations
from tominpmp.status import Status
from tominpmp.stopping import check
from tominpmp.transcription.adjoint import AdjointTranscription
from tominpmp.transcription.base import Linearization

# The iteration ends when T has varied by less than this share over a window.
SETTLED = 1e-6
WINDOW = 20


def fixed_steps(options: Options) -> tuple[FixedStep, Rule]:
    """The paper's steps, and their stop rule.

    Args:
        options: Options with the step lengths, the solver and the iteration limit.
    """
    lp = make_solver(options.lp_solver)
    step = FixedStep(lp, options.control_step, options.time_step)
    limits = collapsed, iterations(options.max_iterations)
    return step, first_of(_steady, *limits)


def _steady(loop: Loop) -> Status | None:
    """CONVERGED if the duration has hardly changed over a window of iterations."""
    last = [record.duration for record in loop.history[-WINDOW:]]
    if len(last) < WINDOW or loop.state.violation > loop.objective.feasibility:
        return None
    steady = max(last) - min(last) < SETTLED * last[-1]
    return Status.CONVERGED if steady else None


@dataclass(frozen=True, eq=False)
class FixedStep:
    """The paper's step of fixed length on the adjoint transcription.

    Attributes:
        lp: Solver of the linear programs.
        control_step: Largest change rho of a torque [N m or N].
        time_step: Largest change epsilon of the duration [s].
    """

    lp: LpSolver
    control_step: float
    time_step: float

    def first_weight(self, kind: str) -> float:
        """The weight of all elastic variables, which remains unchanged."""
        return HIGH_WEIGHT

    def __call__(self, loop: Loop) -> None:
        """Solve one linear program, and accept its step."""
        check()
        nlp, state = loop.program, loop.state
        torques, z = nlp.transcription, state.z
        assert isinstance(torques, AdjointTranscription)  # noqa: S101
        steps = torques.fixed_steps(z, self.control_step, self.time_step)
        linearization = nlp.linearize(z, state.values, steps)
        program, begin = _build_program(state, linearization), time.perf_counter()
        solution = loop.count(self.lp.solve(program), begin)
        if not solution.optimal:
            loop.advance(replace(state, radius=0.0), None)
            return
        z = z + solution.x[: z.size]
        values = nlp.evaluate(z)
        multipliers = np.zeros(nlp.rows.size)
        multipliers[linearization.rows] = solution.row_duals
        trial = TrialPoint(z, values, float(nlp.cost @ z) + state.penalty(values))
        state = replace(state, z=z, values=values, multipliers=multipliers)
        loop.advance(state, StepOutcome(trial, 0.0, 0.0, 0.0, True))


def _build_program(state: Iterate, linearization: Linearization) -> LinearProgram:
    """The linear program (14)-(15), with elastic variables for each constraint.

    Args:
        state: The iterate, with the weights of the elastic variables.
        linearization: Jacobian of the rows of the program, with the box for the step.
    """
    rows, (chosen, matrix, steps, _) = state.rows, linearization
    here, group = state.values[chosen], rows.group[chosen]
    low, high = rows.lower[chosen] - here, rows.upper[chosen] - here
    # A pair of elastic variables, upwards and downwards, for each equation, and one for
    # each path constraint, common to all of its instants.
    equation = low == high
    column = np.where(equation, chosen, rows.size + group)
    used, column = np.unique(column, return_inverse=True)
    shape = (chosen.size, used.size)
    places = np.arange(chosen.size), column
    under = sp.csr_matrix((np.ones(chosen.size), places), shape=shape)
    weights = np.zeros(used.size)
    weights[column] = state.weights[rows.kind[chosen]]
    count = used.size
    return LinearProgram(
        sp.hstack([matrix, -under, under], format="csc"),
        np.concatenate([state.cost, weights, weights]),
        np.concatenate([steps.lower, np.zeros(2 * count)]),
        np.concatenate([steps.upper, np.full(2 * count, np.inf)]),
        low,
        high,
    )
