"""Rows of the inverse transcription as blocks: values and sparse Jacobians.

The Jacobians are with respect to (points, lengths, final position, final velocity) of
the spline, stacked in this order; the transcription multiplies them by the derivative
of these with respect to its unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.dynamics import InverseJacobians
from tominpmp.transcription.spline import Spline, SplineDerivatives


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants within intervals.

    Attributes:
        interval: Index of the interval, shape (m,).
        share: Where in it, from 0 to 1, shape (m,).
    """

    interval: IntArray
    share: Array

    def joined(self, other: Instants) -> Instants:
        """These instants and others."""
        return Instants(
            np.concatenate([self.interval, other.interval]),
            np.concatenate([self.share, other.share]),
        )

    @property
    def size(self) -> int:
        """Number of instants."""
        return int(self.interval.size)

    def times(self, h: Array) -> Array:
        """Times of the instants [s], shape (m,).

        Args:
            h: Lengths of the intervals [s], shape (N,).
        """
        nodes = np.cumsum(h) - h
        return np.asarray(nodes[self.interval] + self.share * h[self.interval])

    def states(self, spline: Spline) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations there, shape (m, n) each."""
        k, r = self.interval, self.share[:, None]
        q, v = spline.q, spline.v
        position = (1 - r) ** 2 * q[k] + 2 * r * (1 - r) * spline.points[k]
        return position + r**2 * q[k + 1], (1 - r) * v[k] + r * v[k + 1], spline.a[k]


@dataclass(frozen=True, eq=False)
class StateDerivatives:
    """How states at instants depend on points and lengths of a spline.

    Coefficients are for (P_{k-1}, P_k, P_{k+1}) and vectors for (h_{k-1}, h_k, h_{k+1})
    of the interval k of the instant, as in :class:`SplineDerivatives`.

    Attributes:
        q_points: Shape (m, 3).
        v_points: Shape (m, 3).
        a_points: Shape (m, 3).
        q_lengths: Shape (m, 3, n).
        v_lengths: Shape (m, 3, n).
        a_lengths: Shape (m, 3, n).
    """

    q_points: Array
    v_points: Array
    a_points: Array
    q_lengths: Array
    v_lengths: Array
    a_lengths: Array

    @classmethod
    def of(cls, at: Instants, by: SplineDerivatives) -> StateDerivatives:
        """Derivatives at instants from those at both ends of the intervals."""
        k, r = at.interval, at.share[:, None]
        q_points = (1 - r) ** 2 * by.q_points[0, k] + r**2 * by.q_points[1, k]
        q_points[:, 1:2] += 2 * r * (1 - r)
        v_points = (1 - r) * by.v_points[0, k] + r * by.v_points[1, k]
        r = r[:, :, None]
        q_lengths = (1 - r) ** 2 * by.q_lengths[0, k] + r**2 * by.q_lengths[1, k]
        v_lengths = (1 - r) * by.v_lengths[0, k] + r * by.v_lengths[1, k]
        return cls(
            q_points,
            v_points,
            by.a_points[k],
            q_lengths,
            v_lengths,
            by.a_lengths[k],
        )


@dataclass(frozen=True, eq=False)
class Columns:
    """Where points, lengths and the final state stand among the columns.

    Attributes:
        intervals: Number N of intervals.
        joints: Number n of joints.
    """

    intervals: int
    joints: int

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.intervals * self.joints + self.intervals + 2 * self.joints

    @property
    def lengths(self) -> IntArray:
        """Columns of the lengths, shape (N,)."""
        return self.intervals * self.joints + np.arange(self.intervals)

    @property
    def final_position(self) -> IntArray:
        """Columns of the final position, shape (n,)."""
        return self.count - 2 * self.joints + np.arange(self.joints)

    def around(self, interval: IntArray) -> tuple[IntArray, BoolArray]:
        """Columns of three points and three lengths around intervals.

        Args:
            interval: Indices, shape (m,).

        Returns:
            Columns and whether they exist, shapes (m, 3n + 3).
        """
        N, n = self.intervals, self.joints
        neighbour = interval[:, None] + np.array([-1, 0, 1])
        valid = (neighbour >= 0) & (neighbour < N)
        points = (neighbour[:, :, None] * n + np.arange(n)).reshape(-1, 3 * n)
        columns = np.concatenate([points, N * n + neighbour], axis=1)
        return columns, np.concatenate([np.repeat(valid, n, axis=1), valid], axis=1)


class Entries:
    """Entries of a sparse matrix, collected block by block.

    Attributes:
        rows: Number of rows.
        columns: Number of columns.
    """

    def __init__(self, rows: int, columns: int) -> None:
        self.rows, self.columns = rows, columns
        self._parts: list[tuple[IntArray, IntArray, Array]] = []

    def add(
        self,
        rows: IntArray,
        columns: IntArray,
        data: Array,
        valid: BoolArray | None = None,
    ) -> None:
        """Add the valid ones of some entries; those in one place add up."""
        rows, columns = (
            np.broadcast_to(rows, data.shape),
            np.broadcast_to(columns, data.shape),
        )
        if valid is None:
            self._parts.append((rows.ravel(), columns.ravel(), data.ravel()))
            return
        keep = np.broadcast_to(valid, data.shape)
        self._parts.append((rows[keep], columns[keep], data[keep]))

    def matrix(self) -> sp.csr_matrix:
        """The matrix."""
        if not self._parts:
            return sp.csr_matrix((self.rows, self.columns))
        rows, columns, data = (
            np.concatenate(part) for part in zip(*self._parts, strict=True)
        )
        return sp.csr_matrix((data, (rows, columns)), shape=(self.rows, self.columns))


def torque_jacobian(
    at: Instants,
    parts: InverseJacobians,
    scale: Array,
    by: StateDerivatives,
    spline: Spline,
    columns: Columns,
) -> sp.csr_matrix:
    """Jacobian of torques at instants.

    Args:
        at: The instants, m of them.
        parts: Derivatives of the inverse dynamics there.
        scale: Torques are divided by this, shape (n,).
        by: Derivatives of the states there.
        spline: The motion.
        columns: Where the unknowns stand.

    Returns:
        Shape (m n, columns), rows by instant, then joint.
    """
    n, N = columns.joints, columns.intervals
    tau_q, tau_v, tau_a = (
        part / scale[:, None] for part in (parts.tau_q, parts.tau_v, parts.tau_a)
    )
    by_point = (
        tau_q[:, :, None, :] * by.q_points[:, None, :, None]
        + tau_v[:, :, None, :] * by.v_points[:, None, :, None]
        + tau_a[:, :, None, :] * by.a_points[:, None, :, None]
    ).reshape(at.size, n, 3 * n)
    by_length = (
        tau_q @ np.swapaxes(by.q_lengths, 1, 2)
        + tau_v @ np.swapaxes(by.v_lengths, 1, 2)
        + tau_a @ np.swapaxes(by.a_lengths, 1, 2)
    )
    entries = Entries(at.size * n, columns.count)
    rows = np.arange(at.size * n).reshape(at.size, n, 1)
    places, valid = columns.around(at.interval)
    data = np.concatenate([by_point, by_length], axis=2)
    entries.add(rows, places[:, None, :], data, valid[:, None, :])
    # In the last interval the final q and v are unknowns of their own.
    last = np.flatnonzero(at.interval == N - 1)
    weight, final = at.share[last, None, None], columns.final_position
    entries.add(rows[last], final, weight**2 * tau_q[last])
    by_velocity = weight * tau_v[last] + tau_a[last] / spline.h[-1]
    entries.add(rows[last], final + n, by_velocity)
    return entries.matrix()


def speed_values(spline: Spline, limit: Array, joints: IntArray, unit: float) -> Array:
    """Speeds beyond their limits at the inner nodes, either way.

    |v_k| <= v_max times h_{k-1} + h_k is linear in points and lengths.

    Args:
        spline: The motion.
        limit: Velocity limits of the chosen joints, shape (k,).
        joints: The joints, shape (k,).
        unit: Length of an interval that makes the rows relative [s].

    Returns:
        Shape (2 (N - 1) k,), at most 0 within the limits.
    """
    s = (spline.h[:-1] + spline.h[1:])[:, None]
    ratio = 2.0 * np.diff(spline.points, axis=0)[:, joints] / limit
    return (np.stack([ratio - s, -ratio - s]) / (2.0 * unit)).ravel()


def speed_jacobian(
    limit: Array, joints: IntArray, unit: float, columns: Columns
) -> sp.csr_matrix:
    """Jacobian of :func:`speed_values`, which does not depend on the motion."""
    N, n = columns.intervals, columns.joints
    node = np.arange(N - 1)[:, None]
    entries = Entries(2 * (N - 1) * joints.size, columns.count)
    first = (node * joints.size + np.arange(joints.size)).astype(np.int64)
    slope = np.broadcast_to(1.0 / (limit * unit), first.shape)
    length = np.full(first.shape, -0.5 / unit)
    for sign, rows in ((1.0, first), (-1.0, first + (N - 1) * joints.size)):
        entries.add(rows, (node + 1) * n + joints, sign * slope)
        entries.add(rows, node * n + joints, -sign * slope)
        entries.add(rows, N * n + node, length)
        entries.add(rows, N * n + node + 1, length)
    return entries.matrix()
