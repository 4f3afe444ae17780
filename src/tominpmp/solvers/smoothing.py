"""Smoothing: quiet torques and straight ways for a given duration.

With T fixed the least of torque variation and mean speeds is looked for, each in shares
of what it was, the latter with a small weight. Torques and rows are linearised and the
quadratic program is solved; steps are taken as in :mod:`tominpmp.solvers.slp`, of which
this is the counterpart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.linear_programs.program import LinearProgram
from tominpmp.options import Options
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.solvers.mean_speeds import MeanSpeeds
from tominpmp.solvers.quadratic import (
    QuadraticProgram,
    first_iterate,
    iterate,
    take_step,
)
from tominpmp.solvers.subproblem import Subproblem, build_subproblem
from tominpmp.solvers.torque_variation import TorqueVariation
from tominpmp.transcription.base import Variation
from tominpmp.transcription.program import NonlinearProgram

# Weight of violations before any multiplier is known; the objective begins at 1/2.
FIRST_WEIGHT = 10.0
# Share of the objective that further steps are not worth their time for.
SETTLED = 5e-3
# Residuals of what does not vary at all are measured against this.
LEAST_NORM = 1e-6
# Weight of the mean speeds beside the torque variation. A third of it leaves half as
# much again of the ways beyond the straight ones; three times as much makes torques
# less quiet by a sixth (24 goals of four arms).
SPEED_WEIGHT = 0.1


@dataclass(frozen=True, eq=False)
class SmoothingSolver:
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
            The outcome; the best iterate is the one of the least objective that keeps
            all constraints.
        """
        state = first_iterate(self.nlp, z, np.zeros(z.size), FIRST_WEIGHT)
        torques = TorqueVariation(self.nlp, self.times)
        speeds = MeanSpeeds.of(self.nlp, z).linearized(z)
        objective = SmoothingObjective(
            torques,
            speeds,
            _norm(torques.differences(z, state.values)),
            _norm(speeds.matrix @ z + speeds.offset) / np.sqrt(SPEED_WEIGHT),
        )
        return iterate(
            state,
            lambda state: self.step(state, objective),
            lambda state: objective.of(state.z, state.values),
            self.options,
            self.over,
            SETTLED,
        )

    def step(
        self, state: Iterate, objective: SmoothingObjective
    ) -> tuple[Iterate, float]:
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
        torques = objective.torques.linearized(z, values, linearization)
        residuals = objective.residuals(torques)
        return take_step(
            nlp,
            state,
            _with_squares(frame, residuals, z),
            objective.of(z, values),
            objective.of,
            lambda step: 0.5 * _squares(residuals, z + step),
            self.options.feasibility,
        )


@dataclass(frozen=True, eq=False)
class SmoothingObjective:
    """What is to be least: torque variation and mean speeds.

    Attributes:
        torques: Differences of torques.
        speeds: Mean speeds, linear in the unknowns.
        torque_norm: What the differences are measured against.
        speed_norm: What the speeds are.
    """

    torques: TorqueVariation
    speeds: Variation
    torque_norm: float
    speed_norm: float

    def of(self, z: Array, values: Array) -> float:
        """Half the sum of the squares: (1 + the weight of the speeds) / 2 at first."""
        differences = self.torques.differences(z, values) / self.torque_norm
        speeds = _squares(self.speeds, z) / self.speed_norm**2
        return 0.5 * float(differences @ differences + speeds)

    def residuals(self, torques: Variation) -> Variation:
        """All residuals as a linear function, from that of the torques."""
        parts = ((torques, self.torque_norm), (self.speeds, self.speed_norm))
        return Variation(
            sp.vstack([part.matrix / norm for part, norm in parts], format="csr"),
            np.concatenate([part.offset / norm for part, norm in parts]),
        )


def _squares(residuals: Variation, z: Array) -> float:
    """Sum of the squared residuals."""
    return float(np.sum((residuals.matrix @ z + residuals.offset) ** 2))


def _norm(residuals: Array) -> float:
    return max(float(np.linalg.norm(residuals)), LEAST_NORM)


def _with_squares(
    frame: Subproblem, residuals: Variation, z: Array
) -> QuadraticProgram:
    """Program with columns y for the residuals, whose squares are the objective."""
    program, count = frame.program, residuals.offset.size
    columns = program.cost.size
    known = residuals.matrix @ z + residuals.offset
    by_step = sp.csr_matrix(residuals.matrix[:, frame.free])
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
        np.concatenate([program.row_lower, -known]),
        np.concatenate([program.row_upper, -known]),
        np.concatenate([program.lower, -none]),
        np.concatenate([program.upper, none]),
        np.arange(matrix.shape[0]),
        keys,
    )
    squares = np.concatenate([np.zeros(columns), np.ones(count)])
    return QuadraticProgram(frame, wide, sp.csc_matrix(sp.diags(squares)))
