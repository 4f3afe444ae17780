r"""Collocation: states and torques as unknowns, the dynamics as equations.

The states at the nodes are lifted out of the paper's linear program:

.. math:: \delta x_{k+1} = A_k \delta x_k + B_k \delta u_k + c_k \delta h_k + d_k .

Eliminating them gives the paper's program back (see
:mod:`tominpmp.transcription.adjoint`), and the multipliers of these rows are the
paper's psi. Limits on positions and velocities become bounds, the trust region is a box
on the states, where the error of the linearisation lives, and a start may be any path,
whether the dynamics allow it or not. The step is Radau IIA with the inner stage
condensed (:mod:`tominpmp.transcription.integrator`).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.base import Linearization, Rows, StepBounds, Variation
from tominpmp.transcription.controls import (
    driving_torque,
    first_ways,
    motor_torques,
    share_steps,
    torque_jumps,
    torque_shares,
    turned_ways,
)
from tominpmp.transcription.integrator import (
    Stage,
    differentiate_defects,
    evaluate_defects,
    solve_inner_stage,
)
from tominpmp.transcription.system import System
from tominpmp.transcription.ways import Ways

# Lengths of intervals change by this share at most in one step.
LENGTH_STEP = 0.3
# Velocities are of this times the scale of positions over the duration.
SPEED_FACTOR = 5.0
# Value of the defects of an interval whose inner stage cannot be solved for.
BROKEN = 1e3


class CollocationTranscription:
    """A problem in states and torques.

    The unknowns are z = (states, torques, lengths): states (q, v) at N + 1 nodes,
    torques of N intervals as shares of the limits, in [-1, 1]; lengths are h = H eta
    with a matrix H of shares, of one column (scaling of a given grid) or more.

    Attributes:
        system: The functions of the problem.
        shares: H, shape (N, m): lengths of the intervals [s] per unit of eta.

    Torques are those that dry friction leaves; ways come from the first iterate.
    """

    def __init__(
        self, system: System, shares: Array, duration: float, ways: Ways | None = None
    ) -> None:
        self.system, self._ways = system, ways
        self.shares = shares
        self._N, self._m = int(shares.shape[0]), int(shares.shape[1])
        self._n = system.n
        velocity = SPEED_FACTOR / duration * system.step_scale
        self._scale = np.concatenate([system.step_scale, velocity])
        limit = system.problem.robot.limits.velocity
        self._limited = np.flatnonzero(np.isfinite(limit))
        self._speed_limit = limit[self._limited]
        self._rows = self._build_rows()
        self._columns = self._interval_columns()

    # -- unknowns ----------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return (self._N + 1) * 2 * self._n + self._N * self._n + self._m

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

    def pack(self, x: Array, u: Array, eta: Array) -> Array:
        """Stack states, torques and lengths into z.

        What is known of the ends replaces what is given; all is brought within limits.

        Args:
            x: States (q, v) at the nodes, shape (N + 1, 2n).
            u: Torques of the intervals without dry friction, shape (N, n) [N m or N].
            eta: Shape (m,).

        Returns:
            z, with the torques as shares of their limits.
        """
        system, n = self.system, self._n
        limits = system.problem.robot.limits
        high = np.concatenate([limits.position_upper, limits.velocity])
        low = np.concatenate([limits.position_lower, -limits.velocity])
        x = np.clip(x, low, high)
        x[0] = np.concatenate([system.problem.q_start, system.v_start])
        if system.joint_goal is not None:
            x[-1, :n] = system.joint_goal.q
        if system.final_velocity is not None:
            x[-1, n:] = system.final_velocity
        return np.concatenate([x.ravel(), torque_shares(system, u).ravel(), eta])

    def start(self, q: Array, eta: Array) -> Array:
        """Turn positions at the nodes into unknowns; the dynamics need not hold.

        Velocities are those of parabolas through neighbouring nodes, torques those of
        the inverse dynamics in the middle of the intervals, within their limits.

        Args:
            q: Positions at the nodes, shape (N + 1, n) [rad or m].
            eta: Lengths, shape (m,).

        Returns:
            z.
        """
        system, lengths = self.system, self.shares @ eta
        problem, h = system.problem, lengths[:, None]
        q = q.copy()
        q[0] = problem.q_start
        if system.joint_goal is not None:
            q[-1] = system.joint_goal.q
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
        N, n, system = self._N, self._n, self.system
        states = (N + 1) * 2 * n
        share = z[states : states + N * n].reshape(N, n)
        u = system.effort_middle + system.effort_half * share
        return z[:states].reshape(N + 1, 2 * n), u, self.shares @ z[-self._m :]

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Trust region within the limits, fixed ends and positive lengths."""
        system, N, n = self.system, self._N, self._n
        limits = system.problem.robot.limits
        x, _, h = self.split(z)
        box = radius * np.concatenate(
            [system.step_scale, SPEED_FACTOR / h.sum() * system.step_scale]
        )
        low = np.concatenate([limits.position_lower, -limits.velocity])
        high = np.concatenate([limits.position_upper, limits.velocity])
        lower = np.maximum(-box, np.minimum(low - x, 0.0))
        upper = np.minimum(box, np.maximum(high - x, 0.0))
        lower[0] = upper[0] = 0.0
        if system.joint_goal is not None:
            lower[-1, :n] = upper[-1, :n] = 0.0
        if system.final_velocity is not None:
            lower[-1, n:] = upper[-1, n:] = 0.0
        share = z[x.size : x.size + N * n].reshape(N, n)
        less, more = share_steps(system, share, np.full(n, 2.0), self._given_ways(z))
        length = min(LENGTH_STEP, radius) * z[-self._m :]
        return StepBounds(
            np.concatenate([lower.ravel(), less.ravel(), -length]),
            np.concatenate([upper.ravel(), more.ravel(), length]),
        )

    # -- dry friction ------------------------------------------------------------------

    def _given_ways(self, z: Array) -> Ways | None:
        """Which way joints with friction move: as in the first motion looked at."""
        if self.system.friction is not None and self._ways is None:
            self._ways = first_ways(self.system, self.split(z)[0][:, self._n :])
        return self._ways

    def turned(self, z: Array) -> tuple[CollocationTranscription, Array] | None:
        """The program with the ways that joints move in an iterate, and the iterate.

        None if those that were assumed will do.
        """
        given, N, n = self._given_ways(z), self._N, self._n
        if given is None:
            return None
        x, states = self.split(z)[0], (N + 1) * 2 * n
        share = z[states : states + N * n].reshape(N, n)
        found = turned_ways(self.system, given, x[:, n:], share)
        if found is None:
            return None
        z = np.concatenate([x.ravel(), found[1].ravel(), z[-self._m :]])
        return type(self)(self.system, self.shares, float(self.cost @ z), found[0]), z

    # -- rows --------------------------------------------------------------------------

    def _build_rows(self) -> Rows:
        system, N, n = self.system, self._N, self._n
        defects = np.zeros(N * 2 * n)
        # One group: all defects shrink in proportion, which took half the iterations
        # of a group for each interval on the paper's example.
        groups = np.zeros(defects.size, dtype=np.int64)
        limit = np.ones(N * self._limited.size)
        whole = np.zeros(limit.size, dtype=np.int64)
        parts = [
            ("dynamics", defects, defects, groups),
            ("velocity", -limit, limit, whole),
        ]
        if system.clearance is not None:
            count = system.clearance.count
            parts.append(
                (
                    "clearance",
                    np.full(N * count, -np.inf),
                    np.zeros(N * count),
                    np.repeat(np.arange(N), count),
                )
            )
        if system.joint_goal is None:
            lower, upper = system.goal_bounds
            parts.append(("goal", lower, upper, np.zeros(lower.size, dtype=np.int64)))
        return Rows.stack(parts)

    def _goal(self, x: Array) -> tuple[Array, Array, Array]:
        problem, n = self.system.problem, self._n
        return problem.goal.residual(self.system.kinematics, x[:n], x[n:])

    def _inner(self, x: Array, u: Array, h: Array) -> Stage:
        return solve_inner_stage(self.system.dynamics, x[:-1], x[1:], u, h)

    def evaluate(self, z: Array) -> Array:
        """Row values."""
        system = self.system
        x, u, h = self.split(z)
        stage = self._inner(x, u, h)
        defects = evaluate_defects(system.dynamics, x[:-1], x[1:], u, h, stage.x)
        solved = stage.solved[:, None]
        defects = np.where(solved, defects / self._scale, BROKEN)
        speeds = stage.x[:, self._n + self._limited] / self._speed_limit
        parts = [defects.ravel(), np.where(solved, speeds, BROKEN).ravel()]
        if system.clearance is not None:
            times = np.cumsum(h)
            values = system.clearance.values(x[1:, : self._n], times=times)
            parts.append(values.ravel())
        if system.joint_goal is None:
            parts.append(self._goal(x[-1])[0])
        return np.concatenate(parts)

    def linearize(self, z: Array, values: Array, steps: StepBounds) -> Linearization:
        """Jacobian of the rows that can become active within a box of steps."""
        rows = self._rows
        x, u, h = self.split(z)
        blocks = [self._interval_jacobian(x, u, h)]
        chosen = [np.flatnonzero(rows.kind <= 1)]
        if self.system.clearance is not None:
            index = np.flatnonzero(rows.kind == rows.kinds.index("clearance"))
            boxes = steps.upper[: x.size].reshape(x.shape)[:, : self._n]
            radius = float(np.max(boxes / self.system.step_scale, initial=0.0))
            if self.system.clearance.moving:
                radius = max(radius, 1.0)  # obstacles come closer as time goes by
            near = index[values[index] > -2.0 * radius]
            blocks.append(self._clearance_jacobian(x, h, near - index[0]))
            chosen.append(near)
        if self.system.joint_goal is None:
            blocks.append(self._goal_jacobian(x[-1]))
            chosen.append(np.flatnonzero(rows.kind == rows.kinds.index("goal")))
        matrix = sp.vstack(blocks, format="csr") if len(blocks) > 1 else blocks[0]
        return Linearization(np.concatenate(chosen), matrix)

    def _interval_columns(self) -> IntArray:
        """Unknowns that an interval depends on, shape (N, 5n + m)."""
        N, n = self._N, self._n
        states = (N + 1) * 2 * n
        k = np.arange(N)[:, None]
        return np.concatenate(
            [
                k * 2 * n + np.arange(4 * n),
                states + k * n + np.arange(n),
                np.broadcast_to(states + N * n + np.arange(self._m), (N, self._m)),
            ],
            axis=1,
        )

    def _interval_jacobian(self, x: Array, u: Array, h: Array) -> sp.csr_matrix:
        """Jacobian of the defects and of the velocities at the inner stages."""
        n, system = self._n, self.system
        inner = self._inner(x, u, h).x
        by = differentiate_defects(system.dynamics, x[:-1], x[1:], u, h, inner)
        defects = np.concatenate(
            [by.by_start, by.by_end, by.by_control, by.by_length[..., None]], axis=2
        )
        speeds = by.inner[:, n + self._limited] / self._speed_limit[:, None]
        return sp.vstack(
            [
                self._interval_rows(defects / self._scale[:, None]),
                self._interval_rows(speeds),
            ],
            format="csr",
        )

    def _interval_rows(self, entries: Array) -> sp.csr_matrix:
        """Rows of intervals from derivatives with respect to (ends, torques, length).

        Args:
            entries: Shape (N, k, 5n + 1).

        Returns:
            Shape (N k, size).
        """
        n, count = self._n, entries.shape[1]
        entries[..., 4 * n : 5 * n] *= self.system.effort_half
        by_eta = entries[..., 5 * n :] * self.shares[:, None, :]
        entries = np.concatenate([entries[..., : 5 * n], by_eta], axis=2)
        columns = np.repeat(self._columns, count, axis=0)
        ends = np.arange(self._N * count + 1) * columns.shape[1]
        matrix = sp.csr_matrix(
            (entries.ravel(), columns.ravel(), ends),
            shape=(self._N * count, self.size),
        )
        matrix.eliminate_zeros()
        return matrix

    def _clearance_jacobian(
        self, x: Array, h: Array, chosen: IntArray
    ) -> sp.csr_matrix:
        clearance, n = self.system.clearance, self._n
        if clearance is None or not chosen.size:
            return sp.csr_matrix((0, self.size))
        node, pair = 1 + chosen // clearance.count, chosen % clearance.count
        entries, rates = clearance.derivatives_at(
            x[1:, :n], node - 1, pair, np.cumsum(h)
        )
        columns = node[:, None] * 2 * n + np.arange(n)
        shape = (chosen.size, self.size)
        if clearance.moving:
            # The time of a node is the sum of the lengths before it.
            by_eta = rates[:, None] * np.cumsum(self.shares, axis=0)[node - 1]
            places = self.size - self._m + np.arange(self._m)
            places = np.broadcast_to(places, by_eta.shape)
            entries = np.concatenate([entries, by_eta], axis=1)
            columns = np.concatenate([columns, places], axis=1)
        ends = np.arange(chosen.size + 1) * columns.shape[1]
        return sp.csr_matrix((entries.ravel(), columns.ravel(), ends), shape=shape)

    def _goal_jacobian(self, x: Array) -> sp.csr_matrix:
        _, by_q, by_v = self._goal(x)
        k, n = by_q.shape
        jacobian = sp.csr_matrix(np.hstack([by_q, by_v]))
        before, after = self._N * 2 * n, self._N * n + self._m
        return sp.hstack(
            [sp.csr_matrix((k, before)), jacobian, sp.csr_matrix((k, after))],
            format="csr",
        )

    # -- the rest of the interface -----------------------------------------------------

    def variation(self, z: Array) -> Variation:
        """Jumps of the torques between intervals, in full ranges."""
        jumps = torque_jumps(self.system, self._N)
        count = jumps.shape[0]
        states = sp.csr_matrix((count, (self._N + 1) * 2 * self._n))
        lengths = sp.csr_matrix((count, self._m))
        matrix = sp.hstack([states, jumps, lengths], format="csr")
        return Variation(matrix, np.zeros(count))

    def stretch(self, z: Array, factor: float) -> Array:
        """The same configurations, traversed slower, with the torques for that."""
        x, _, _ = self.split(z)
        n, eta = self._n, z[-self._m :] * factor
        q, v = x[:, :n], x[:, n:] / factor
        u = driving_torque(self.system, q, v, self.shares @ eta)
        return self.pack(np.hstack([q, v]), u, eta)

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate, joined by Hermite polynomials between nodes."""
        x, u, h = self.split(z)
        n = self._n
        motion = Trajectory(
            joint_names=self.system.problem.robot.joint_names,
            t=np.concatenate([[0.0], np.cumsum(h)]),
            q=x[:, :n],
            v=x[:, n:],
            u=np.concatenate([u, u[-1:]]),
            holding=self.system.dynamics.inverse,
        )
        return motor_torques(self.system, motion, self._given_ways(z))
