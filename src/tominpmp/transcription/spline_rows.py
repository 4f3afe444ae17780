"""States of quadratic splines at instants, and their derivatives by the unknowns.

Jacobians are with respect to the unknowns of the transcription: points, of which the
first and the last are the ends, the final velocity, and what lengths are shares of.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints import Partials, States
from tominpmp.linear_programs.compressed import Compressed
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


def states_at(spline: Spline, at: Instants) -> States:
    """States at instants."""
    k, r = at.interval, at.share[:, None]
    q, v = spline.q, spline.v
    position = (1 - r) ** 2 * q[k] + 2 * r * (1 - r) * spline.points[k]
    position = position + r**2 * q[k + 1]
    speed = (1 - r) * v[k] + r * v[k + 1]
    return States(at.times(spline.h), position, speed, spline.a[k])


class ByPoints(NamedTuple):
    """Derivatives of values by coordinates of points of a spline.

    Attributes:
        data: The derivatives, shape (k, w).
        places: Which of all coordinates they are by, ascending, shape (k, w): n a
            point. Negative, or beyond the last, where there is none.
    """

    data: Array
    places: IntArray

    @classmethod
    def around(cls, interval: IntArray, data: Array, intervals: int) -> ByPoints:
        """By the points before, of and after intervals, from shape (k, 3, n)."""
        k, _, n = data.shape
        point = interval[:, None] + np.array([-1, 0, 1])
        point = np.where(point < intervals, point, -1)
        places = np.where(point < 0, -n, n * point)[:, :, None] + np.arange(n)
        return cls(data.reshape(k, -1), places.reshape(k, -1))

    def through_ends(self, spline: Spline, shares: Array) -> tuple[Array, Array]:
        """Derivatives by the final velocity and lengths, as the end points move.

        Points are those of the curve: the first and the last hang on the velocities and
        lengths beside them.

        Args:
            spline: The spline.
            shares: Lengths of the intervals by the last unknowns, shape (N, m).

        Returns:
            Shapes (k, n) and (k, m).
        """
        (N, n), (v_start, v_end) = spline.points.shape, spline.v_ends
        by_velocity = np.zeros((len(self.data), n))
        by_lengths = np.zeros((len(self.data), shares.shape[1]))
        row, column = np.nonzero(self.places >= (N - 1) * n)
        if row.size:
            joint, data = self.places[row, column] - (N - 1) * n, self.data[row, column]
            by_velocity[row, joint] = -0.5 * spline.h[-1] * data
            along = np.bincount(row, -0.5 * v_end[joint] * data, len(self.data))
            by_lengths += along[:, None] * shares[-1]
        if np.any(v_start):
            start = np.where((self.places >= 0) & (self.places < n), self.places, -1)
            speeds = np.append(0.5 * v_start, 0.0)[start]
            along = np.einsum("kw,kw->k", self.data, speeds)
            by_lengths += along[:, None] * shares[0]
        return by_velocity, by_lengths

    def by_unknowns(
        self, by_velocity: Array, by_lengths: Array, intervals: int
    ) -> sp.csr_matrix:
        """The Jacobian of the values, with derivatives by the other unknowns."""
        (k, n), m = by_velocity.shape, by_lengths.shape[1]
        first, size = intervals * n, intervals * n + n + m
        rest = np.broadcast_to(np.arange(first, size), (k, n + m))
        return Compressed.of_table(
            np.concatenate([self.data, by_velocity, by_lengths], axis=1),
            np.concatenate([self.places, rest], axis=1),
            size,
        ).rows()


def pull_back(
    spline: Spline,
    by: SplineDerivatives,
    at: Instants,
    partials: Partials,
    shares: Array,
) -> sp.csr_matrix:
    """Derivatives by the unknowns from those by the states.

    Shape (k, size) from the spline, its derivatives, partial derivatives of k values by
    the states at instants, and lengths of the intervals by the last unknowns, shape
    (N, m).
    """
    (N, n), which = spline.points.shape, partials.at
    interval = at.interval[which]
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
    found = ByPoints.around(interval, by_point, N)
    by_velocity, by_lengths = found.through_ends(spline, shares)
    around = np.pad(shares, ((1, 1), (0, 0)))[interval[:, None] + np.arange(3)]
    by_lengths += np.einsum("kj,kjm->km", by_length, around)
    if partials.by_t is not None:
        by_lengths += partials.by_t[:, None] * (at.over(which, N) @ shares)
    # In the last interval the final q and v are unknowns of their own.
    last = np.flatnonzero(interval == N - 1)
    share = at.share[which[last], None]
    if partials.by_q is not None:
        found.data[last, n : 2 * n] += share**2 * partials.by_q[last]
    if partials.by_v is not None:
        by_velocity[last] += share * partials.by_v[last]
    if partials.by_a is not None:
        by_velocity[last] += partials.by_a[last] / spline.h[-1]
    return found.by_unknowns(by_velocity, by_lengths, N)


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


def speeds_by_points(
    limit: Array, joints: IntArray, unit: float, intervals: int, n: int
) -> ByPoints:
    """Derivatives of :func:`speed_values` by points, of n joints in all.

    Those by the two lengths at the node of each row are -0.5 / unit.
    """
    node = np.arange(intervals - 1)[:, None]
    before = (node * n + joints).ravel()
    slope = np.tile(1.0 / (limit * unit), intervals - 1)
    data = np.stack([-slope, slope], axis=1)
    places = np.stack([before, before + n], axis=1)
    return ByPoints(np.concatenate([data, -data]), np.concatenate([places, places]))


def jumps_by_points(h: Array, scale: Array) -> ByPoints:
    """Jumps of accelerations at inner nodes by points, over a scale of each joint.

    The rows are of all n joints at the first node, at the second, ...

    Args:
        h: Lengths of the intervals [s], shape (N,).
        scale: Shape (n,).
    """
    N, n = h.size, scale.size
    # Velocities at nodes by the points beside them: those at the ends are given.
    rise = np.zeros(N + 1)
    rise[1:-1] = 2.0 / (h[:-1] + h[1:])
    before, here = rise[:-2] / h[:-1], rise[1:-1] * (1.0 / h[1:] + 1.0 / h[:-1])
    after = rise[2:] / h[1:]
    jumps = np.stack([-before, before + here, -here - after, after], axis=1)
    data = jumps[:, None] / scale[:, None]
    point = np.arange(1, N)[:, None] + np.arange(-2, 2)
    places = n * point[:, None] + np.arange(n)[:, None]
    return ByPoints(data.reshape(-1, 4), places.reshape(-1, 4))
