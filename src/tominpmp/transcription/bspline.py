r"""Smooth motions: B-splines of higher degree on a fixed grid of shares of T.

Degree 3 has continuous, piecewise linear accelerations (the paper's quasi-linear
control), degree 5 smooth ones. The unknowns are the control points C and the duration
T: with constant matrices B_d of basis functions,

.. math:: q = B_0 C, \quad \dot q = B_1 C / T, \quad \ddot q = B_2 C / T^2,

so that torque rates, jerks and accelerations can be limited (paper, section 4: the
torque becomes a state and its rate the control). Speeds, accelerations and jerks stay
in the convex hull of the control points of the derivatives: their limits hold at every
time. Control points at the ends are eliminated: they follow from the given states.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from tominpmp.arrays import Array, IntArray
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.base import Linearization, Rows, StepBounds, Variation
from tominpmp.transcription.bspline_basis import Basis, Elimination
from tominpmp.transcription.exchange import SplineExtra, grazing_times
from tominpmp.transcription.motor_rows import MotorRows
from tominpmp.transcription.spline_ways import CurveWays
from tominpmp.transcription.system import System
from tominpmp.transcription.ways import arrival

DEGREES = {"linear": 3, "spline": 5}
# T changes by this share at most in one step.
TIME_STEP = 0.3
# Instants of each interval at which torques and clearances are rows.
TORQUE_SHARES = (0.0, 0.5)
CLEARANCE_SHARES = (0.5, 1.0)
# Where torques are looked at besides, as many in either half of an interval.
INSPECTED_SHARES = (0.125, 0.25, 0.375, 0.625, 0.75, 0.875)
# Clearances beyond this, in shares of the reach per rad of trust region, wait.
ATTENTION = 0.07
# However far the trust region reaches; beyond this clearances are not exact.
MAX_ATTENTION = 0.05


class BSplineTranscription:
    """A problem in the control points of a B-spline and T.

    Attributes:
        system: The functions of the problem.
        degree: Degree of the spline.
        extra: Further instants with rows of clearances and of torques.
    """

    def __init__(
        self,
        system: System,
        shares: Array,
        degree: int,
        extra: SplineExtra | None = None,
    ) -> None:
        self.system, self.degree = system, degree
        self.shares = shares
        self._nodes = np.concatenate([[0.0], np.cumsum(shares[:, 0])])
        self._nodes /= self._nodes[-1]
        self._h = np.diff(self._nodes)
        self.extra = SplineExtra() if extra is None else extra
        self._n = system.n
        self._basis = Basis.on(self._nodes, degree)
        ends = Elimination.of(system, self._basis)
        self._map, self._offset = ends.matrix, ends.offset
        self._free, self._fixed_end = ends.free, ends.fixed_end
        self._motor = MotorRows.of(system, self._nodes, self._torque_times)
        starts, h = self._nodes[:-1], self._h
        self._ways = CurveWays(system, self._nodes, self._torque_times, self.extra.ways)
        self._clear = np.concatenate(
            [*(starts + share * h for share in CLEARANCE_SHARES), self.extra.clearance]
        )
        self._rows = self._build_rows()

    @property
    def _torque_times(self) -> Array:
        starts, h = self._nodes[:-1], self._h
        inner = [starts + share * h for share in TORQUE_SHARES]
        return np.concatenate(
            [np.stack(inner, axis=1).ravel(), [1.0], self.extra.torque]
        )

    # -- unknowns ----------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self._free * self._n + 1

    @property
    def rows(self) -> Rows:
        """What the rows are."""
        return self._rows

    @property
    def cost(self) -> Array:
        """Gradient of the duration."""
        cost = np.zeros(self.size)
        cost[-1] = 1.0
        return cost

    def points(self, z: Array) -> Array:
        """Control points, shape (M, n)."""
        return np.asarray(self._map @ z + self._offset).reshape(-1, self._n)

    def start(
        self, position: Callable[[Array], Array], guessed: float, duration: float
    ) -> Array:
        """Iterate for a guess: control points on the path at the Greville abscissae."""
        t, p = self._basis.knots, self.degree
        greville = np.array(
            [t[i + 1 : i + p + 1].mean() for i in range(self._basis.count)]
        )
        wanted = position(greville * guessed).ravel() - self._offset
        wanted -= self._map[:, -1].toarray().ravel() * duration
        free = self._map[:, :-1]
        count = np.maximum(np.asarray(free.sum(axis=0)).ravel(), 1.0)
        return np.append(np.asarray(free.T @ wanted) / count, duration)

    def fitted(self, times: Array, q: Array, duration: float) -> Array:
        """Iterate that is nearest to positions at shares of T, in least squares."""
        design = sp.kron(self._basis.at(times, 0), sp.identity(self._n), format="csr")
        free = (design @ self._map)[:, :-1]
        rest = q.ravel() - design @ (self._offset + self._map[:, -1:] @ [duration])
        points = spsolve((free.T @ free).tocsc(), free.T @ rest).reshape(-1, self._n)
        limits = self.system.problem.robot.limits
        points = np.clip(points, limits.position_lower, limits.position_upper)
        return np.append(points.ravel(), duration)

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Trust region within position limits."""
        limits = self.system.problem.robot.limits
        points = z[:-1].reshape(-1, self._n)
        box = np.broadcast_to(radius * self.system.step_scale, points.shape)
        lower = np.maximum(-box, np.minimum(limits.position_lower - points, 0.0))
        upper = np.minimum(box, np.maximum(limits.position_upper - points, 0.0))
        length = min(TIME_STEP, radius) * z[-1]
        return StepBounds(
            np.append(lower.ravel(), -length), np.append(upper.ravel(), length)
        )

    # -- rows --------------------------------------------------------------------------

    @cached_property
    def _linear(self) -> list[tuple[str, int, sp.csr_matrix, Array]]:
        """Derivatives in the hull of their control points: kind, order, matrix, limit.

        Rows are D C / (limit T^order); only joints with a limit have them.
        """
        problem, n = self.system.problem, self._n
        names, extra = problem.robot.joint_names, problem.motion_limits
        wanted = [("velocity", 1, problem.robot.limits.velocity)]
        if extra is not None:
            wanted.append(("acceleration", 2, extra.by_joint("acceleration", names)))
            wanted.append(("jerk", 3, extra.by_joint("jerk", names)))
        found = []
        for kind, order, limit in wanted:
            joints = np.flatnonzero(np.isfinite(limit))
            if not joints.size:
                continue
            D = self._basis.derivative(order)
            select = sp.csr_matrix(
                (1.0 / limit[joints], (np.arange(joints.size), joints)),
                shape=(joints.size, n),
            )
            # Scaled by T^order, which is of order 1 for the jerk of short motions too.
            found.append((kind, order, sp.kron(D, select, format="csr"), limit[joints]))
        return found

    def _build_rows(self) -> Rows:
        parts = self._motor.parts(self.extra.ways)
        for kind, _, matrix, _ in self._linear:
            ones = np.ones(matrix.shape[0])
            parts.append((kind, -ones, ones, np.zeros(ones.size, dtype=np.int64)))
        system = self.system
        if system.clearance is not None:
            count, instants = system.clearance.count, self._clear.size
            parts.append(
                (
                    "clearance",
                    np.full(instants * count, -np.inf),
                    np.zeros(instants * count),
                    np.repeat(np.arange(instants), count),
                )
            )
        if system.joint_goal is None or not self._fixed_end:
            lower, upper = system.goal_bounds
            group = np.zeros(lower.size, dtype=np.int64)
            parts.append(("goal", lower, upper, group))
        return Rows.stack(parts)

    def _states(self, z: Array, times: Array) -> tuple[Array, Array, Array]:
        C, T = self.points(z), z[-1]
        q, v, a = (np.asarray(self._basis.at(times, order) @ C) for order in range(3))
        return q, v / T, a / T**2

    def evaluate(self, z: Array) -> Array:
        """Row values."""
        system, T = self.system, z[-1]
        C = self.points(z)
        states = self._motor_states(z)
        ways = self._ways.given(lambda times: self._states(z, times))
        parts = [self._motor.values(states, T, ways)]
        parts += [
            np.asarray(matrix @ C.ravel()) / T**order
            for _, order, matrix, _ in self._linear
        ]
        if system.clearance is not None:
            q = np.asarray(self._clear_basis @ C)
            values = system.clearance.values(q, MAX_ATTENTION, T * self._clear)
            parts.append(values.ravel())
        if "goal" in self._rows.kinds:
            q, v, _ = self._states(z, np.ones(1))
            parts.append(self._goal(q[0], v[0])[0])
        return np.concatenate(parts)

    def _goal(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        return self.system.problem.goal.residual(self.system.kinematics, q, v)

    @cached_property
    def _clear_basis(self) -> sp.csr_matrix:
        return self._basis.at(self._clear, 0)

    @cached_property
    def _motor_basis(self) -> list[sp.csr_matrix]:
        return [self._basis.at(self._motor.times, order) for order in range(3)]

    def _motor_states(self, z: Array) -> tuple[Array, Array, Array]:
        C, T = self.points(z), z[-1]
        q, v, a = (np.asarray(B @ C) for B in self._motor_basis)
        return q, v / T, a / T**2

    def linearize(self, z: Array, values: Array, steps: StepBounds) -> Linearization:
        """Jacobian of the rows that can become active within a box of steps."""
        system, n, T = self.system, self._n, z[-1]
        C = self.points(z)
        states = self._motor_states(z)
        blocks = [self._motor.jacobian(states, self._motor_basis, T) @ self._chain]
        chosen = [np.arange(self._motor.size)]
        at = self._motor.size
        for _, order, matrix, _ in self._linear:
            by_points = matrix @ self._map / T**order
            by_time = -order * np.asarray(matrix @ C.ravel()) / T ** (order + 1)
            by_time = sp.csr_matrix(by_time[:, None])
            empty = sp.csr_matrix((matrix.shape[0], self.size - 1))
            blocks.append(by_points + sp.hstack([empty, by_time]))
            chosen.append(at + np.arange(matrix.shape[0]))
            at += matrix.shape[0]
        if system.clearance is not None:
            rows = at + np.arange(self._clear.size * system.clearance.count)
            radius = float(np.max(steps.upper[:-1], initial=0.0))
            attention = min(ATTENTION * radius, MAX_ATTENTION)
            if system.clearance.moving:
                attention = MAX_ATTENTION  # obstacles come closer as time goes by
            near = rows[values[rows] > -attention]
            blocks.append(self._clearance_jacobian(C, T, near - at))
            chosen.append(near)
            at += rows.size
        if "goal" in self._rows.kinds:
            q, v, _ = self._states(z, np.ones(1))
            _, by_q, by_v = self._goal(q[0], v[0])
            end = [
                sp.kron(self._basis.at(np.ones(1), order), sp.identity(n))
                for order in (0, 1)
            ]
            by_points = sp.csr_matrix(by_q) @ end[0] + sp.csr_matrix(by_v / T) @ end[1]
            by_time = np.zeros((by_q.shape[0], self.size))
            by_time[:, -1] = -by_v @ v[0] / T
            blocks.append(by_points @ self._map + sp.csr_matrix(by_time))
            chosen.append(at + np.arange(by_q.shape[0]))
        return Linearization(
            np.concatenate(chosen), sp.vstack(blocks, format="csr").tocsr()
        )

    @cached_property
    def _chain(self) -> sp.csr_matrix:
        """Derivative of (control points, T) with respect to z."""
        time = sp.csr_matrix(([1.0], ([0], [self.size - 1])), shape=(1, self.size))
        return sp.vstack([self._map, time], format="csr")

    def _clearance_jacobian(
        self, C: Array, T: float, chosen: IntArray
    ) -> sp.csr_matrix:
        clearance = self.system.clearance
        assert clearance is not None  # noqa: S101
        instants, which = np.divmod(chosen, clearance.count)
        q = np.asarray(self._clear_basis @ C)
        gradients, rates = clearance.derivatives_at(q, instants, which, T * self._clear)
        parts = [
            sp.kron(self._clear_basis[instant], gradients[instants == instant])
            for instant in np.unique(instants)
        ]
        if not parts:
            return sp.csr_matrix((0, self.size))
        by_points = sp.csr_matrix(sp.vstack(parts, format="csr") @ self._map)
        if not clearance.moving:
            return by_points
        by_time = sp.csr_matrix((rates * self._clear[instants])[:, None])
        empty = sp.csr_matrix((chosen.size, self.size - 1))
        return sp.csr_matrix(by_points + sp.hstack([empty, by_time]))

    # -- the rest of the interface -----------------------------------------------------

    def variation(self, z: Array) -> Variation:
        """Jumps between the control points of the jerk, in full torque ranges."""
        T, n = z[-1], self._n
        scale = self._motor.acceleration_range(self._motor_states(z))
        jerk = self._basis.derivative(3)
        jumps = sp.diags([-1.0, 1.0], [0, 1], shape=(jerk.shape[0] - 1, jerk.shape[0]))
        top = jumps @ jerk
        # As accelerations, over the interval that such a jump lasts.
        lasting = float(np.mean(self._h)) / T**2
        matrix = sp.kron(lasting * top, sp.diags(1.0 / scale), format="csr")
        full = matrix @ self._map
        values = np.asarray(matrix @ self.points(z).ravel())
        assert n == scale.size  # noqa: S101
        return Variation(sp.csr_matrix(full), values - np.asarray(full @ z))

    @property
    def torque_sequence(self) -> sp.csr_matrix:
        """Torques at nodes and between them, from the instants of their rows."""
        shape = (self.sequence_times.size, self._torque_times.size)
        return sp.csr_matrix(sp.eye(*shape))

    @property
    def sequence_times(self) -> Array:
        """Instants of that sequence as shares of T: nodes and middles."""
        return self._torque_times[: len(TORQUE_SHARES) * self._h.size + 1]

    def stretch(self, z: Array, factor: float) -> Array:
        """The same points, traversed slower."""
        out = z.copy()
        out[-1] *= factor
        return out

    def inspect(self, z: Array, overload: float) -> SplineExtra:
        """Instants at which clearances and torques should become rows, as shares of T.

        Args:
            z: Iterate.
            overload: Relative excess of torques that is let pass.
        """
        torque = self._overloaded(z, overload)
        extra = self._ways.turned(
            lambda times: self._states(z, times), torque, overload
        )
        return extra._replace(clearance=self._grazing(z))

    def with_rows(self, extra: SplineExtra) -> BSplineTranscription:
        """The same problem with rows at more instants."""
        joined = SplineExtra(
            np.concatenate([self.extra.clearance, extra.clearance]),
            np.concatenate([self.extra.torque, extra.torque]),
            extra.ways,
        )
        return BSplineTranscription(self.system, self.shares, self.degree, joined)

    def _overloaded(self, z: Array, tolerance: float) -> Array:
        times = (self._nodes[:-1] + np.outer(INSPECTED_SHARES, self._h)).T
        load = np.abs(self.system.torque(*self._states(z, times.ravel()))).max(axis=1)
        # The worst instant of either half of an interval.
        half = load.reshape(-1, len(INSPECTED_SHARES) // 2)
        worst = times.reshape(half.shape)[np.arange(len(half)), half.argmax(axis=1)]
        return np.asarray(worst[half.max(axis=1) > 1.0 + tolerance])

    def _grazing(self, z: Array) -> Array:
        points = self.points(z)

        def position(times: Array) -> Array:
            return np.asarray(self._basis.at(times, 0) @ points)

        return grazing_times(self.system, self._nodes, float(z[-1]), position)

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate; its torque follows from the inverse dynamics."""
        q, v, a = self._states(z, self._nodes)
        inverse = self.system.motors.inverse
        u = inverse(q, v, a)
        u[-1] += arrival(self.system.problem.robot.friction, v[-1], a[-1])
        return Trajectory(
            joint_names=self.system.problem.robot.joint_names,
            t=self._nodes * z[-1],
            q=q,
            v=v,
            u=u,
            a=a if self.degree > 3 else None,
            inverse_dynamics=inverse,
        )
