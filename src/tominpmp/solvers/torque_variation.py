r"""Torque variation: the squared differences of neighbouring torques.

.. math:: \sum_k \frac{\bar d}{d_k} |u_{k+1} - u_k|^2

over a sequence of torques u_k, in full ranges, a time d_k apart: the mean torques of
the intervals, where torques jump between these, or those at nodes and middles; dbar is
the mean of the d_k, so that the sum does not depend on how the grid is spaced.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.transcription.base import Linearization, Variation
from tominpmp.transcription.program import NonlinearProgram


@dataclass(frozen=True, eq=False)
class TorqueVariation:
    """Weighted differences of neighbouring torques, whose squares are the variation.

    Attributes:
        nlp: The nonlinear program.
        times: Instants of the sequence of torques as shares of T, shape (k,).
    """

    nlp: NonlinearProgram
    times: Array

    def differences(self, z: Array, values: Array) -> Array:
        """The differences at z, whose row values are given."""
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
        return Variation(matrix, self.differences(z, values) - matrix @ z)

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
