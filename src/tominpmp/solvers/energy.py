r"""Time against energy: the least of T + k times an energy.

.. math:: \min \; T + k \int_0^T |u(t)|^2 \, dt \quad \text{or} \quad
    \min \; T + k \int_0^T \sum_i \max(u_i \dot q_i, 0) \, dt

Each step is one of a convex quadratic program, whose model of the energy is that of
:mod:`~tominpmp.solvers.energy_measures`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.linear_programs.program import LinearProgram
from tominpmp.options import Options
from tominpmp.solvers.energy_measures import (
    EnergyModel,
    Terms,
    energy_measure,
)
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.solvers.quadratic import (
    QuadraticProgram,
    first_iterate,
    iterate,
    take_step,
)
from tominpmp.solvers.subproblem import Subproblem, build_subproblem
from tominpmp.transcription.base import StepBounds
from tominpmp.transcription.program import NonlinearProgram

# Weight of violations before any multiplier is known, in shares of the objective.
FIRST_WEIGHT = 10.0
# Share of the objective that further steps are not worth their time for.
SETTLED = 1e-6
# Share of the work that a step as long as the trust region costs in each unknown.
TRACE = 1e-7
# Keys of the rows and columns of kinks begin here.
KINK_KEYS = 1_000_000_000


@dataclass(frozen=True, eq=False)
class EnergySolver:
    """Sequential quadratic programming for time against energy.

    Attributes:
        nlp: The nonlinear program.
        options: Tolerances, limits and the trust region.
        weight: Weight k of the energy [1/(N^2 m^2) or s/J].
        over: Tells whether the time is up.
    """

    nlp: NonlinearProgram
    options: Options
    weight: float
    over: Callable[[], bool] = field(default=lambda: False)

    def run(self, z: Array) -> SlpResult:
        """Iterate until nothing more is to be had.

        Args:
            z: Where to begin.

        Returns:
            The outcome; the best iterate is that of the least objective that keeps all
            constraints.
        """
        return iterate(
            self.init(z),
            self.step,
            lambda state: self.objective(state.z),
            self.options,
            self.over,
            SETTLED,
        )

    def init(self, z: Array) -> Iterate:
        """State at the start."""
        weight = FIRST_WEIGHT * self.objective(z)
        return first_iterate(self.nlp, z, self.nlp.cost, weight)

    def objective(self, z: Array) -> float:
        """T + k times the energy [s]; infinite for no motion."""
        if not self.nlp.transcription.motion(z).finite:
            return np.inf
        energy = energy_measure(self.nlp, self.options.energy)
        return float(self.nlp.cost @ z) + self.weight * energy(z)

    def step(self, state: Iterate) -> tuple[Iterate, float]:
        """One iteration: linearise, solve, correct, search, accept or shrink.

        Returns:
            The next state, and by how much the program promised to lower the merit.
        """
        nlp, z, values = self.nlp, state.z, state.values
        bounds = nlp.step_bounds(z, self.options.trust_region * state.region.radius)
        linearization = nlp.linearize(z, values, bounds)
        # What the linearised rows lack holds motions on curved limits to short steps.
        root = nlp.curvature(z, state.multipliers)
        frame = build_subproblem(
            state.merit, values, linearization, bounds, None, z, root
        )
        energy = energy_measure(nlp, self.options.energy).model(z)
        here = float(nlp.cost @ z) + self.weight * energy.value
        return take_step(
            nlp,
            state,
            self._with_energy(frame, energy, bounds),
            here,
            lambda z, _: self.objective(z),
            lambda step: (
                here
                + float(nlp.cost @ step)
                + self.weight * energy.change(step)
                + frame.bend(step)
            ),
            self.options.feasibility,
        )

    def _with_energy(
        self, frame: Subproblem, energy: EnergyModel, bounds: StepBounds
    ) -> QuadraticProgram:
        """The program with the energy in its objective."""
        program, free = frame.program, frame.free
        gradient = energy.gradient
        if energy.kinks is not None:
            slope, kinks = _sorted_out(energy.kinks, bounds)
            gradient = gradient + slope
            program = _with_kinks(program, free, kinks, self.weight)
        cost = program.cost.copy()
        cost[: free.size] += self.weight * gradient[free]
        of_step = self.weight * energy.curvature[free][:, free]
        if frame.program.curvature is not None:
            of_step = of_step + frame.program.curvature[: free.size, : free.size]
        if energy.kinks is not None:
            # A trace of curvature for what is free to be anything.
            box = np.maximum(bounds.upper, -bounds.lower)[free]
            of_step = of_step + sp.diags(TRACE * self.weight * energy.value / box**2)
        rest = program.cost.size - free.size
        curvature = sp.block_diag([of_step, sp.csc_matrix((rest, rest))], format="csc")
        return QuadraticProgram(frame, replace(program, cost=cost), curvature)


def _sorted_out(kinks: Terms, bounds: StepBounds) -> tuple[Array, Terms]:
    """Terms that no step of a box brings to zero, as a gradient, and the others."""
    reach = abs(kinks.jacobian) @ np.maximum(bounds.upper, -bounds.lower)
    spent = kinks.values > reach
    near = np.abs(kinks.values) <= reach
    slope = np.asarray(kinks.jacobian[spent].sum(axis=0)).ravel()
    return slope, Terms(kinks.values[near], sp.csr_matrix(kinks.jacobian[near]))


def _with_kinks(
    program: LinearProgram, free: IntArray, kinks: Terms, weight: float
) -> LinearProgram:
    """A program with a variable s >= 0 for each kink, which is no less than its p."""
    count, (rows, columns) = kinks.values.size, program.matrix.shape
    if not count:
        return program
    beside = sp.csr_matrix((count, columns - free.size))
    below = [kinks.jacobian[:, free], beside, -sp.identity(count)]
    above = [program.matrix, sp.csr_matrix((rows, count))]
    keys = KINK_KEYS + np.arange(count)
    return replace(
        program,
        cost=np.concatenate([program.cost, np.full(count, weight)]),
        matrix=sp.vstack([sp.hstack(above), sp.hstack(below)], format="csc"),
        row_lower=np.concatenate([program.row_lower, np.full(count, -np.inf)]),
        row_upper=np.concatenate([program.row_upper, -kinks.values]),
        lower=np.concatenate([program.lower, np.zeros(count)]),
        upper=np.concatenate([program.upper, np.full(count, np.inf)]),
        row_keys=np.concatenate([program.row_keys, keys]),
        column_keys=np.concatenate([program.column_keys, keys]),
    )
