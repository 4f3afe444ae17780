r"""Adjoint: torques and duration as unknowns, the paper's transcription.

The motion is integrated forward from the start (single shooting). Goal residuals and
path constraints depend on the torques and the lengths of the intervals through it;
their differentials (the paper's delta g and delta h, equations 12 and 13) follow from
one backward sweep of the discrete adjoint equation for all rows together. Path
constraints enter a linear program only at active instants, the paper's set S;
everything else is a bound on a variable.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.base import Linearization, Rows, StepBounds, Variation
from tominpmp.transcription.controls import (
    driving_torque,
    motor_torques,
    share_steps,
    torque_jumps,
    torque_shares,
    turned_ways,
)
from tominpmp.transcription.integrator import Rollout, differentiate_rollout, rollout
from tominpmp.transcription.sweep import sweep_adjoint
from tominpmp.transcription.system import System
from tominpmp.transcription.ways import Ways

# Lengths of intervals change by this share at most in one step.
LENGTH_STEP = 0.3
# Torques change by this share of their range per radian of the trust region: the
# larger, the likelier the obstacle of the paper's example is passed on the faster side.
CONTROL_FACTOR = 2.0
# Typical velocities are this times the scale of positions over the duration.
SPEED_FACTOR = 5.0
# Value of the rows of a motion that could not be integrated to its end.
BROKEN = 1e3
# A step leaves at least this share of the duration (the paper: T + dT >= 0).
SHORTEST = 0.1
# Instants attain the maximum of a constraint if they come this close to it.
ATTAINED = 1e-4
# Clearances above this share of the arm's reach are left out of a linear program.
NEAR = 0.2

Instants = Literal["near", "exact", "violated"]


class AdjointTranscription:
    """A problem in torques and lengths of intervals.

    The unknowns are stacked as z = (torques, lengths): torques of N intervals as shares
    of the limits, in [-1, 1]; the lengths are h = H eta with a matrix H of shares, of
    one column (the duration, as in the paper) or more.

    Attributes:
        system: The functions of the problem.
        shares: H, shape (N, m): lengths of the intervals [s] per unit of eta.
        instants: Which instants of path constraints become rows: "exact" those that
            attain the maximum (the paper's S), "near" all that a step can bring to
            their bound, "violated" those beyond it.
        substeps: Integration steps an interval.

    Torques are those that dry friction leaves of the motors'. Which way joints move is
    given as ``ways``; without it, at first it is left out.
    """

    def __init__(
        self,
        system: System,
        shares: Array,
        duration: float,
        *,
        instants: Instants = "near",
        substeps: int = 1,
        ways: Ways | None = None,
    ) -> None:
        self.system, self._ways = system, ways
        self.shares = shares
        self.instants = instants
        self.substeps = substeps
        self._N, self._m = int(shares.shape[0]), int(shares.shape[1])
        self._n = system.n
        self._speed = SPEED_FACTOR / duration
        problem = system.problem
        self._start = np.concatenate([problem.q_start, system.v_start])
        self._last: tuple[Array, Rollout] | None = None
        self._rows = self._build_rows()

    # -- unknowns ----------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self._N * self._n + self._m

    @property
    def rows(self) -> Rows:
        """What the rows are."""
        return self._rows

    @property
    def cost(self) -> Array:
        """Gradient of the duration."""
        cost = np.zeros(self.size)
        cost[-self._m :] = self.shares.sum(axis=0)
        return cost

    def pack(self, u: Array, eta: Array) -> Array:
        """Stack torques and lengths into z.

        Args:
            u: Torques of the intervals, shape (N, n) [N m or N]; those beyond their
                limits are brought to them.
            eta: Shape (m,).
        """
        return np.concatenate([torque_shares(self.system, u).ravel(), eta])

    def split(self, z: Array) -> tuple[Array, Array]:
        """Torques [N m or N] and lengths [s], shapes (N, n) and (N,)."""
        system = self.system
        share = z[: -self._m].reshape(self._N, self._n)
        u = system.effort_middle + system.effort_half * share
        return u, self.shares @ z[-self._m :]

    @property
    def torque_bounds(self) -> tuple[Array, Array]:
        """Bounds of the torque shares, shape (N n,) each."""
        if self._ways is None:
            ones = np.ones(self._N * self._n)
            return -ones, ones
        return self._ways.lower.ravel(), self._ways.upper.ravel()

    def motion(self, z: Array) -> Rollout:
        """The motion of an iterate, integrated forward."""
        if self._last is not None and np.array_equal(self._last[0], z):
            return self._last[1]
        u, h = self.split(z)
        guess = None if self._last is None else self._last[1]
        dynamics = self.system.dynamics
        motion = rollout(dynamics, self._start, u, h, self.substeps, guess)
        if motion.finite:
            self._last = z.copy(), motion
        return motion

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Trust region within the torque limits: a share of the whole range."""
        share = z[: -self._m].reshape(self._N, self._n)
        reach = 2.0 * min(1.0, CONTROL_FACTOR * radius)
        reaches = np.full(self._n, reach)
        lower, upper = share_steps(self.system, share, reaches, self._ways)
        length = min(LENGTH_STEP, radius) * z[-self._m :]
        return StepBounds(
            np.concatenate([lower.ravel(), -length]),
            np.concatenate([upper.ravel(), length]),
        )

    def fixed_steps(
        self, z: Array, control_step: float, time_step: float
    ) -> StepBounds:
        """The paper's box: |du| <= rho, |dT| <= epsilon, within the torque limits.

        Args:
            z: Iterate.
            control_step: Rho [N m or N].
            time_step: Epsilon [s].
        """
        share = z[: -self._m].reshape(self._N, self._n)
        lower, upper = share_steps(
            self.system, share, control_step / self.system.effort_half, self._ways
        )
        duration = float(self.cost @ z)
        factor = time_step / duration
        shorter = min(factor, 1.0 - SHORTEST)
        return StepBounds(
            np.concatenate([lower.ravel(), -shorter * z[-self._m :]]),
            np.concatenate([upper.ravel(), factor * z[-self._m :]]),
        )

    def turned(self, z: Array) -> tuple[AdjointTranscription, Array] | None:
        """The program with the ways that joints move in an iterate, and the iterate.

        None if those that were assumed will do.
        """
        system, motion, n = self.system, self.motion(z), self._n
        if system.friction is None or not motion.finite:
            return None
        share = z[: -self._m].reshape(self._N, n)
        found = turned_ways(system, self._ways, motion.nodes[:, n:], share)
        if found is None:
            return None
        z = np.concatenate([found[1].ravel(), z[-self._m :]])
        same: dict[str, Any] = {"instants": self.instants, "substeps": self.substeps}
        duration = float(self.cost @ z)
        changed = type(self)(system, self.shares, duration, ways=found[0], **same)
        return changed, z

    # -- rows --------------------------------------------------------------------------

    def _build_rows(self) -> Rows:
        system, N = self.system, self._N
        limits = system.problem.robot.limits
        finite = np.isfinite(limits.position_lower) | np.isfinite(limits.position_upper)
        self._placed = np.flatnonzero(finite)
        self._limited = np.flatnonzero(np.isfinite(limits.velocity))
        lower, upper = (bound / self._goal_scale for bound in system.goal_bounds)
        scale = system.step_scale[self._placed]
        low = np.tile(limits.position_lower[self._placed] / scale, N)
        high = np.tile(limits.position_upper[self._placed] / scale, N)
        speed = np.ones(N * self._limited.size)
        count = 0 if system.clearance is None else system.clearance.count
        none = np.full(N * count, -np.inf)
        # The paper's h is the maximum of a constraint over all instants, so that these
        # form a group; so do the goal residuals, which vanish in proportion.
        return Rows.stack(
            [
                ("goal", lower, upper, np.zeros(lower.size, dtype=np.int64)),
                ("position", low, high, np.tile(np.arange(scale.size), N)),
                ("velocity", -speed, speed, np.tile(np.arange(self._limited.size), N)),
                ("clearance", none, np.zeros(N * count), np.tile(np.arange(count), N)),
            ]
        )

    def _goal(self, x: Array) -> tuple[Array, Array]:
        """Goal residual, scaled, and its gradients with respect to the final state."""
        goal, n = self.system.problem.goal, self._n
        value, by_q, by_v = goal.residual(self.system.kinematics, x[:n], x[n:])
        scale = self._goal_scale
        return value / scale, np.hstack([by_q, by_v]) / scale[:, None]

    @cached_property
    def _goal_scale(self) -> Array:
        """What goal rows are divided by; velocities, of joints or a frame, are last."""
        scale = np.ones(self.system.goal_bounds[0].size)
        if self.system.problem.goal.fixes_velocity:
            scale[-self._n :] = self._speed * self.system.step_scale
        else:
            scale[-3:] = self._speed
        return scale

    def evaluate(self, z: Array) -> Array:
        """Row values."""
        motion, n = self.motion(z), self._n
        if not motion.finite:
            return np.full(self._rows.size, BROKEN)
        x = motion.nodes[1:]
        limits = self.system.problem.robot.limits
        scale = self.system.step_scale[self._placed]
        parts = [
            self._goal(x[-1])[0],
            (x[:, self._placed] / scale).ravel(),
            (x[:, n + self._limited] / limits.velocity[self._limited]).ravel(),
        ]
        if self.system.clearance is not None:
            times = np.cumsum(self.split(z)[1])
            values = self.system.clearance.values(x[:, :n], times=times)
            parts.append(values.ravel())
        return np.concatenate(parts)

    def linearize(self, z: Array, values: Array, steps: StepBounds) -> Linearization:
        """Jacobian of the goal rows and of path constraints at active instants."""
        motion = self.motion(z)
        if not motion.finite:
            # Nothing can be said of it; without rows, the program makes it shorter.
            return Linearization(
                np.zeros(0, dtype=np.int64), sp.csr_matrix((0, self.size))
            )
        chosen = self.active(values)
        nodes, seeds, rates = self._seeds(motion.nodes, z, chosen)
        by = differentiate_rollout(self.system.dynamics, motion)
        by_control, by_length = sweep_adjoint(by, nodes, seeds)
        by_length += rates[:, None] * self._before[nodes]
        by_share = (by_control * self.system.effort_half).reshape(chosen.size, -1)
        matrix = sp.csr_matrix(np.hstack([by_share, by_length @ self.shares]))
        return Linearization(chosen, matrix)

    def pull_back(self, z: Array, weights: Array) -> Array:
        """Gradient of a weighted sum of rows, by one sweep for all of them.

        Args:
            z: Iterate.
            weights: Weight of each row, shape (m,).

        Returns:
            Jacobian transposed times weights, shape (size,).
        """
        motion = self.motion(z)
        chosen = np.flatnonzero(weights)
        nodes, seeds, rates = self._seeds(motion.nodes, z, chosen)
        by = differentiate_rollout(self.system.dynamics, motion)
        push = np.zeros_like(motion.nodes)
        np.add.at(push, nodes, weights[chosen, None] * seeds)
        by_control, by_length = np.empty((self._N, self._n)), np.empty(self._N)
        costate = np.zeros(2 * self._n)
        for j in range(self._N - 1, -1, -1):
            costate = costate + push[j + 1]
            by_control[j], by_length[j] = costate @ by.B[j], costate @ by.c[j]
            costate = costate @ by.A[j]
        by_length += (weights[chosen] * rates) @ self._before[nodes]
        by_share = by_control * self.system.effort_half
        return np.concatenate([by_share.ravel(), by_length @ self.shares])

    @cached_property
    def _before(self) -> Array:
        """Which intervals are over at each node, shape (N + 1, N)."""
        return np.tri(self._N + 1, self._N, -1)

    def active(self, values: Array) -> IntArray:
        """Indices of the goal rows and of path constraints at active instants.

        Args:
            values: Row values, shape (m,).
        """
        rows = self._rows
        path = np.flatnonzero(rows.kind > 0)
        if self.instants == "near":
            # Distances are costly to differentiate; the others are left to the builder
            # of the linear program, which knows what a step can do to them.
            clearance = rows.kind == rows.kinds.index("clearance")
            return np.flatnonzero(~clearance | (values > -NEAR))
        if self.instants == "violated":
            return np.flatnonzero((rows.kind == 0) | (rows.violation(values) > 0.0))
        chosen = np.zeros(rows.size, dtype=bool)
        chosen[rows.kind == 0] = True
        for excess in (values - rows.upper, rows.lower - values):
            largest = np.full(int(rows.group.max()) + 1, -np.inf)
            np.maximum.at(largest, rows.group, excess)
            attained = excess >= largest[rows.group] - ATTAINED
            chosen[path] |= attained[path] & np.isfinite(excess[path])
        return np.flatnonzero(chosen)

    def _seeds(
        self, x: Array, z: Array, chosen: IntArray
    ) -> tuple[IntArray, Array, Array]:
        """Nodes of some rows, and their derivatives by the state and the time there."""
        rows, n, system = self._rows, self._n, self.system
        limits = system.problem.robot.limits
        first = np.searchsorted(rows.kind, np.arange(len(rows.kinds)))
        place = chosen - first[rows.kind[chosen]]
        nodes = np.full(chosen.size, self._N)
        seeds, rates = np.zeros((chosen.size, 2 * n)), np.zeros(chosen.size)
        kind = rows.kind[chosen]
        goal, position, velocity, clearance = (kind == i for i in range(4))
        seeds[goal] = self._goal(x[-1])[1][place[goal]]
        k, i = np.divmod(place[position], max(self._placed.size, 1))
        joint = self._placed[i]
        nodes[position] = 1 + k
        seeds[np.flatnonzero(position), joint] = 1.0 / system.step_scale[joint]
        k, i = np.divmod(place[velocity], max(self._limited.size, 1))
        joint = self._limited[i]
        nodes[velocity] = 1 + k
        seeds[np.flatnonzero(velocity), n + joint] = 1.0 / limits.velocity[joint]
        if system.clearance is not None and np.any(clearance):
            k, pair = np.divmod(place[clearance], system.clearance.count)
            nodes[clearance] = 1 + k
            times = np.cumsum(self.split(z)[1])
            seeds[clearance, :n], rates[clearance] = system.clearance.derivatives_at(
                x[1:, :n], k, pair, times
            )
        return nodes, seeds, rates

    # -- the rest of the interface -----------------------------------------------------

    def variation(self, z: Array) -> Variation:
        """Jumps of the torques between intervals, in full ranges."""
        jumps = torque_jumps(self.system, self._N)
        lengths = sp.csr_matrix((jumps.shape[0], self._m))
        matrix = sp.hstack([jumps, lengths], format="csr")
        return Variation(matrix, np.zeros(jumps.shape[0]))

    def stretch(self, z: Array, factor: float) -> Array:
        """The torques for about the same configurations, traversed slower."""
        x, n = self.motion(z).nodes, self._n
        eta = z[-self._m :] * factor
        u = driving_torque(self.system, x[:, :n], x[:, n:] / factor, self.shares @ eta)
        return self.pack(u, eta)

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate, joined by Hermite polynomials between nodes."""
        u, h = self.split(z)
        x, n = self.motion(z).nodes, self._n
        motion = Trajectory(
            self.system.problem.robot.joint_names,
            np.concatenate([[0.0], np.cumsum(h)]),
            *(x[:, :n], x[:, n:]),
            u=np.concatenate([u, u[-1:]]),
            holding=self.system.dynamics.inverse,
        )
        return motor_torques(self.system, motion, self._ways)
