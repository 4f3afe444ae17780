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
from tominpmp.constraints.joint_limits import JointLimit
from tominpmp.transcription.base import HullRows
from tominpmp.transcription.bspline import BSplineTranscription
from tominpmp.transcription.curve import PositionFunction, SplineMotion, nodes_of
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions


class InverseTranscription(BSplineTranscription):
    """A problem whose unknowns are the control points of a quadratic spline.

    Attributes:
        duration: Duration that scales the rows of velocities [s].
    """

    inspected = ((0.1, 0.2, 0.275, 0.35, 0.425, 0.5, 0.575, 0.65, 0.725, 0.8, 0.9),)
    highest_order = 2

    def __init__(
        self,
        system: ProblemFunctions,
        shares: Array,
        duration: float,
        segment_ends: tuple[int, ...] = (),
    ) -> None:
        super().__init__(system, shares, 2, segment_ends)
        self.duration = duration

    def pack(self, points: Array, q_end: Array, eta: Array) -> Array:
        """Unknowns of a spline.

        Args:
            points: Middle points of the intervals, shape (N, n); the states at the ends
                replace the points that they determine.
            q_end: Final configuration, shape (n,); replaced if the goal determines it.
            eta: Durations, shape (m,).
        """
        start = self.system.problem.q_start
        return self.unknowns(np.concatenate([start[None], points, q_end[None]]), eta)

    def start(self, position: PositionFunction, guessed: float, eta: Array) -> Array:
        """Iterate for a guess: parabolas through its nodes and middles.

        Sampling the guess at the Greville abscissae instead would demand torques far
        beyond their limits on short intervals, if the samples of the guess are sparse.

        Args:
            position: Configurations at times, shape (k,) to (k, n).
            guessed: Duration of the guess [s].
            eta: Durations of the iterate, shape (m,).
        """
        nodes = nodes_of(self.shares.sum(axis=1))
        nodes = guessed * nodes / nodes[-1]
        q, middle = position(nodes), position(0.5 * (nodes[1:] + nodes[:-1]))
        limits = self.system.problem.robot.limits
        points = 2.0 * middle - 0.5 * (q[1:] + q[:-1])
        points = np.clip(points, limits.position_lower, limits.position_upper)
        v_end = self.system.final_velocity
        v_end = np.zeros(self.system.n) if v_end is None else v_end
        points[-1] = q[-1] - 0.5 * (self.shares[-1] @ eta) * v_end
        return self.pack(points, q[-1], eta)

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

    def hull(
        self, limit: JointLimit, name: str, within: tuple[int, int] | None = None
    ) -> HullRows[SplineMotion] | None:
        """Bounds on control points for positions, on nodes for velocities."""
        if limit.order == 1:
            return _speeds(self, limit, name)
        return super().hull(limit, name) if limit.order == 0 else None


def _speeds(
    of: InverseTranscription, limit: JointLimit, name: str
) -> HullRows[SplineMotion]:
    """Speed limits at the nodes with free velocities; speeds are linear between nodes.

    |v_k| <= v_max, multiplied by h_{k-1} + h_k, is linear in control points and
    lengths.
    """
    free_end, n = of.system.final_velocity is None, of.system.n
    nodes = np.arange(1, of.intervals + 1 if free_end else of.intervals)
    # Derivatives by the durations of twice the time between neighbouring points.
    knots = of.knots_by_durations
    apart = (knots[3:-1] - knots[1:-3])[nodes]
    unit = 2.0 * of.duration / of.intervals
    shape = 1, 2 * nodes.size * limit.count

    def excess(motion: SplineMotion) -> Array:
        """Excess of the speeds over their limits, in both directions."""
        steps = np.diff(motion.points, axis=0)[nodes]
        ratio = 2.0 * steps[:, limit.of_joints] / limit.upper
        lasting = (apart @ motion.eta)[:, None]
        return (np.stack([ratio - lasting, -ratio - lasting]) / unit).ravel()

    def by_unknowns(motion: SplineMotion) -> sp.csr_matrix:
        """Jacobian of the excess of the speeds."""
        slope = np.tile(2.0 / (limit.upper * unit), nodes.size)
        data = np.stack([-slope, slope], axis=1)
        before = (nodes[:, None] * n + limit.of_joints).reshape(-1, 1)
        places = np.tile(before + np.array([0, n]), (2, 1))
        near = of.near[nodes]
        by_durations = -np.take_along_axis(apart, near, axis=1) / unit
        near = np.tile(np.repeat(near, limit.count, axis=0), (2, 1))
        by_durations = np.repeat(by_durations, limit.count, axis=0)
        by_durations = np.tile(by_durations, (2, 1))
        signed = np.concatenate([data, -data])
        return of.by_unknowns(motion.eta, signed, places, by_durations, near)

    lower, upper = np.full(shape, -np.inf), np.zeros(shape)
    return HullRows(name, lower, upper, excess, by_unknowns, limit.curable)
