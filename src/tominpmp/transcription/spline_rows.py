"""States of quadratic splines at instants, and their derivatives by the unknowns.

Jacobians are with respect to (points, lengths, final position, final velocity) of
the spline, stacked in this order; the transcription multiplies them by the derivative
of these with respect to its unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.constraints import Partials, States
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.spline import Spline, SplineDerivatives


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

        And whether they exist: shapes (m, 3n + 3) for m intervals.
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


def states_at(spline: Spline, at: Instants) -> States:
    """States at instants."""
    k, r = at.interval, at.share[:, None]
    q, v = spline.q, spline.v
    position = (1 - r) ** 2 * q[k] + 2 * r * (1 - r) * spline.points[k]
    position = position + r**2 * q[k + 1]
    speed = (1 - r) * v[k] + r * v[k + 1]
    return States(at.times(spline.h), position, speed, spline.a[k])


def pull_back(
    spline: Spline,
    by: SplineDerivatives,
    at: Instants,
    partials: Partials,
    columns: Columns,
) -> sp.csr_matrix:
    """Derivatives by points, lengths and final state from those by states.

    Shape (k, columns) from the spline, its derivatives, and partial derivatives of k
    values by the states at instants.
    """
    n, which = columns.joints, partials.at
    state = StateDerivatives.of(at, by)
    by_point = np.zeros((which.size, 3, n))
    by_length = np.zeros((which.size, 3))
    for part, points, lengths in (
        (partials.by_q, state.q_points, state.q_lengths),
        (partials.by_v, state.v_points, state.v_lengths),
        (partials.by_a, state.a_points, state.a_lengths),
    ):
        if part is not None:
            by_point += points[which][:, :, None] * part[:, None, :]
            by_length += np.einsum("kjn,kn->kj", lengths[which], part)
    entries = Entries(which.size, columns.count)
    rows = np.arange(which.size)[:, None]
    places, valid = columns.around(at.interval)
    data = np.concatenate([by_point.reshape(which.size, -1), by_length], axis=1)
    entries.add(rows, places[which], data, valid[which])
    _add_final_state(entries, spline, at, partials, columns)
    if partials.by_t is not None:
        over = at.over(which, columns.intervals)
        entries.add(rows, columns.lengths, partials.by_t[:, None] * over)
    return entries.matrix()


def _add_final_state(
    entries: Entries, spline: Spline, at: Instants, partials: Partials, columns: Columns
) -> None:
    """In the last interval the final q and v are unknowns of their own."""
    n, which = columns.joints, partials.at
    last = np.flatnonzero(at.interval[which] == columns.intervals - 1)
    if not last.size:
        return
    share, final = at.share[which[last], None], columns.final_position
    rows, by_velocity = last[:, None], np.zeros((last.size, n))
    if partials.by_q is not None:
        entries.add(rows, final, share**2 * partials.by_q[last])
    if partials.by_v is not None:
        by_velocity += share * partials.by_v[last]
    if partials.by_a is not None:
        by_velocity += partials.by_a[last] / spline.h[-1]
    entries.add(rows, final + n, by_velocity)


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
