r"""Quiet torques and straight ways in a given time.

The least of two sums of squares is looked for, each in shares of what it was:

- torque variation, the squared differences of neighbouring torques,

  .. math:: \sum_k \frac{\bar d}{d_k} |u_{k+1} - u_k|^2

  over a sequence of torques u_k, in full ranges, a time d_k apart: the mean torques of
  the intervals, where torques jump between these, or those at nodes and middles; dbar
  is the mean of the d_k, so that the sum does not depend on how the grid is spaced;

- with a small weight mean speeds, the squares of the speeds that take a motion from
  node to node,

  .. math:: \frac{1}{T} \sum_k h_k
      \left| \frac{q_{k+1} - q_k}{h_k \, \hat v} \right|^2

  of all joints, in shares of their limits v, which is least for joints that go
  straight, each at one speed. Torques do not tell: a light joint may go to and fro for
  next to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.constraints.base import Partials
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.model import Model
from tominpmp.solvers.objective import Objective
from tominpmp.transcription.base import Linearization, StepBounds, Variation
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.program import NonlinearProgram

# Further steps are not worth their time for this share of the objective.
SETTLED = 5e-3
# Residuals of what does not vary at all are measured against this.
LEAST_NORM = 1e-6
# Weight of the mean speeds beside the torque variation. A third of it leaves half as
# much again of the ways beyond the straight ones; three times as much makes torques
# less quiet by a sixth (24 goals of four arms).
SPEED_WEIGHT = 0.1


@dataclass(frozen=True, eq=False)
class QuietTorques(Objective):
    """Half the sum of both squares: (1 + the weight of the speeds) / 2 at first.

    Attributes:
        times: Instants of the sequence of torques as shares of T, shape (k,).
        torque_norm: What the differences of torques are measured against.
        speeds: Mean speeds in their shares, linear in the unknowns.
    """

    times: Array
    torque_norm: float
    speeds: Variation

    @classmethod
    def of(cls, nlp: NonlinearProgram, z: Array, feasibility: float) -> QuietTorques:
        """The objective for the time of an iterate.

        Args:
            nlp: The nonlinear program.
            z: Its iterate.
            feasibility: Largest violation that is let pass.
        """
        times = nlp.transcription.sequence_times(z)
        torques, _ = _differences(nlp, times, z, nlp.evaluate(z))
        speeds = mean_speeds(nlp, z)
        norm = _norm(speeds.at(z)) / np.sqrt(SPEED_WEIGHT)
        speeds = Variation(speeds.matrix / norm, speeds.offset / norm)
        return cls(SETTLED, feasibility, times, _norm(torques), speeds)

    def value(self, program: NonlinearProgram, z: Array, values: Array) -> float:
        """Half the sum of the squares."""
        torques, _ = _differences(program, self.times, z, values)
        residuals = self._residuals(z, torques)
        return 0.5 * float(residuals @ residuals)

    def model(
        self,
        program: NonlinearProgram,
        state: Iterate,
        steps: StepBounds,
        linearization: Linearization,
    ) -> Model:
        """The squares of residuals that are linear near an iterate."""
        z, times = state.z, self.times
        torques, matrix = _differences(program, times, z, state.values, linearization)
        parts = [matrix / self.torque_norm, self.speeds.matrix]
        root = sp.vstack(parts, format="csr")
        return Model(
            lambda z, values: self.value(program, z, values),
            np.asarray(root.T @ self._residuals(z, torques)),
            root,
        )

    def _residuals(self, z: Array, torques: Array) -> Array:
        return np.concatenate([torques / self.torque_norm, self.speeds.at(z)])

    def within(self, program: NonlinearProgram, steps: StepBounds) -> StepBounds:
        """The time stays as it is."""
        timed = program.cost != 0.0
        return StepBounds(*(np.where(timed, 0.0, bound) for bound in steps))

    def restorable(self, program: NonlinearProgram, state: Iterate) -> bool:
        """Whether there are no violations: the time is given."""
        return state.violation <= self.feasibility

    def restored(self, program: NonlinearProgram, state: Iterate) -> Iterate:
        """The motion as it is."""
        return state


def _differences(
    nlp: NonlinearProgram,
    times: Array,
    z: Array,
    values: Array,
    linearization: Linearization | None = None,
) -> tuple[Array, sp.csr_matrix]:
    """Weighted differences of neighbouring torques, and their Jacobian.

    Args:
        nlp: The nonlinear program.
        times: Instants of the sequence of torques as shares of T, shape (k,).
        z: Unknowns.
        values: Row values there.
        linearization: Jacobian of the rows, those of all torques among them in order;
            None where the Jacobian of the differences is not asked for.
    """
    weights = np.sqrt(np.diff(times).mean() / np.diff(times))
    sequence, n = nlp.transcription.torque_sequence, nlp.system.n
    if sequence is None:  # torques are unknowns
        jumps = nlp.variation(z).matrix
        each = np.repeat(weights, jumps.shape[0] // weights.size)
        matrix = sp.csr_matrix(sp.diags(each) @ jumps)
        return np.asarray(matrix @ z), matrix
    rows = np.flatnonzero(nlp.rows.kind == nlp.rows.kinds.index("torque"))
    count = sequence.shape[0]
    # Torques at instants that have become rows later on are not compared.
    later = rows.size // n - sequence.shape[1]
    sequence = sp.hstack([sequence, sp.csr_matrix((count, later))])
    # Rows are in half ranges.
    steps = sp.diags([-0.5, 0.5], [0, 1], shape=(count - 1, count))
    weighted = sp.diags(weights) @ steps @ sequence
    of_rows = sp.csr_matrix(sp.kron(weighted, sp.identity(n)))
    differences = np.asarray(of_rows @ values[rows])
    if linearization is None:
        return differences, of_rows
    mine = np.isin(linearization.rows, rows)
    return differences, sp.csr_matrix(of_rows @ linearization.matrix[mine])


def mean_speeds(nlp: NonlinearProgram, z: Array) -> Variation:
    """Weighted mean speeds of all joints between nodes, as a linear function near z.

    It is exact, as the duration is fixed. Speeds are in shares of their limits, or of
    the highest where there are none.

    Args:
        nlp: The nonlinear program.
        z: Its iterate.
    """
    of, n, count = nlp.transcription, nlp.system.n, nlp.transcription.intervals
    motion = of.motion(z)
    middles = Instants.spread(count, (0.5,))
    highest = np.abs(of.states(motion, middles, 1).v).max(axis=0)
    limits = nlp.system.problem.robot.limits.velocity
    scale = np.where(np.isfinite(limits), limits, highest)
    # What does not move at all gets no infinite weight.
    scale = np.maximum(scale, 1e-3 * max(float(scale.max()), 1e-3))
    nodes = Instants.nodes(count)
    node = np.repeat(np.arange(count + 1), n)
    each = Partials(node, by_q=np.tile(np.eye(n), (count + 1, 1)))
    steps = sp.diags([-1.0, 1.0], [0, 1], shape=(count, count + 1))
    weights = 1.0 / np.sqrt(motion.h * np.sum(motion.h))
    speeds = sp.csr_matrix(sp.kron(sp.diags(weights) @ steps, sp.diags(1.0 / scale)))
    matrix = sp.csr_matrix(speeds @ of.pull_back(motion, nodes, each))
    q = of.states(motion, nodes, 0).q
    return Variation(matrix, speeds @ q.ravel() - matrix @ z)


def _norm(residuals: Array) -> float:
    return max(float(np.linalg.norm(residuals)), LEAST_NORM)
