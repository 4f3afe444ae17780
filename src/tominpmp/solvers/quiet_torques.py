r"""Quiet torques and straight joint paths in a given time.

The objective adds two sums of squares, each divided by its initial value:

- torque variation, the squared differences of neighbouring torques,

  .. math:: \sum_k |u_{k+1} - u_k|^2

  over a sequence of torques u_k, in shares of their ranges: the mean torques of the
  intervals if torques jump between these, otherwise the torques at nodes and at
  midpoints of intervals. Jumps count alike wherever they are: divided by the distances
  in time, those between the short intervals at both ends would rule the sum;

- with a small weight, mean speeds between nodes,

  .. math:: \frac{1}{T} \sum_k h_k
      \left| \frac{q_{k+1} - q_k}{h_k \, \hat v} \right|^2

  of all joints, in shares of their limits v. This sum is least for joints that move
  straight at a constant speed. The torque variation alone does not ensure that: a light
  joint may move to and fro at negligible torques.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import Partials
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.objective import Model, Objective
from tominpmp.transcription.base import Linearization, StepBounds, Variation
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.program import NonlinearProgram

# Relative reduction of the objective below which progress has settled.
SETTLED = 5e-3
# Least norm that residuals are divided by, for quantities that do not vary at all.
LEAST_NORM = 1e-6
# Weight of the mean speeds relative to the torque variation. With a third of it the
# detours of joints are twice as long, and torques are quieter by a tenth at most (40
# goals of five arms, benchmarks/smoothing.py).
SPEED_WEIGHT = 0.3


@dataclass(frozen=True, eq=False)
class QuietTorques(Objective):
    """Half the sum of both squares; initially (1 + the weight of the speeds) / 2.

    Attributes:
        differences: Matrix to the weighted differences of neighbouring torques: from
            the unknowns if these are torques, otherwise from the rows of the torques.
        torque_norm: Initial norm of the torque differences, by which they are divided.
        speeds: Weighted mean speeds, linear in the unknowns.
    """

    differences: sp.csr_matrix
    torque_norm: float
    speeds: Variation

    @classmethod
    def of(cls, nlp: NonlinearProgram, z: Array, feasibility: float) -> QuietTorques:
        """The objective for the time of an iterate.

        Args:
            nlp: The nonlinear program.
            z: Its iterate.
            feasibility: Largest tolerated violation.
        """
        scheme, speeds = nlp.transcription, mean_speeds(nlp, z)
        norm = _norm(speeds.at(z)) / np.sqrt(SPEED_WEIGHT)
        speeds = Variation(speeds.matrix / norm, speeds.offset / norm)
        sequence = scheme.torque_sequence
        if sequence is None:  # torques are unknowns
            differences = scheme.variation(z).matrix
        else:
            # Torque rows are in shares of half their ranges.
            steps = 0.5 * (sequence[1:] - sequence[:-1])
            differences = sp.csr_matrix(sp.kron(steps, sp.identity(nlp.system.n)))
        whole = cls(SETTLED, feasibility, differences, 1.0, speeds)
        torques = differences @ whole._torques(nlp, z, nlp.evaluate(z))
        return replace(whole, torque_norm=_norm(torques))

    def value(self, program: NonlinearProgram, z: Array, values: Array) -> float:
        """Half the sum of the squared residuals."""
        residuals = self._residuals(program, z, values)
        return 0.5 * float(residuals @ residuals)

    def model(
        self, program: NonlinearProgram, state: Iterate, linearization: Linearization
    ) -> Model:
        """Gauss-Newton model: squares of residuals linearised at the iterate."""
        z, matrix = state.z, self.differences
        if program.transcription.torque_sequence is not None:
            chosen = np.isin(linearization.rows, self._rows(program))
            matrix = matrix @ linearization.matrix[chosen]
        parts = [matrix / self.torque_norm, self.speeds.matrix]
        root = sp.vstack(parts, format="csr")
        gradient = np.asarray(root.T @ self._residuals(program, z, state.values))
        return Model(partial(self.value, program), gradient, root)

    def _residuals(self, program: NonlinearProgram, z: Array, values: Array) -> Array:
        torques = self.differences @ self._torques(program, z, values)
        return np.concatenate([torques / self.torque_norm, self.speeds.at(z)])

    def _torques(self, program: NonlinearProgram, z: Array, values: Array) -> Array:
        """The unknowns, or values of rows, whose differences are taken."""
        unknown = program.transcription.torque_sequence is None
        return z if unknown else values[self._rows(program)]

    def _rows(self, program: NonlinearProgram) -> IntArray:
        """Rows of the torques, but for instants whose rows joined later."""
        kind = program.rows.kinds.index("torque")
        return np.flatnonzero(program.rows.kind == kind)[: self.differences.shape[1]]

    def within(self, program: NonlinearProgram, steps: StepBounds) -> StepBounds:
        """Steps that keep the duration."""
        timed = program.cost != 0.0
        return StepBounds(*(np.where(timed, 0.0, bound) for bound in steps))

    def restorable(self, program: NonlinearProgram, state: Iterate) -> bool:
        """Whether the iterate is feasible: as T is given, slowing down is no option."""
        return state.violation <= self.feasibility


def mean_speeds(nlp: NonlinearProgram, z: Array) -> Variation:
    """Weighted mean speeds of all joints between nodes, as a linear function of z.

    It is exact, as the duration is fixed. Speeds are in shares of their limits, or of
    the highest speed of the joint if it has no limit.

    Args:
        nlp: The nonlinear program.
        z: Its iterate.
    """
    scheme, n, count = nlp.transcription, nlp.system.n, nlp.transcription.intervals
    motion = scheme.motion(z)
    middles = Instants.spread(count, (0.5,))
    highest = np.abs(scheme.states(motion, middles, 1).v).max(axis=0)
    limits = nlp.system.problem.robot.limits.velocity
    scale = np.where(np.isfinite(limits), limits, highest)
    # The lower bound keeps the weights of joints that do not move finite.
    scale = np.maximum(scale, 1e-3 * max(float(scale.max()), 1e-3))
    nodes = Instants.nodes(count)
    node = np.repeat(np.arange(count + 1), n)
    each = Partials(node, by_q=np.tile(np.eye(n), (count + 1, 1)))
    steps = sp.diags([-1.0, 1.0], [0, 1], shape=(count, count + 1))
    weights = 1.0 / np.sqrt(motion.h * np.sum(motion.h))
    speeds = sp.csr_matrix(sp.kron(sp.diags(weights) @ steps, sp.diags(1.0 / scale)))
    matrix = sp.csr_matrix(speeds @ scheme.pull_back(motion, nodes, each))
    q = scheme.states(motion, nodes, 0).q
    return Variation(matrix, speeds @ q.ravel() - matrix @ z)


def _norm(residuals: Array) -> float:
    return max(float(np.linalg.norm(residuals)), LEAST_NORM)
