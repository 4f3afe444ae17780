"""Rows for what motors can do: torques, torques over speed, torque rates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.motion_limits import EffortCurve
from tominpmp.transcription.system import System
from tominpmp.transcription.ways import Ways

# A torque rate is taken over this share of an interval, at both of its ends.
RATE_SHARE = 0.05

Part = tuple[str, Array, Array, IntArray]
States = tuple[Array, Array, Array]


@dataclass(frozen=True, eq=False)
class MotorRows:
    """Rows on torques at instants of a smooth motion.

    Attributes:
        system: Dynamics and limits.
        times: Instants at which torques are needed, as shares of T, shape (m,).
        loads: Those at which torques are rows, indices into ``times``.
        rates: Pairs of instants over which torque rates are rows, shape (r, 2).
        rate: Largest torque rates of the joints that have one [N m/s], shape (k,).
        rated: These joints, shape (k,).
        curves: Curves of torque over speed by joint.
    """

    system: System
    times: Array
    loads: IntArray
    rates: IntArray
    rate: Array
    rated: IntArray
    curves: tuple[tuple[int, EffortCurve], ...]

    @classmethod
    def of(cls, system: System, nodes: Array, torque_times: Array) -> MotorRows:
        """Rows for a problem on a grid of nodes, torques being rows at given times."""
        problem = system.problem
        names, limits = problem.robot.joint_names, problem.motion_limits
        times, loads = torque_times, np.arange(torque_times.size)
        pairs = np.zeros((0, 2), dtype=np.int64)
        rate, rated = np.zeros(0), np.zeros(0, dtype=np.int64)
        curves: list[tuple[int, EffortCurve]] = []
        if limits is not None:
            every = limits.by_joint("effort_rate", names)
            rated = np.flatnonzero(np.isfinite(every))
            rate = every[rated]
            if rated.size:
                h = RATE_SHARE * np.diff(nodes)
                left, right = nodes[:-1], nodes[1:]
                # A hair inside, so that both are of the same interval.
                ends = np.stack([left, left + h, right - h, right - 1e-9 * h], axis=1)
                first = times.size + 4 * np.arange(h.size)[:, None]
                pairs = (first + np.array([0, 1, 2, 3])).reshape(-1, 2)
                times = np.concatenate([times, ends.ravel()])
            curves = [
                (names.index(joint), curve)
                for joint, curve in sorted((limits.effort_curves or {}).items())
            ]
        return cls(system, times, loads, pairs, rate, rated, tuple(curves))

    @property
    def size(self) -> int:
        """Number of rows."""
        torques = self.loads.size * self.system.n
        return int(
            torques
            + self.rates.shape[0] * self.rated.size
            + 2 * self.loads.size * len(self.curves)
        )

    def parts(self, ways: Ways | None = None) -> list[Part]:
        """Kinds and bounds of the rows, with the ways of joints with dry friction."""

        def both(kind: str, most: Array) -> Part:
            return kind, -most, most, np.zeros(most.size, dtype=np.int64)

        most = np.ones(self.loads.size * self.system.n)
        parts = [both("torque", most if ways is None else ways.bound.ravel())]
        if self.rated.size:
            most = np.ones(self.rates.shape[0] * self.rated.size)
            parts.append(both("torque rate", most))
        if self.curves:
            count = 2 * self.loads.size * len(self.curves)
            below = np.full(count, -np.inf)
            group = np.zeros(count, dtype=np.int64)
            parts.append(("torque over speed", below, np.zeros(count), group))
        return parts

    def values(self, states: States, T: float, ways: Ways | None = None) -> Array:
        """Row values.

        Args:
            states: Positions, velocities and accelerations at ``times``, shape (m, n).
            T: Duration [s].
            ways: Which way joints with dry friction move where torques are rows. A
                rate leaves out its jumps, which no rate of a motor can follow.

        Returns:
            Torques and torque rates as shares of their limits, and torques beyond
            their curves in shares of the torque limits.
        """
        system = self.system
        tau = system.dynamics.inverse(*states)
        load = (tau - system.effort_middle)[self.loads] / system.effort_half
        if ways is not None:
            load = load + ways.load
        parts = [load.ravel()]
        if self.rated.size:
            rise = np.diff(tau[self.rates][:, :, self.rated], axis=1)[:, 0]
            parts.append((rise / (self._spans[:, None] * T * self.rate)).ravel())
        for joint, curve in self.curves:
            largest = curve(states[1][self.loads, joint])[0]
            torque, half = tau[self.loads, joint], system.effort_half[joint]
            if ways is not None:
                torque = torque + half * ways.load[:, joint]
                spread = half * (1.0 - ways.bound[:, joint])
                largest = largest - spread
            parts += [(torque - largest) / half, (-torque - largest) / half]
        return np.concatenate(parts)

    @property
    def _spans(self) -> Array:
        return np.asarray(np.diff(self.times[self.rates], axis=1)[:, 0])

    def jacobian(
        self, states: States, basis: list[sp.csr_matrix], T: float
    ) -> sp.csr_matrix:
        """Jacobian with respect to control points and T.

        Args:
            states: As for :meth:`values`.
            basis: Matrices that give position, velocity times T and acceleration times
                T^2 at ``times`` from the control points, shape (m, M) each.
            T: Duration [s].

        Returns:
            Shape (size, M n + 1).
        """
        system = self.system
        by = system.dynamics.inverse_jacobians(*states)
        B = [np.asarray(matrix.todense()) for matrix in basis]
        _, v, a = states
        by_points = sum(
            np.einsum("mij,mc->micj", part, matrix / T**order)
            for order, (part, matrix) in enumerate(
                zip((by.tau_q, by.tau_v, by.tau_a), B, strict=True)
            )
        )
        by_time = -np.einsum("mij,mj->mi", by.tau_v, v) / T
        by_time -= 2.0 * np.einsum("mij,mj->mi", by.tau_a, a) / T
        m, n = v.shape
        full = np.concatenate(
            [np.asarray(by_points).reshape(m, n, -1), by_time[:, :, None]], axis=2
        )  # (m, n, M n + 1)
        width = full.shape[2]
        parts = [(full[self.loads] / system.effort_half[:, None]).reshape(-1, width)]
        if self.rated.size:
            parts.append(self._rate_jacobian(states, full, T))
        for joint, curve in self.curves:
            parts.append(self._curve_jacobian(joint, curve, v, full, B[1], T))
        return sp.csr_matrix(np.concatenate(parts))

    def _rate_jacobian(self, states: States, full: Array, T: float) -> Array:
        tau = self.system.dynamics.inverse(*states)[self.rates][:, :, self.rated]
        scale = (self._spans[:, None] * T * self.rate)[:, :, None]
        first, second = self.rates[:, 0], self.rates[:, 1]
        out = (full[second][:, self.rated] - full[first][:, self.rated]) / scale
        out[:, :, -1] -= (tau[:, 1] - tau[:, 0]) / scale[:, :, 0] / T
        return np.asarray(out.reshape(-1, full.shape[2]))

    def _curve_jacobian(
        self,
        joint: int,
        curve: EffortCurve,
        v: Array,
        full: Array,
        slope_basis: Array,
        T: float,
    ) -> Array:
        speed, n = v[self.loads, joint], v.shape[1]
        slope = curve(speed)[1] * np.sign(speed)
        by_speed = np.zeros((self.loads.size, full.shape[2]))
        by_speed[:, joint : full.shape[2] - 1 : n] = slope_basis[self.loads] / T
        by_speed[:, -1] = -speed / T
        drop = slope[:, None] * by_speed
        torque, half = full[self.loads, joint], self.system.effort_half[joint]
        both = np.concatenate([torque - drop, -torque - drop])
        return np.asarray(both / half)

    def acceleration_range(self, states: States) -> Array:
        """What the full torque range of each joint brings about, shape (n,)."""
        by = self.system.dynamics.inverse_jacobians(*states)
        mass = np.abs(np.einsum("mii->mi", by.tau_a)).mean(axis=0)
        return np.asarray(2.0 * self.system.effort_half / np.maximum(mass, 1e-12))
