r"""Inverse dynamics: torque limits as rows on an exact double integrator.

Positions are quadratic splines in time, with constant acceleration on each interval.
The control points are the middle Bezier points P_k of the N pieces, and the two ends of
the motion. With the lengths h_k and s_k = h_{k-1} + h_k,

.. math::
    v_k = 2 (P_k - P_{k-1}) / s_k, \qquad
    q_k = P_{k-1} + h_{k-1} (P_k - P_{k-1}) / s_k, \qquad
    a_k = (v_{k+1} - v_k) / h_k,

so that the double integrator holds exactly without rows, the motion on interval k
depends on P_{k-1}, P_k, P_{k+1} alone, the curve lies in the convex hull of the control
points (position limits hold at all times) and speed is piecewise linear (speed limits
hold at all times, too). Torques at both ends of every interval follow from the inverse
dynamics. With the accelerations as controls, torque limits are the paper's
state-dependent control limits (its section 4): u_l <= u(q, v, a) <= u_u.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.transcription.bspline import BSplineTranscription
from tominpmp.transcription.curve import PositionFunction
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions


class InverseTranscription(BSplineTranscription):
    """A problem whose unknowns are the control points of a quadratic spline."""

    inspected = ((0.1, 0.2, 0.275, 0.35, 0.425, 0.5, 0.575, 0.65, 0.725, 0.8, 0.9),)
    highest_order = 2

    def __init__(
        self,
        system: ProblemFunctions,
        shares: Array,
        segment_ends: tuple[int, ...] = (),
    ) -> None:
        super().__init__(system, shares, 2, segment_ends)

    def start(self, position: PositionFunction, guessed: float, eta: Array) -> Array:
        """Iterate for a guess: the spline through its positions.

        With these positions as control points, torques would be far beyond their limits
        on short intervals, if the samples of the guess are sparse.

        Args:
            position: Configurations at times, shape (k,) to (k, n).
            guessed: Duration of the guess [s].
            eta: Durations of the iterate, shape (m,).
        """
        slower = float(np.sum(self.shares @ eta)) / guessed
        return self.within_limits(
            self.interpolated(eta, lambda t: position(t / slower))
        )

    @cached_property
    def _torque_instants(self) -> Instants:
        """Both ends of every interval, at which accelerations jump."""
        N = self.intervals
        return Instants.spread(N, (0.0,)).joined(Instants.spread(N, (1.0,)))

    @property
    def torque_sequence(self) -> sp.csr_matrix:
        """Matrix to the mean torques of intervals from the torques at their ends."""
        N = self.intervals
        return sp.csr_matrix(sp.diags([0.5, 0.5], [0, N], shape=(N, 2 * N)))
