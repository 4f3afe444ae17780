"""Inverse dynamics: torque limits as rows on an exact double integrator.

The unknowns are the points of a quadratic spline and the lengths of its intervals (see
:mod:`tominpmp.transcription.spline`); torques at both ends of every interval follow
from the inverse dynamics. This is the paper's state-dependent control limit (its
section 4) for the control v = acceleration: u_l <= u(q, v, a) <= u_u.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.base import Linearization, Rows, StepBounds, Variation
from tominpmp.transcription.clearance_rows import ClearanceRows
from tominpmp.transcription.exchange import Extra, grazing, overloaded
from tominpmp.transcription.spline import (
    Spline,
    SplineDerivatives,
    acceleration_jumps,
    differentiate,
    jumps_by_length,
)
from tominpmp.transcription.spline_rows import (
    Columns,
    Entries,
    Instants,
    StateDerivatives,
    speed_jacobian,
    speed_values,
    torque_jacobian,
)
from tominpmp.transcription.spline_ways import SplineWays
from tominpmp.transcription.system import System
from tominpmp.transcription.ways import arrival

# Lengths of intervals change by this share at most in one step.
LENGTH_STEP = 0.3
# Clearances beyond this, in shares of the reach per rad of trust region, are no rows of
# the linear program: a step that uses them up all the same is cut short by the merit.
ATTENTION = 0.07
# However far it reaches; beyond this clearances are not exact.
MAX_ATTENTION = 0.05


class InverseTranscription:
    """A problem in the points of a spline.

    The unknowns are stacked as z = (points, final velocity, lengths): N points of n
    joints, of which the first is the start and the last the final configuration; the
    lengths are h = H eta with a matrix H of shares, of one column (uniform scaling of a
    given grid) or more.

    Attributes:
        system: The functions of the problem.
        shares: H, shape (N, m): lengths of the intervals [s] per unit of eta.

    Torques are rows at both ends of every interval, and at extra instants.
    """

    def __init__(
        self,
        system: System,
        shares: Array,
        duration: float,
        extra: Extra | None = None,
    ) -> None:
        self.system = system
        self.shares = shares
        self._N, self._m = int(shares.shape[0]), int(shares.shape[1])
        self._n = system.n
        every = np.arange(self._N)
        ends = Instants(np.tile(every, 2), np.repeat([0.0, 1.0], self._N))
        self._extra = extra = Extra() if extra is None else extra
        self._at = ends.joined(extra.torque)
        self._clear: ClearanceRows | None = None
        if system.clearance is not None:
            self._clear = ClearanceRows.on(system.clearance, self._N, extra.clearance)
        self._columns = Columns(self._N, self._n)
        self._reference = duration / self._N  # scales the velocity rows [s]
        self._rows = self._build_rows()
        self._acceleration_range: Array | None = None
        self._torques = SplineWays(system, self._at, extra.ways)

    # -- unknowns ----------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self._N * self._n + self._n + self._m

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

    def pack(self, points: Array, v_end: Array, eta: Array) -> Array:
        """Stack points, of which the last is the final configuration, into z."""
        return np.concatenate([points.ravel(), v_end, eta])

    def start(self, position: Callable[[Array], Array], duration: float) -> Array:
        """Iterate for a guess.

        Args:
            position: Configurations at times, shape (k,) to (k, n).
            duration: T of the iterate [s]; the guess is sampled over its own duration,
                which the first argument of the constructor gave.
        """
        guessed = self._reference * self._N
        share = self.shares.sum(axis=1)
        nodes = np.concatenate([[0.0], np.cumsum(share)]) / share.sum()
        points = position(0.5 * (nodes[1:] + nodes[:-1]) * guessed)
        points[0] = position(np.zeros(1))[0]
        points[-1] = position(np.array([guessed]))[0]
        v_end = self.system.final_velocity
        v_end = np.zeros(self._n) if v_end is None else v_end
        eta = np.full(self._m, duration / share.sum())
        return self.pack(points, v_end, eta)

    def spline(self, z: Array) -> Spline:
        """Spline of an iterate."""
        N, n = self._N, self._n
        points = z[: N * n].reshape(N, n).copy()
        v_end, h = z[N * n : N * n + n], self.shares @ z[-self._m :]
        v_start = self.system.v_start
        ends = np.stack([self.system.problem.q_start, points[-1]])
        points[0] += 0.5 * h[0] * v_start
        points[-1] -= 0.5 * h[-1] * v_end
        return Spline(points, h, ends, np.stack([v_start, v_end]))

    def _chain(self, z: Array, spline: Spline) -> sp.csr_matrix:
        """Derivative of (points, lengths, final q, final v) with respect to z."""
        N, n, m = self._N, self._n, self._m
        points, end = N * n, N * n + n
        every, joints = np.arange(points), np.arange(n)
        lengths, final = end + np.arange(m), self._columns.final_position
        chain = Entries(self._columns.count, self.size)
        chain.add(every, every, np.ones(points))
        chain.add(final, points - n + joints, np.ones(n))
        chain.add(final + n, points + joints, np.ones(n))
        chain.add(points + np.arange(N)[:, None], lengths, self.shares)
        # The first and the last point hang on the velocities and lengths beside them.
        last = points - n + joints
        chain.add(last, points + joints, np.full(n, -0.5 * spline.h[-1]))
        by_start = 0.5 * np.outer(spline.v_ends[0], self.shares[0])
        by_end = -0.5 * np.outer(spline.v_ends[1], self.shares[-1])
        chain.add(joints[:, None], lengths, by_start)
        chain.add(last[:, None], lengths, by_end)
        return chain.matrix()

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Trust region within position limits, fixed ends and positive lengths."""
        system, N, n, m = self.system, self._N, self._n, self._m
        limits = system.problem.robot.limits
        box = np.broadcast_to(radius * system.step_scale, (N, n))
        points = z[: N * n].reshape(N, n)
        lower = np.maximum(-box, np.minimum(limits.position_lower - points, 0.0))
        upper = np.minimum(box, np.maximum(limits.position_upper - points, 0.0))
        lower[0] = upper[0] = 0.0
        if system.joint_goal is not None:
            lower[-1] = upper[-1] = 0.0
        v_box = np.zeros(n)
        v_end = z[N * n : N * n + n]
        if system.final_velocity is None:
            duration = float(self.cost @ z)
            v_box = 10.0 * radius * system.step_scale / duration
        v_lower = np.maximum(-v_box, np.minimum(-limits.velocity - v_end, 0.0))
        v_upper = np.minimum(v_box, np.maximum(limits.velocity - v_end, 0.0))
        length = min(LENGTH_STEP, radius) * z[-m:]
        return StepBounds(
            np.concatenate([lower.ravel(), v_lower, -length]),
            np.concatenate([upper.ravel(), v_upper, length]),
        )

    # -- rows --------------------------------------------------------------------------

    def _build_rows(self) -> Rows:
        system, N, n = self.system, self._N, self._n
        limits = system.problem.robot.limits
        self._limited = np.flatnonzero(np.isfinite(limits.velocity))
        speeds = 2 * (N - 1) * self._limited.size
        none = np.full(speeds, -np.inf)
        most = np.ones(self._at.size * n)
        if self._extra.ways is not None:
            most = self._extra.ways.bound.ravel()
        parts = [
            ("torque", -most, most, np.zeros(most.size, dtype=np.int64)),
            ("velocity", none, np.zeros(speeds), np.zeros(speeds, dtype=np.int64)),
        ]
        self._end_points = bool(np.any(system.v_start)) or (
            system.final_velocity is None or bool(np.any(system.final_velocity))
        )
        if self._end_points:
            parts.append(
                (
                    "position",
                    np.tile(limits.position_lower, 2),
                    np.tile(limits.position_upper, 2),
                    np.zeros(2 * n, dtype=np.int64),
                )
            )
        if self._clear is not None:
            count, instants = self._clear.constraint.count, self._clear.size
            parts.append(
                (
                    "clearance",
                    np.full(instants * count, -np.inf),
                    np.zeros(instants * count),
                    np.repeat(np.arange(instants), count),
                )
            )
        if system.joint_goal is None:
            lower, upper = system.goal_bounds
            parts.append(("goal", lower, upper, np.zeros(lower.size, dtype=np.int64)))
        return Rows.stack(parts)

    def _goal(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        return self.system.problem.goal.residual(self.system.kinematics, q, v)

    def evaluate(self, z: Array) -> Array:
        """Row values."""
        system, spline = self.system, self.spline(z)
        q, v = spline.q, spline.v
        parts = [
            self._torques.loads(spline).ravel(),
            speed_values(
                spline,
                system.problem.robot.limits.velocity[self._limited],
                self._limited,
                self._reference,
            ),
        ]
        if self._end_points:
            parts.append(spline.points[[0, -1]].ravel())
        if self._clear is not None:
            parts.append(self._clear.values(spline, MAX_ATTENTION).ravel())
        if system.joint_goal is None:
            parts.append(self._goal(q[-1], v[-1])[0])
        return np.concatenate(parts)

    def inspect(self, z: Array, overload: float) -> Extra:
        """Instants between the rows at which an iterate breaks its limits.

        Args:
            z: Iterate.
            overload: Relative excess of torques that is let pass.
        """
        spline = self.spline(z)
        torque = overloaded(self.system, spline, overload)
        extra = self._torques.turned(spline, torque, overload)
        if self._clear is None:
            return extra
        known = self._clear.instants(spline.h)
        return replace(extra, clearance=grazing(self.system, spline, known))

    def with_rows(self, extra: Extra) -> InverseTranscription:
        """The same problem with rows at more instants."""
        duration = self._reference * self._N
        extra = self._extra.joined(extra)
        return InverseTranscription(self.system, self.shares, duration, extra)

    def linearize(self, z: Array, values: Array, steps: StepBounds) -> Linearization:
        """Jacobian of the rows that can become active within a box of steps."""
        spline = self.spline(z)
        coefficients = differentiate(spline)
        count = self._rows
        blocks = [
            self._torque_jacobian(spline, coefficients),
            self._speed_jacobian,
        ]
        chosen = [np.flatnonzero(count.kind <= 1)]
        if self._end_points:
            blocks.append(self._end_point_jacobian())
            chosen.append(np.flatnonzero(count.kind == count.kinds.index("position")))
        if self._clear is not None:
            rows = np.flatnonzero(count.kind == count.kinds.index("clearance"))
            radius = float(np.max(steps.upper[: self._N * self._n], initial=0.0))
            attention = min(ATTENTION * radius, MAX_ATTENTION)
            if self._clear.constraint.moving:
                attention = MAX_ATTENTION  # obstacles come closer as time goes by
            near = rows[values[rows] > -attention]
            blocks.append(
                self._clear.jacobian(
                    near - rows[0], spline, coefficients, self._columns
                )
            )
            chosen.append(near)
        if self.system.joint_goal is None:
            blocks.append(self._goal_jacobian(spline))
            chosen.append(np.flatnonzero(count.kind == count.kinds.index("goal")))
        matrix = sp.vstack(blocks, format="csr") @ self._chain(z, spline)
        return Linearization(np.concatenate(chosen), matrix)

    def _torque_jacobian(
        self, spline: Spline, coefficients: SplineDerivatives
    ) -> sp.csr_matrix:
        by = StateDerivatives.of(self._at, coefficients)
        parts = self.system.dynamics.inverse_jacobians(*self._at.states(spline))
        half = self.system.effort_half
        if self._acceleration_range is None:
            # A change of acceleration that lasts an interval takes inertia and
            # friction.
            h = spline.h[self._at.interval, None]
            mass = np.einsum("mii->mi", parts.tau_a)
            drag = np.abs(np.einsum("mii->mi", parts.tau_v)) * h
            mean = np.mean(mass + drag, axis=0) / half
            self._acceleration_range = 2.0 / np.maximum(mean, 1e-12)
        return torque_jacobian(self._at, parts, half, by, spline, self._columns)

    @cached_property
    def _speed_jacobian(self) -> sp.csr_matrix:
        limit = self.system.problem.robot.limits.velocity[self._limited]
        return speed_jacobian(limit, self._limited, self._reference, self._columns)

    def _end_point_jacobian(self) -> sp.csr_matrix:
        n, entries = self._n, Entries(2 * self._n, self._columns.count)
        both = np.concatenate([np.arange(n), (self._N - 1) * n + np.arange(n)])
        entries.add(np.arange(2 * n), both, np.ones(2 * n))
        return entries.matrix()

    def _goal_jacobian(self, spline: Spline) -> sp.csr_matrix:
        _, by_q, by_v = self._goal(spline.q_ends[1], spline.v_ends[1])
        entries = Entries(by_q.shape[0], self._columns.count)
        rows, final = np.arange(by_q.shape[0])[:, None], self._columns.final_position
        entries.add(rows, final, by_q)
        entries.add(rows, final + self._n, by_v)
        return entries.matrix()

    # -- the rest of the interface -----------------------------------------------------

    def variation(self, z: Array) -> Variation:
        """Jumps of the accelerations between intervals, in full ranges.

        The full range of a joint's acceleration is what its full torque range can bring
        about for an interval against its own inertia and friction, averaged over the
        first motion that was linearized.
        """
        spline = self.spline(z)
        scale = self._acceleration_range
        if scale is None:
            self._torque_jacobian(spline, differentiate(spline))
            scale = self._acceleration_range
        assert scale is not None  # noqa: S101
        jumps = acceleration_jumps(spline.h)
        data = (jumps.data[:, None] / scale).ravel()
        rows = (jumps.row[:, None] * self._n + np.arange(self._n)).ravel()
        columns = (jumps.col[:, None] * self._n + np.arange(self._n)).ravel()
        matrix = sp.csr_matrix(
            (data, (rows, columns)), shape=((self._N - 1) * self._n, self.size)
        )
        if self._m > 1:
            # Lengths that change by themselves must not seem to change nothing.
            by_eta = jumps_by_length(spline, self.shares) / scale[:, None]
            by_eta = sp.csr_matrix(by_eta.reshape(-1, self._m))
            empty = sp.csr_matrix((matrix.shape[0], self.size - self._m))
            matrix = matrix + sp.hstack([empty, by_eta])
        offset = (np.diff(spline.a, axis=0) / scale).ravel() - matrix @ z
        return Variation(matrix, offset)

    @property
    def torque_sequence(self) -> sp.csr_matrix:
        """Mean torques of the intervals, from the instants of the torque rows."""
        means = sp.diags([0.5, 0.5], [0, self._N], shape=(self._N, self._at.size))
        return sp.csr_matrix(means)

    def stretch(self, z: Array, factor: float) -> Array:
        """The same points, traversed slower."""
        out = z.copy()
        out[-self._m :] *= factor
        return out

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate; its torque follows from the inverse dynamics."""
        spline = self.spline(z)
        q, v, a = spline.q, spline.v, spline.a
        dynamics = self.system.motors
        tau = dynamics.inverse(q, v, np.concatenate([a, a[-1:]]))
        tau[-1] += arrival(self.system.problem.robot.friction, v[-1], a[-1])
        return Trajectory(
            joint_names=self.system.problem.robot.joint_names,
            t=np.concatenate([[0.0], np.cumsum(spline.h)]),
            q=q,
            v=v,
            u=tau,
            a=a,
            inverse_dynamics=dynamics.inverse,
        )
