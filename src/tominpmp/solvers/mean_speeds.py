r"""Mean speeds: the squares of the speeds that take a motion from node to node.

.. math:: \frac{1}{T} \sum_k h_k \left| \frac{q_{k+1} - q_k}{h_k \, \hat v} \right|^2

of all joints, in shares of their limits v, is least for joints that go straight, each
at one speed. Torques do not tell: a light joint may go to and fro for next to nothing.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.constraints import Partials
from tominpmp.transcription.base import Variation
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.program import NonlinearProgram


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
    nodes = Instants.spread(count, (0.0,)).joined(Instants.end(count))
    each = Partials(
        np.repeat(np.arange(count + 1), n), by_q=np.tile(np.eye(n), (count + 1, 1))
    )
    steps = sp.diags([-1.0, 1.0], [0, 1], shape=(count, count + 1))
    weights = 1.0 / np.sqrt(motion.h * np.sum(motion.h))
    speeds = sp.csr_matrix(sp.kron(sp.diags(weights) @ steps, sp.diags(1.0 / scale)))
    matrix = sp.csr_matrix(speeds @ of.pull_back(motion, nodes, each))
    q = of.states(motion, nodes, 0).q
    return Variation(matrix, speeds @ q.ravel() - matrix @ z)
