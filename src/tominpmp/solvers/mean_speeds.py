r"""Mean speeds: the squares of the speeds that take a motion from node to node.

.. math:: \frac{1}{T} \sum_k h_k \left| \frac{q_{k+1} - q_k}{h_k \, \hat v} \right|^2

of all joints, in shares of their limits v, is least for joints that go straight, each
at one speed. Torques do not tell: a light joint may go to and fro for next to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.constraints import Partials
from tominpmp.transcription.base import Variation
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.program import NonlinearProgram


@dataclass(frozen=True, eq=False)
class MeanSpeeds:
    """Weighted mean speeds of all joints between nodes, for a fixed duration.

    Attributes:
        nlp: The nonlinear program.
        scale: Speeds that count as one [rad/s or m/s], shape (n,).
    """

    nlp: NonlinearProgram
    scale: Array

    @classmethod
    def of(cls, nlp: NonlinearProgram, z: Array) -> MeanSpeeds:
        """Speeds in shares of their limits, or of the highest where there are none."""
        of, every = nlp.transcription, nlp.transcription.intervals
        middles = Instants.spread(every, (0.5,))
        highest = np.abs(of.states(of.motion(z), middles, 1).v).max(axis=0)
        limits = nlp.system.problem.robot.limits.velocity
        # What does not move at all gets no infinite weight.
        scale = np.where(np.isfinite(limits), limits, highest)
        return cls(nlp, np.maximum(scale, 1e-3 * max(float(scale.max()), 1e-3)))

    def linearized(self, z: Array) -> Variation:
        """The speeds as a linear function near z; exact, as the duration is fixed."""
        of, n = self.nlp.transcription, self.nlp.system.n
        count = of.intervals
        nodes = Instants.spread(count, (0.0,)).joined(Instants.end(count))
        motion = of.motion(z)
        each = Partials(
            np.repeat(np.arange(count + 1), n), by_q=np.tile(np.eye(n), (count + 1, 1))
        )
        steps = sp.diags([-1.0, 1.0], [0, 1], shape=(count, count + 1))
        weights = 1.0 / np.sqrt(motion.h * np.sum(motion.h))
        speeds = sp.csr_matrix(
            sp.kron(sp.diags(weights) @ steps, sp.diags(1.0 / self.scale))
        )
        matrix = sp.csr_matrix(speeds @ of.pull_back(motion, nodes, each))
        q = of.states(motion, nodes, 0).q
        return Variation(matrix, speeds @ q.ravel() - matrix @ z)
