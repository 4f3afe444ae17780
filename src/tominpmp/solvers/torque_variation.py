r"""Least torque variation for a given duration: the second stage of a plan.

With T fixed the squared differences of neighbouring torques are minimised:

.. math:: \min \sum_k \frac{\bar d}{d_k} |u_{k+1} - u_k|^2

over a sequence of torques u_k, in full ranges, a time d_k apart: the mean torques of
the intervals, where torques jump between these, or those at nodes and middles; dbar is
the mean of the d_k, so that the sum does not depend on how the grid is spaced. Torques
and rows are linearised and the quadratic program is solved; steps are taken as in
:mod:`tominpmp.solvers.slp`, of which this is the counterpart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.options import Options
from tominpmp.program_records import LinearProgram
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.solvers.quadratic import (
    QuadraticProgram,
    first_iterate,
    iterate,
    take_step,
)
from tominpmp.solvers.subproblem import Subproblem, build_subproblem
from tominpmp.transcription.base import Linearization, Variation
from tominpmp.transcription.program import NonlinearProgram

# Weight of violations before any multiplier is known; the objective begins at 1/2.
FIRST_WEIGHT = 10.0
# Share of the objective that further steps are not worth their time for.
SETTLED = 5e-3
# Residuals of motions whose torques do not vary at all are measured against this.
LEAST_NORM = 1e-6


@dataclass(frozen=True, eq=False)
class TorqueVariationSolver:
    """Sequential quadratic programming on any transcription, with T fixed.

    Attributes:
        nlp: The nonlinear program.
        options: Tolerances, limits and the trust region.
        times: Instants of the sequence of torques as shares of T, shape (k,).
        over: Tells whether the time is up.
    """

    nlp: NonlinearProgram
    options: Options
    times: Array
    over: Callable[[], bool] = field(default=lambda: False)

    def run(self, z: Array) -> SlpResult:
        """Iterate until nothing more is to be had.

        Args:
            z: Where to begin; its duration is kept.

        Returns:
            The outcome; the best iterate is the one of least torque variation that
            keeps all constraints.
        """
        state = first_iterate(self.nlp, z, np.zeros(z.size), FIRST_WEIGHT)
        norm = max(
            float(np.linalg.norm(self.torque_differences(z, state.values))), LEAST_NORM
        )
        return iterate(
            state,
            lambda state: self.step(state, norm),
            lambda state: self.cost(state.z, state.values, norm),
            self.options,
            self.over,
            SETTLED,
        )

    def step(self, state: Iterate, norm: float) -> tuple[Iterate, float]:
        """One iteration: linearise, solve, correct, search, accept or shrink.

        Returns:
            The next state, and by how much the program promised to lower the merit.
        """
        nlp, z, values = self.nlp, state.z, state.values
        radius = self.options.trust_region * state.region.radius
        bounds = nlp.step_bounds(z, radius)
        timed = nlp.cost != 0.0
        bounds = bounds._replace(
            lower=np.where(timed, 0.0, bounds.lower),
            upper=np.where(timed, 0.0, bounds.upper),
        )
        linearization = nlp.linearize(z, values, bounds)
        frame = build_subproblem(state.merit, values, linearization, bounds, None, z)
        differences = self.linearized(z, values, linearization)

        def model(step: Array) -> float:
            residual = differences.matrix @ (z + step) + differences.offset
            return 0.5 * float(residual @ residual) / norm**2

        return take_step(
            nlp,
            state,
            _with_squares(frame, differences, z, norm),
            self.cost(z, values, norm),
            lambda z, values: self.cost(z, values, norm),
            model,
            self.options.feasibility,
        )

    # -- torque variation --------------------------------------------------------------

    def torque_differences(self, z: Array, values: Array) -> Array:
        """Weighted differences of neighbouring torques in full ranges."""
        torques = self._of_torques
        if torques is None:
            variation = self.nlp.variation(z)
            return np.asarray(self._of_jumps(variation) @ z)
        return np.asarray(torques @ values[self._torque_rows])

    def linearized(
        self, z: Array, values: Array, linearization: Linearization
    ) -> Variation:
        """The same as a linear function near z."""
        torques = self._of_torques
        if torques is None:
            matrix = self._of_jumps(self.nlp.variation(z))
            return Variation(matrix, np.zeros(matrix.shape[0]))
        # All torque rows are linearised, in order.
        among = np.isin(linearization.rows, self._torque_rows)
        matrix = sp.csr_matrix(torques @ linearization.matrix[among])
        return Variation(matrix, self.torque_differences(z, values) - matrix @ z)

    @cached_property
    def _torque_rows(self) -> IntArray:
        rows = self.nlp.rows
        return np.flatnonzero(rows.kind == rows.kinds.index("torque"))

    @cached_property
    def _weights(self) -> Array:
        """Square roots of mean distance over distance, shape (k - 1,)."""
        apart = np.diff(self.times)
        return np.asarray(np.sqrt(apart.mean() / apart))

    @cached_property
    def _of_torques(self) -> sp.csr_matrix | None:
        """Differences from the torque rows; None where torques are unknowns."""
        sequence = self.nlp.transcription.torque_sequence
        if sequence is None:
            return None
        count, n = sequence.shape[0], self.nlp.system.n
        # Torques at instants that have become rows later on are not compared.
        later = self._torque_rows.size // n - sequence.shape[1]
        sequence = sp.hstack([sequence, sp.csr_matrix((count, later))])
        # Rows are in half ranges.
        jumps = sp.diags([-0.5, 0.5], [0, 1], shape=(count - 1, count))
        return sp.csr_matrix(
            sp.kron(sp.diags(self._weights) @ jumps @ sequence, sp.identity(n))
        )

    def _of_jumps(self, variation: Variation) -> sp.csr_matrix:
        """Differences from unknown torques."""
        joints = variation.matrix.shape[0] // self._weights.size
        return sp.csr_matrix(
            sp.diags(np.repeat(self._weights, joints)) @ variation.matrix
        )

    def cost(self, z: Array, values: Array, norm: float) -> float:
        """Objective: 1/2 at the start."""
        return 0.5 * float(np.sum(self.torque_differences(z, values) ** 2)) / norm**2


def _with_squares(
    frame: Subproblem, differences: Variation, z: Array, norm: float
) -> QuadraticProgram:
    """Program with columns y for the residuals, whose squares are the objective."""
    program, count = frame.program, differences.offset.size
    columns = program.cost.size
    residual = (differences.matrix @ z + differences.offset) / norm
    by_step = sp.csr_matrix(differences.matrix[:, frame.free] / norm)
    spare = sp.csr_matrix((count, columns - frame.free.size))
    matrix = sp.bmat(
        [[program.matrix, None], [sp.hstack([by_step, spare]), -sp.identity(count)]],
        format="csc",
    )
    none = np.full(count, np.inf)
    keys = np.arange(columns + count)
    wide = LinearProgram(
        np.concatenate([program.cost, np.zeros(count)]),
        matrix,
        np.concatenate([program.row_lower, -residual]),
        np.concatenate([program.row_upper, -residual]),
        np.concatenate([program.lower, -none]),
        np.concatenate([program.upper, none]),
        np.arange(matrix.shape[0]),
        keys,
    )
    squares = np.concatenate([np.zeros(columns), np.ones(count)])
    return QuadraticProgram(frame, wide, sp.csc_matrix(sp.diags(squares)))
