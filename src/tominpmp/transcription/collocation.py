r"""Collocation: states and torques as unknowns, the dynamics as equations.

The states at the nodes are unknowns as well, related by equations of the program:

.. math:: \delta x_{k+1} = A_k \delta x_k + B_k \delta u_k + c_k \delta h_k + d_k .

Eliminating the states gives the paper's linear program (see
:mod:`tominpmp.transcription.adjoint`), and the multipliers of these rows are the
paper's costates psi. Limits on positions and velocities become bounds, the trust region
is a box on the states, which determine the error of the linearisation, and an initial
guess may be any path, dynamically feasible or not. The integration step is Radau IIA
with the inner stage eliminated (:mod:`tominpmp.transcription.integrator`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import Partials
from tominpmp.motion.trajectory import State
from tominpmp.transcription.base import NOT_INTEGRATED, HullRows, StepBounds
from tominpmp.transcription.controls import SPEED_FACTOR, TorqueTranscription
from tominpmp.transcription.curve import PositionFunction, nodes_of, rows_of_table
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.integrator import NODES, SteppedMotion
from tominpmp.transcription.problem_functions import ProblemFunctions

# Clearances above this, in shares of the reach per rad of the trust region radius, are
# left out of linear programs.
ATTENTION = 2.0


class CollocationTranscription(TorqueTranscription):
    """A problem in z = (states, torques, lengths).

    The states (q, v) are at N + 1 nodes; for torques and lengths see the base class.
    """

    bounded = frozenset({"q", "u"})
    # Code of this transcription among the degrees of splines, and their double knots.
    degree = 0
    breaks: tuple[int, ...] = ()
    # Clearance to moving obstacles that a change of time alone can use up.
    moving_attention = ATTENTION

    def __init__(
        self, system: ProblemFunctions, shares: Array, duration: float
    ) -> None:
        super().__init__(system, shares, duration)
        self.size = (3 * self.intervals + 2) * self._n + self._m
        self._columns = self._interval_columns()
        limits = system.problem.robot.limits
        self._low = np.concatenate([limits.position_lower, -limits.velocity])
        self._high = np.concatenate([limits.position_upper, limits.velocity])
        # States that the problem fixes at the ends; NaN for unknown states.
        self._given = np.full((self.intervals + 1, 2 * self._n), np.nan)
        self._given[0] = system.problem.x_start
        if system.final_configuration is not None:
            self._given[-1, : self._n] = system.final_configuration
        if system.final_velocity is not None:
            self._given[-1, self._n :] = system.final_velocity

    # -- unknowns ----------------------------------------------------------------------

    def pack(self, x: Array, u: Array, eta: Array) -> Array:
        """Stack states, torques and lengths into z.

        States given at the ends replace the arguments; all states and torques are
        clipped to their limits, torques to those for the directions of the joints.

        Args:
            x: States (q, v) at the nodes, shape (N + 1, 2n).
            u: Torques of the intervals without dry friction, shape (N, n) [N m or N].
            eta: Lengths, shape (m,).

        Returns:
            z, with the torques as shares of their limits.
        """
        free, shares = np.isnan(self._given), self.system.torque_shares(u)
        x = np.where(free, np.clip(x, self._low, self._high), self._given)
        if self.system.friction is not None:
            signs = self.signs or self.first_signs(x[:, self._n :])
            shares = np.clip(shares, signs.lower, signs.upper)
        return np.concatenate([x.ravel(), shares.ravel(), eta])

    def start(self, position: PositionFunction, guessed: float, eta: Array) -> Array:
        """Iterate for a guess: its positions at the nodes; the defects are not zero.

        Velocities are taken from parabolas through neighbouring nodes, torques from the
        inverse dynamics in the middle of the intervals, within their limits.

        Args:
            position: Configurations at times, shape (k,) to (k, n).
            guessed: Duration of the guess [s].
            eta: Lengths of the iterate, shape (m,).
        """
        system, lengths = self.system, self.shares @ eta
        h, fixed = lengths[:, None], self._given[:, : self._n]
        nodes = nodes_of(self.shares.sum(axis=1))
        q = position(guessed * nodes / nodes[-1])
        q = np.where(np.isnan(fixed), q, fixed)
        slope = np.diff(q, axis=0) / h
        inner = (h[1:] * slope[:-1] + h[:-1] * slope[1:]) / (h[1:] + h[:-1])
        end = system.final_velocity
        last = 2.0 * slope[-1] - inner[-1] if end is None else end
        v = np.concatenate([system.problem.v_start[None], inner, last[None]])
        return self.pack(np.hstack([q, v]), system.driving_torque(q, v, lengths), eta)

    def through(self, motion: Callable[[Array], State], t: Array, eta: Array) -> Array:
        """Iterate with the states of a motion at the nodes, and with its torques.

        Args:
            motion: States of the motion at times [s], shape (k,).
            t: Times of the nodes [s], shape (N + 1,).
            eta: Lengths of the iterate, shape (m,).
        """
        nodes, middle = motion(t), motion(0.5 * (t[1:] + t[:-1]))
        u = self.system.net_torque(middle.u, middle.v)
        return self.pack(np.hstack([nodes.q, nodes.v]), u, eta)

    def split(self, z: Array) -> tuple[Array, Array, Array]:
        """States, torques without dry friction and lengths [s] of an iterate.

        Returns:
            Shapes (N + 1, 2n), (N, n) and (N,).
        """
        x = z[: self._torques.start].reshape(self.intervals + 1, 2 * self._n)
        return x, self.torques(z), self.lengths(z)

    def steps(self, z: Array, radius: float) -> tuple[Array, Array]:
        """Steps of states and torques within their limits; given states are fixed."""
        scale, (x, _, h) = self.system.step_scale, self.split(z)
        box = radius * np.concatenate([scale, SPEED_FACTOR / h.sum() * scale])
        box = np.where(np.isnan(self._given), box, 0.0)
        lower = np.maximum(-box, np.minimum(self._low - x, 0.0))
        upper = np.minimum(box, np.maximum(self._high - x, 0.0))
        less, more = self.torque_steps(z, np.full(self._n, 2.0))
        return np.append(lower, less), np.append(upper, more)

    # -- dry friction ------------------------------------------------------------------

    def scaled_at(self, z: Array) -> TorqueTranscription:
        """The transcription with velocity signs of joints with dry friction."""
        if self.system.friction is None or self.signs is not None:
            return self
        v = self.split(z)[0][:, self._n :]
        return self.with_signs(self.duration, self.first_signs(v))

    # -- states ------------------------------------------------------------------------

    @property
    def scale(self) -> Array:
        """Scale of the states, shape (2n,)."""
        position = self.system.step_scale
        return np.append(position, SPEED_FACTOR / self.duration * position)

    def motion(self, z: Array) -> SteppedMotion:
        """States and torques of an iterate."""
        return SteppedMotion(self.system.dynamics, *self.split(z))

    @property
    def equations(self) -> tuple[HullRows[SteppedMotion]]:
        """The equations of motion, as rows of defects.

        All defects are in one group, so that a relaxed step reduces them in proportion.
        On the paper's example this took half the iterations of one group for each
        interval.
        """
        zeros = np.zeros((1, self.intervals * self.scale.size))
        functions = self._defects, self._defects_by_unknowns
        return (HullRows("dynamics", (zeros, zeros), *functions),)

    def _defects(self, motion: SteppedMotion) -> Array:
        """Defects of the steps over the scale of the states; zero for a motion.

        They have a large value on intervals whose inner stage was not solved for.
        """
        solved, defects = motion.stage.solved[:, None], motion.defects
        return np.where(solved, defects / self.scale, NOT_INTEGRATED)

    def _defects_by_unknowns(self, motion: SteppedMotion) -> sp.csr_matrix:
        """Jacobian of the defects."""
        entries = motion.derivatives.defects / self.scale[:, None]
        N, size, width = entries.shape
        interval = np.repeat(np.arange(N), size)
        return self.interval_rows(entries.reshape(N * size, width), interval)

    def instants(self, order: int, field: str) -> Instants:
        """Nodes; for velocities, which have bounds at the nodes, the inner stages.

        For accelerations, which jump at the nodes, both ends of the intervals.
        """
        if field == "v":
            return Instants.spread(self.intervals, (float(NODES[0]),))
        return super().instants(order, field)

    def pull_back(
        self, motion: SteppedMotion, at: Instants, partials: Partials
    ) -> sp.csr_matrix:
        """Derivatives by the unknowns from derivatives by the states."""
        interval, data = self.by_steps(motion, at, partials)
        by_eta = np.zeros((interval.size, self._m))
        if partials.by_t is not None:
            by_eta += partials.by_t[:, None] * at.times(self.shares)[partials.at]
        return self.interval_rows(data, interval, by_eta)

    def attention(self, steps: StepBounds) -> float:
        """Clearance that a step of the states can use up, over the reach."""
        states = steps.upper[: (self.intervals + 1) * 2 * self._n]
        boxes = states.reshape(self.intervals + 1, -1)[:, : self._n]
        return ATTENTION * float(np.max(boxes / self.system.step_scale, initial=0.0))

    def _interval_columns(self) -> IntArray:
        """Indices of the unknowns on which each interval depends, (N, 5n + m)."""
        N, n = self.intervals, self._n
        ends = (N + 1) * 2 * n, self.size - self._m
        states, torques, lengths = np.split(np.arange(self.size), ends)
        x, u, eta = states.reshape(N + 1, -1), torques.reshape(N, n), lengths[None]
        return np.hstack([x[:-1], x[1:], u, eta.repeat(N, axis=0)])

    def interval_rows(
        self, entries: Array, interval: IntArray, by_eta: Array | float = 0.0
    ) -> sp.csr_matrix:
        """Rows from derivatives with respect to (ends, torques, length) of an interval.

        Args:
            entries: Derivatives, shape (k, 5n + 1).
            interval: Interval of each row, shape (k,).
            by_eta: Additional derivatives by the last unknowns, shape (k, m).

        Returns:
            Rows of a Jacobian, shape (k, size).
        """
        ends, torques, length = np.split(entries, [4 * self._n, 5 * self._n], axis=1)
        by_eta = length * self.shares[interval] + by_eta
        parts = [ends, torques * self.system.effort_half, by_eta]
        data = np.concatenate(parts, axis=1)
        return rows_of_table(data, self._columns[interval], self.size)

    # -- the rest of the interface -----------------------------------------------------

    def time_scale(self, z: Array, factor: float) -> Array:
        """The same configurations, passed more slowly, with the torques it requires."""
        x, _, _ = self.split(z)
        n, eta = self._n, z[-self._m :] * factor
        q, v = x[:, :n], x[:, n:] / factor
        u = self.system.driving_torque(q, v, self.shares @ eta)
        return self.pack(np.hstack([q, v]), u, eta)
