r"""Adjoint: torques and duration as unknowns, the paper's transcription.

The motion is integrated forward from the start (single shooting). Goal residuals and
path constraints depend on the torques and the lengths of the intervals through the
integrated states; their differentials (the paper's delta g and delta h, equations 12
and 13) follow from one backward sweep of the discrete adjoint equation for all rows
together. Torque limits are bounds of unknowns. With the paper's step rule path
constraints enter a linear program at active instants only, the paper's set S.
"""

from __future__ import annotations

from copy import copy

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import Partials
from tominpmp.transcription.base import StepBounds
from tominpmp.transcription.controls import TorqueTranscription, scale_of_goal
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.integrator import SteppedMotion, rollout, sweep_adjoint
from tominpmp.transcription.problem_functions import ProblemFunctions

# Largest change of the torques per radian of the trust region radius, as a share of
# their range: the larger it is, the more likely motions pass the obstacle of the
# paper's example on the faster side.
CONTROL_FACTOR = 2.0
# Rate of the feedback that keeps a motion near given states, per longest interval.
TRACKING = 0.4
# Least duration after a step, as a share of the duration before (paper: T + dT >= 0).
SHORTEST = 0.1
# Clearances above this share of the arm's reach are left out of linear programs.
NEAR = 0.2


class AdjointTranscription(TorqueTranscription):
    """A problem in z = (torques, lengths), with a single length as in the paper.

    Attributes:
        substeps: Number of integration steps in each interval.
        centre: An iterate and its motion, the initial guess of integrations; None
            integrates step by step, which takes several times as long.
    """

    bounded = frozenset({"u"})
    by_component = True
    moving_attention = NEAR

    def __init__(
        self,
        system: ProblemFunctions,
        shares: Array,
        duration: float,
        *,
        substeps: int = 1,
    ) -> None:
        super().__init__(system, shares, duration)
        self.size = self.intervals * self._n + self._m
        self.substeps = substeps
        self.centre: tuple[Array, SteppedMotion] | None = None
        # Cache of the last motion, which is requested many times.
        self._last: tuple[Array, SteppedMotion] | None = None

    # -- unknowns ----------------------------------------------------------------------

    def pack(self, u: Array, eta: Array) -> Array:
        """Stack torques and lengths into z.

        Args:
            u: Torques of the intervals, shape (N, n) [N m or N]; they are clipped to
                their limits.
            eta: Lengths, shape (m,).
        """
        return np.concatenate([self.system.torque_shares(u).ravel(), eta])

    def tracking(self, x: Array, eta: Array) -> Array:
        """Iterate whose torques, within their limits, keep the motion near states.

        The torque of each interval gives the arm the acceleration of the states, and
        corrects the deviation at its beginning (computed torque, with a double pole).

        Args:
            x: States (q, v) at the nodes, shape (N + 1, 2n).
            eta: Lengths, shape (m,).
        """
        system, n, h = self.system, self._n, np.asarray(self.shares @ eta)
        wanted, rate = np.diff(x[:, n:], axis=0) / h[:, None], TRACKING / h.max()
        u, state = system.driving_torque(x[:, :n], x[:, n:], h), x[0]
        for k in range(self.intervals):
            off = x[k] - state
            a = wanted[k] + rate * (rate * off[:n] + 2.0 * off[n:])
            q = state[:n] + 0.5 * h[k] * state[n:]
            v = state[n:] + 0.5 * h[k] * a
            torque = system.dynamics.inverse(q[None], v[None], a[None])
            share = system.torque_shares(torque)
            held = system.effort_middle + system.effort_half * share
            moved = rollout(system.dynamics, state, held, h[k : k + 1], self.substeps)
            if not moved.finite:
                break
            u[k], state = held[0], moved.ends[-1]
        return self.pack(u, eta)

    def motion(self, z: Array) -> SteppedMotion:
        """The motion of an iterate, integrated forward.

        Newton's iteration starts from the motion of the centre.
        """
        for known in (self.centre, self._last):
            if known is not None and np.array_equal(known[0], z):
                return known[1]
        u, h = self.torques(z), self.lengths(z)
        guess = None if self.centre is None else self.centre[1]
        system, start = self.system, self.system.problem.x_start
        motion = rollout(system.dynamics, start, u, h, self.substeps, guess)
        if motion.finite:
            self._last = z.copy(), motion
        return motion

    def centred_at(self, z: Array) -> AdjointTranscription:
        """The transcription with the motion of an iterate as centre."""
        motion = self.motion(z)
        if not motion.finite:
            return self
        centred = copy(self)
        centred.centre = centred._last = z.copy(), motion
        return centred

    def scaled_at(self, z: Array) -> AdjointTranscription:
        """The transcription centred at an iterate; its controls need no scales."""
        return self.centred_at(z)

    def steps(self, z: Array, radius: float) -> tuple[Array, Array]:
        """Steps of the torques within their limits, up to a share of the full range."""
        reach = 2.0 * min(1.0, CONTROL_FACTOR * radius)
        return self.torque_steps(z, np.full(self._n, reach))

    def fixed_steps(
        self, z: Array, control_step: float, time_step: float
    ) -> StepBounds:
        """The paper's box: |du| <= rho, |dT| <= epsilon, within the torque limits.

        Args:
            z: Iterate.
            control_step: Rho [N m or N].
            time_step: Epsilon [s].
        """
        lower, upper = self.torque_steps(z, control_step / self.system.effort_half)
        duration = float(self.cost @ z)
        factor = time_step / duration
        shorter = min(factor, 1.0 - SHORTEST)
        eta = z[-self._m :]
        less, more = -shorter * eta, factor * eta
        return StepBounds(np.append(lower, less), np.append(upper, more))

    # -- states ------------------------------------------------------------------------

    @property
    def goal_scale(self) -> Array:
        """Scale of the goal rows."""
        return scale_of_goal(self.system, self.duration)

    def pull_back(
        self, motion: SteppedMotion, at: Instants, partials: Partials
    ) -> sp.csr_matrix:
        """Derivatives by the unknowns: one costate sweep for all rows together."""
        rows = np.arange(partials.at.size)
        return sp.csr_matrix(self._swept(motion, at, partials, rows))

    def pull_back_sum(
        self, motion: SteppedMotion, at: Instants, partials: Partials, weights: Array
    ) -> Array:
        """Gradient of a weighted sum of values, by one sweep for the sum."""
        weighted, row = partials.times(weights), np.zeros(weights.size, int)
        return np.asarray(self._swept(motion, at, weighted, row)[0])

    def _swept(
        self, motion: SteppedMotion, at: Instants, partials: Partials, rows: IntArray
    ) -> Array:
        """Derivatives by the unknowns of sums of values, shape (k, size).

        Args:
            motion: The motion.
            at: Instants.
            partials: Partial derivatives of values there.
            rows: Index of the sum to which each value is added.
        """
        n, N, interval = self._n, self.intervals, at.interval[partials.at]
        step, data = self.by_steps(motion, at, partials)
        first, last, direct, along = np.split(data, [2 * n, 4 * n, 5 * n], axis=1)
        ends, by_ends = np.concatenate([step, step + 1]), np.concatenate([first, last])
        swept = sweep_adjoint(motion.sensitivities, ends, by_ends, np.tile(rows, 2))
        # All steps of an interval share its torque and have equal parts of its length.
        each = (len(swept[0]), N, self.substeps)
        by_control = swept[0].reshape(*each, n).sum(axis=2)
        by_length = swept[1].reshape(each).sum(axis=2)
        np.add.at(by_control, (rows, interval), direct)
        np.add.at(by_length, (rows, interval), along[:, 0] / self.substeps)
        by_share = (by_control * self.system.effort_half).reshape(len(by_control), -1)
        by_eta = by_length @ self.shares
        if partials.by_t is not None:
            by_time = partials.by_t[:, None] * at.times(self.shares)[partials.at]
            np.add.at(by_eta, rows, by_time)
        return np.hstack([by_share, by_eta])

    def attention(self, steps: StepBounds) -> float:
        """Clearance below which distances enter programs, over the reach.

        Other distances are left out, as their derivatives are costly.
        """
        return self.moving_attention

    # -- the rest of the interface -----------------------------------------------------

    def time_scale(self, z: Array, factor: float) -> Array:
        """Torques that pass approximately the same configurations more slowly."""
        x, n = self.motion(z).x, self._n
        eta = z[-self._m :] * factor
        u = self.system.driving_torque(x[:, :n], x[:, n:] / factor, self.shares @ eta)
        return self.pack(u, eta)
