r"""Collocation: states and torques as unknowns, the dynamics as equations.

The states at the nodes are lifted out of the paper's linear program:

.. math:: \delta x_{k+1} = A_k \delta x_k + B_k \delta u_k + c_k \delta h_k + d_k .

Eliminating them gives the paper's program back (see
:mod:`tominpmp.transcription.adjoint`), and the multipliers of these rows are the
paper's psi. Limits on positions and velocities become bounds, the trust region is a box
on the states, where the error of the linearisation lives, and an initial guess may be
any path, whether the dynamics allow it or not. The step is Radau IIA with the inner
stage condensed (:mod:`tominpmp.transcription.integrator`).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import Partials
from tominpmp.constraints.friction import Ways
from tominpmp.linear_programs.compressed import Compressed
from tominpmp.transcription.base import NOT_INTEGRATED, Hull, StepBounds
from tominpmp.transcription.controls import (
    SPEED_FACTOR,
    TorqueTranscription,
    driving_torque,
    first_ways,
    torque_shares,
)
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.integrator import NODES, SteppedMotion, stage_weights
from tominpmp.transcription.problem_functions import ProblemFunctions

# Clearances above this, per rad of trust region and in shares of the reach, are no rows
# of the linear program.
ATTENTION = 2.0


class CollocationTranscription(TorqueTranscription):
    """A problem in z = (states, torques, lengths).

    States (q, v) are at N + 1 nodes; torques and lengths see the base class.
    """

    kept = frozenset({"q", "u"})

    def __init__(
        self,
        system: ProblemFunctions,
        shares: Array,
        duration: float,
        ways: Ways | None = None,
    ) -> None:
        super().__init__(system, shares, duration, ways)
        velocity = SPEED_FACTOR / duration * system.step_scale
        self.scale = np.concatenate([system.step_scale, velocity])
        self._columns = self._interval_columns()
        limits = system.problem.robot.limits
        self._low = np.concatenate([limits.position_lower, -limits.velocity])
        self._high = np.concatenate([limits.position_upper, limits.velocity])
        # Given states at the ends; NaN for unknown ones.
        self._given = np.full((self._N + 1, 2 * self._n), np.nan)
        self._given[0] = np.concatenate([system.problem.q_start, system.v_start])
        if system.final_configuration is not None:
            self._given[-1, : self._n] = system.final_configuration
        if system.final_velocity is not None:
            self._given[-1, self._n :] = system.final_velocity

    # -- unknowns ----------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return (self._N + 1) * 2 * self._n + self._N * self._n + self._m

    def pack(self, x: Array, u: Array, eta: Array) -> Array:
        """Stack states, torques and lengths into z.

        States given at the ends replace the arguments; all states and torques are
        clipped to their limits.

        Args:
            x: States (q, v) at the nodes, shape (N + 1, 2n).
            u: Torques of the intervals without dry friction, shape (N, n) [N m or N].
            eta: Shape (m,).

        Returns:
            z, with the torques as shares of their limits.
        """
        free, shares = np.isnan(self._given), torque_shares(self.system, u)
        x = np.where(free, np.clip(x, self._low, self._high), self._given)
        return np.concatenate([x.ravel(), shares.ravel(), eta])

    def start(self, q: Array, eta: Array) -> Array:
        """Turn positions at the nodes into unknowns; the dynamics need not hold.

        Velocities are taken from parabolas through neighbouring nodes, torques from the
        inverse dynamics in the middle of the intervals, within their limits.

        Args:
            q: Positions at the nodes, shape (N + 1, n) [rad or m].
            eta: Lengths, shape (m,).

        Returns:
            z.
        """
        system, lengths = self.system, self.shares @ eta
        h, given = lengths[:, None], self._given[:, : self._n]
        q = np.where(np.isnan(given), q, given)
        slope = np.diff(q, axis=0) / h
        inner = (h[1:] * slope[:-1] + h[:-1] * slope[1:]) / (h[1:] + h[:-1])
        end = system.final_velocity
        last = 2.0 * slope[-1] - inner[-1] if end is None else end
        v = np.concatenate([system.v_start[None], inner, last[None]])
        return self.pack(np.hstack([q, v]), driving_torque(system, q, v, lengths), eta)

    def split(self, z: Array) -> tuple[Array, Array, Array]:
        """States, torques without dry friction and lengths [s] of an iterate.

        Returns:
            Shapes (N + 1, 2n), (N, n) and (N,).
        """
        x = z[: self._torques.start].reshape(self._N + 1, 2 * self._n)
        return x, self.torques(z), self.lengths(z)

    def steps(self, z: Array, radius: float) -> tuple[Array, Array]:
        """Steps of states and torques within their limits, for fixed ends."""
        scale, (x, _, h) = self.system.step_scale, self.split(z)
        box = radius * np.concatenate([scale, SPEED_FACTOR / h.sum() * scale])
        box = np.where(np.isnan(self._given), box, 0.0)
        lower = np.maximum(-box, np.minimum(self._low - x, 0.0))
        upper = np.minimum(box, np.maximum(self._high - x, 0.0))
        less, more = self.torque_steps(z, np.full(self._n, 2.0))
        return np.append(lower, less), np.append(upper, more)

    # -- dry friction ------------------------------------------------------------------

    def with_ways(self, duration: float, ways: Ways) -> CollocationTranscription:
        """The transcription with other velocity scales, and directions of joints."""
        return CollocationTranscription(self.system, self.shares, duration, ways)

    def assumed(self, z: Array) -> Ways | None:
        """Assumed directions of the joints; at first the directions in the iterate."""
        if self.system.friction is None or self.ways is not None:
            return self.ways
        return first_ways(self.system, self.split(z)[0][:, self._n :])

    def scaled_at(self, z: Array) -> CollocationTranscription:
        """The transcription with the directions of joints with dry friction."""
        ways = self.assumed(z)
        if ways is None or ways is self.ways:
            return self
        return self.with_ways(self.duration, ways)

    # -- states ------------------------------------------------------------------------

    def motion(self, z: Array) -> SteppedMotion:
        """States and torques of an iterate."""
        return SteppedMotion(self.system.dynamics, *self.split(z))

    @property
    def equations(self) -> Hull[SteppedMotion]:
        """The dynamics."""
        return Defects(self)

    def instants(self, order: int, field: str) -> Instants:
        """Nodes; the inner stages for velocities, which are bounded at the nodes.

        Both ends of the intervals for accelerations, which jump at the nodes.
        """
        if field == "v":
            return Instants.spread(self._N, (float(NODES[0]),))
        return super().instants(order, field)

    def pull_back(
        self, motion: SteppedMotion, at: Instants, partials: Partials
    ) -> sp.csr_matrix:
        """Derivatives by the unknowns from derivatives by the states."""
        which, (by_x, by_u) = partials.at, self.by_states(motion, at, partials)
        k, weights = at.interval[which], stage_weights(at.share[which])
        parts = [weights[:, :1] * by_x, weights[:, 2:] * by_x, by_u]
        data = np.concatenate([*parts, np.zeros((which.size, 1))], axis=1)
        if np.any(weights[:, 1]):
            inner = motion.derivatives.inner[k]
            data += weights[:, 1:2] * np.einsum("kj,kji->ki", by_x, inner)
        by_eta = np.zeros((which.size, self._m))
        if partials.by_t is not None:
            by_eta += partials.by_t[:, None] * at.times(self.shares)[which]
        return self.interval_rows(data, k, by_eta)

    def attention(self, steps: StepBounds) -> float:
        """Clearance that a step of the states can use up."""
        states = steps.upper[: (self._N + 1) * 2 * self._n]
        boxes = states.reshape(self._N + 1, -1)[:, : self._n]
        return ATTENTION * float(np.max(boxes / self.system.step_scale, initial=0.0))

    @property
    def moving_attention(self) -> float:
        """Clearance to moving obstacles, which time alone can use up."""
        return ATTENTION

    def _interval_columns(self) -> IntArray:
        """Unknowns that an interval depends on, shape (N, 5n + m)."""
        N, n = self._N, self._n
        states = (N + 1) * 2 * n
        k = np.arange(N)[:, None]
        ends = k * 2 * n + np.arange(4 * n)
        torques = states + k * n + np.arange(n)
        lengths = np.broadcast_to(states + N * n + np.arange(self._m), (N, self._m))
        return np.concatenate([ends, torques, lengths], axis=1)

    def interval_rows(
        self, entries: Array, interval: IntArray, by_eta: Array | float = 0.0
    ) -> sp.csr_matrix:
        """Rows from derivatives with respect to (ends, torques, length) of an interval.

        Args:
            entries: Shape (k, 5n + 1).
            interval: The intervals, shape (k,).
            by_eta: Additional derivatives by the last unknowns, shape (k, m).

        Returns:
            Shape (k, size).
        """
        ends, torques, length = np.split(entries, [4 * self._n, 5 * self._n], axis=1)
        by_eta = length * self.shares[interval] + by_eta
        parts = [ends, torques * self.system.effort_half, by_eta]
        data = np.concatenate(parts, axis=1)
        return Compressed.of_table(data, self._columns[interval], self.size).rows()

    # -- the rest of the interface -----------------------------------------------------

    def time_scale(self, z: Array, factor: float) -> Array:
        """The same configurations, traversed slower, with the torques that it takes."""
        x, _, _ = self.split(z)
        n, eta = self._n, z[-self._m :] * factor
        q, v = x[:, :n], x[:, n:] / factor
        u = driving_torque(self.system, q, v, self.shares @ eta)
        return self.pack(np.hstack([q, v]), u, eta)


class Defects(Hull[SteppedMotion]):
    """Defects of the steps, which are zero for a motion, over the scale of states.

    The defects are one group: all shrink in proportion, which took half the iterations
    of a group for each interval on the paper's example.
    """

    name = "dynamics"

    def __init__(self, of: CollocationTranscription) -> None:
        self._of = of
        self.lower = self.upper = np.zeros((1, of.intervals * of.scale.size))

    def of_motion(self, motion: SteppedMotion) -> Array:
        """Defects; a large value on intervals whose inner stage was not solved."""
        solved = motion.stage.solved[:, None]
        return np.where(solved, motion.defects / self._of.scale, NOT_INTEGRATED).ravel()

    def by_unknowns(self, motion: SteppedMotion) -> sp.csr_matrix:
        """By the unknowns."""
        by, scale = motion.derivatives, self._of.scale
        parts = by.by_start, by.by_end, by.by_control, by.by_length[..., None]
        entries = np.concatenate(parts, axis=2)
        N, size, width = entries.shape
        entries = (entries / scale[:, None]).reshape(N * size, width)
        return self._of.interval_rows(entries, np.repeat(np.arange(N), size))
