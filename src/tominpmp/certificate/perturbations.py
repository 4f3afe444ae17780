r"""Small changes of a motion, as linear maps of a few unknowns.

A motion is changed by its states at nodes, its accelerations between them, and its
duration. On each interval, with :math:`s` the share of it that has passed,

.. math:: \delta\ddot q = (1 - s)\, \delta a_0 + s\, \delta a_1,

and the double integrator carries positions and velocities over the interval exactly, so
that limits on them hold between the nodes as they do at the nodes. Which torque an
acceleration takes is left to the limits, by the inverse dynamics.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.motion.trajectory import Trajectory

# What is constant on an interval: the acceleration, its slope, or the torque.
Shape: TypeAlias = Literal["steps", "ramps", "torques"]

# No interval is longer than this share of the motion: longer ones are cut.
LONGEST = 0.05
# Beyond this number neighbours are joined while they are shorter than this share.
MOST = 300
SHORTEST = 0.0125
# Torques that change by this share of their range at a node jump there.
JUMP = 0.2
# Where torques are asked for inside an interval: just after and before a jump, in
# shares of the interval.
JUST_INSIDE = 1e-9


def certificate_grid(trajectory: Trajectory) -> tuple[Array, bool]:
    """Nodes at which a motion is looked at.

    Returns:
        Times [s], and whether intervals of the motion were joined. Without joining,
        all nodes of the motion are among them; with it those at which the torque jumps
        are, unless there are many.
    """
    t, T = trajectory.t, trajectory.duration
    joined = t.size - 1 > MOST
    if joined:
        jumps = _jumps(trajectory)
        if trajectory.segment_ends is not None:
            jumps |= np.isin(t, trajectory.segment_ends)
        kept = [0]
        for k in range(1, t.size - 1):
            if jumps[k] or t[k + 1] - t[kept[-1]] > SHORTEST * T:
                kept.append(k)
        t = t[[*kept, t.size - 1]]
    counts = np.maximum(np.ceil(np.diff(t) / (LONGEST * T) - 1e-9), 1.0)
    parts = [
        np.linspace(begin, end, int(count), endpoint=False)
        for begin, end, count in zip(t[:-1], t[1:], counts, strict=True)
    ]
    return np.concatenate([*parts, t[-1:]]), joined


def _jumps(trajectory: Trajectory) -> BoolArray:
    """Nodes at which a torque jumps, unless there are too many, shape (N + 1,)."""
    t = trajectory.t
    before = trajectory(t[1:-1] - JUST_INSIDE * np.diff(t)[:-1]).u
    height = np.abs(trajectory.u[1:-1] - before)
    span = np.ptp(trajectory.u, axis=0)
    found = np.zeros(t.size, dtype=bool)
    found[1:-1] = np.any(height > JUMP * span, axis=1)
    return found if np.count_nonzero(found) <= MOST // 4 else np.zeros_like(found)


class Linearised(NamedTuple):
    """A quantity linearised about the motion: how it changes, row by row.

    Attributes:
        matrix: By the unknowns, shape (m, size).
        by_length: By the lengths of the intervals, which all grow with the duration,
            shape (m, N) [1/s].
    """

    matrix: sp.csr_matrix
    by_length: sp.csr_matrix

    def __add__(self, other: object) -> Linearised:
        """Sum, row by row."""
        if not isinstance(other, Linearised):
            return NotImplemented
        return Linearised(self.matrix + other.matrix, self.by_length + other.by_length)

    def after(self, left: sp.spmatrix) -> Linearised:
        """The rows combined by a matrix from the left."""
        return Linearised((left @ self.matrix).tocsr(), (left @ self.by_length).tocsr())


def blocks(parts: Array) -> sp.csr_matrix:
    """Block-diagonal matrix of blocks of shape (m, k, n)."""
    m, k, n = parts.shape
    columns = np.repeat(np.arange(m) * n, k)[:, None] + np.arange(n)
    starts = np.arange(m * k + 1) * n
    return sp.csr_matrix((parts.ravel(), columns.ravel(), starts), shape=(m * k, m * n))


def picked(values: Array, m: int, at: IntArray) -> sp.csr_matrix:
    """Matrix whose rows combine the joints at one of m instants each.

    Args:
        values: By joint, shape (k, n).
        m: Number of instants.
        at: The instant of each row, shape (k,).
    """
    k, n = values.shape
    columns = at[:, None] * n + np.arange(n)
    starts = np.arange(k + 1) * n
    return sp.csr_matrix((values.ravel(), columns.ravel(), starts), shape=(k, m * n))


@dataclass(frozen=True, eq=False)
class Perturbations:
    """Small changes of a motion on a grid.

    The unknowns are, one after the other, the states (q, v) at all nodes but the first,
    which is given, and the accelerations: one of each interval, or with "ramps" one of
    each node. The change of the duration comes beside them.

    Attributes:
        t: Times of the nodes [s], shape (N + 1,).
        q: Positions there, shape (N + 1, n).
        v: Velocities there, shape (N + 1, n).
        shape: What is constant on the intervals.
    """

    t: Array
    q: Array
    v: Array
    shape: Shape

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @cached_property
    def h(self) -> Array:
        """Lengths of the intervals [s], shape (N,)."""
        return np.diff(self.t)

    @property
    def N(self) -> int:
        """Number of intervals."""
        return int(self.t.size - 1)

    @property
    def controls(self) -> int:
        """Number of accelerations of a joint."""
        return self.N + 1 if self.shape == "ramps" else self.N

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return (2 * self.N + self.controls) * self.n

    def _pick(self, columns: IntArray, known: IntArray | None = None) -> sp.csr_matrix:
        """Rows that pick unknowns; those that are known do not change."""
        data = np.ones(columns.size)
        if known is not None:
            data[known] = 0.0
        starts = np.arange(columns.size + 1)
        shape = (columns.size, self.size)
        picked = sp.csr_matrix((data, np.maximum(columns, 0), starts), shape=shape)
        picked.eliminate_zeros()
        return picked

    def _state_columns(self, part: int) -> IntArray:
        node = np.arange(-1, self.N)[:, None] * 2 * self.n
        return (node + part * self.n + np.arange(self.n)).ravel()

    @cached_property
    def positions(self) -> sp.csr_matrix:
        """Positions at the nodes, shape ((N + 1) n, size)."""
        return self._pick(self._state_columns(0), np.arange(self.n))

    @cached_property
    def velocities(self) -> sp.csr_matrix:
        """Velocities at the nodes, shape ((N + 1) n, size)."""
        return self._pick(self._state_columns(1), np.arange(self.n))

    def accelerations(self, end: int) -> sp.csr_matrix:
        """Accelerations at the beginnings (0) or ends (1) of the intervals."""
        shift = end * self.n if self.shape == "ramps" else 0
        first = 2 * self.N * self.n + shift
        return self._pick(first + np.arange(self.N * self.n))

    def _scaled(self, factor: Array) -> sp.dia_matrix:
        """Diagonal matrix of a factor an interval, shape (N n, N n)."""
        return sp.diags(np.repeat(factor, self.n))

    def _by_own_length(self, values: Array) -> sp.csr_matrix:
        """Values of shape (N, n), each by the length of its interval."""
        columns, starts = np.repeat(np.arange(self.N), self.n), np.arange(values.size)
        starts = np.append(starts, values.size)
        return sp.csr_matrix(
            (values.ravel(), columns, starts), shape=(values.size, self.N)
        )

    def position_at(self, share: float, q: Array) -> Linearised:
        """Positions inside the intervals, begun from the nodes before them.

        Args:
            share: Where, from 0 to 1.
            q: Positions there, shape (N, n).
        """
        rows, s, h = self.N * self.n, share, self.h
        first, last = s**2 / 2 - s**3 / 6, s**3 / 6
        matrix = (
            self.positions[:rows]
            + self._scaled(s * h) @ self.velocities[:rows]
            + self._scaled(first * h**2) @ self.accelerations(0)
            + self._scaled(last * h**2) @ self.accelerations(1)
        )
        # With the accelerations as they are: twice the way, less what is uniform of it.
        way = (q - self.q[:-1]) / h[:, None]
        by_length = self._by_own_length(2.0 * way - s * self.v[:-1])
        return Linearised(matrix.tocsr(), by_length)

    def velocity_at(self, share: float, v: Array) -> Linearised:
        """Velocities inside the intervals, likewise."""
        rows, s, h = self.N * self.n, share, self.h
        matrix = (
            self.velocities[:rows]
            + self._scaled((s - s**2 / 2) * h) @ self.accelerations(0)
            + self._scaled(s**2 / 2 * h) @ self.accelerations(1)
        )
        by_length = self._by_own_length((v - self.v[:-1]) / h[:, None])
        return Linearised(matrix.tocsr(), by_length)

    def inside(
        self, interval: IntArray, share: Array, q: Array, v: Array
    ) -> tuple[Linearised, Linearised, Linearised]:
        """Positions, velocities and accelerations at instants inside the intervals.

        Args:
            interval: Intervals of the instants, shape (m,).
            share: Where in them, from 0 to 1, shape (m,).
            q: Positions there, shape (m, n).
            v: Velocities there, shape (m, n).

        Returns:
            Rows of one instant after the other, m n each.
        """
        m, n, h, s = interval.size, self.n, self.h[interval], share
        rows = (interval[:, None] * n + np.arange(n)).ravel()

        def times(factor: Array, matrix: sp.csr_matrix) -> sp.csr_matrix:
            return sp.diags(np.repeat(factor, n)) @ matrix[rows]

        def by_own_length(values: Array) -> sp.csr_matrix:
            columns, starts = np.repeat(interval, n), np.arange(m * n + 1)
            return sp.csr_matrix((values.ravel(), columns, starts), (m * n, self.N))

        before = self.accelerations(0), self.accelerations(1)
        positions = (
            self.positions[rows]
            + times(s * h, self.velocities)
            + times((s**2 / 2 - s**3 / 6) * h**2, before[0])
            + times(s**3 / 6 * h**2, before[1])
        )
        velocities = (
            self.velocities[rows]
            + times((s - s**2 / 2) * h, before[0])
            + times(s**2 / 2 * h, before[1])
        )
        accelerations = times(1.0 - s, before[0]) + times(s, before[1])
        # With the accelerations as they are: twice the way, less what is uniform of it.
        way = (q - self.q[interval]) / h[:, None]
        gained = (v - self.v[interval]) / h[:, None]
        longer = 2.0 * way - s[:, None] * self.v[interval]
        return (
            Linearised(positions.tocsr(), by_own_length(longer)),
            Linearised(velocities.tocsr(), by_own_length(gained)),
            self.fixed(accelerations),
        )

    def fixed(self, matrix: sp.spmatrix) -> Linearised:
        """Something that does not depend on the lengths of the intervals."""
        rows = matrix.shape[0]
        return Linearised(matrix.tocsr(), sp.csr_matrix((rows, self.N)))

    def gaps(self) -> Linearised:
        """Positions and velocities at the nodes less those that the intervals lead to.

        Zero for changes that a motion can make: the equations of motion. Rows are
        (q, v) of one node after the other, shape (2 N n,).
        """
        N, n = self.N, self.n
        q, v = self.position_at(1.0, self.q[1:]), self.velocity_at(1.0, self.v[1:])
        order = np.arange(2 * N * n).reshape(2, N, n).swapaxes(0, 1).ravel()
        led = Linearised(
            sp.vstack([q.matrix, v.matrix], format="csr")[order],
            sp.vstack([q.by_length, v.by_length], format="csr")[order],
        )
        states = sp.identity(2 * N * n, format="csr")
        states.resize(2 * N * n, self.size)
        return Linearised(states - led.matrix, -led.by_length)

    def rises(self, begin: Linearised, end: Linearised, slopes: Array) -> Linearised:
        """Slopes over time on each interval, from its beginning to its end.

        Args:
            begin: Changes of something of each joint at the beginnings, N n rows.
            end: Those at the ends.
            slopes: What the slopes are now, shape (N, n).
        """
        rise = Linearised(end.matrix - begin.matrix, end.by_length - begin.by_length)
        out = rise.after(self._scaled(1.0 / self.h))
        by_length = self._by_own_length(-slopes / self.h[:, None])
        return Linearised(out.matrix, out.by_length + by_length)

    def differences(self, what: Linearised, values: Array) -> Linearised:
        """Slopes over time between the middles of neighbouring intervals.

        Args:
            what: Changes of something of each joint on each interval, N n rows.
            values: What is there now, shape (N, n).
        """
        n, h = self.n, self.h
        apart = 0.5 * (h[1:] + h[:-1])
        weight = np.repeat(1.0 / apart, n)
        rows = weight.size
        step = sp.diags([-weight, weight], [0, n], shape=(rows, rows + n))
        slopes = -(np.diff(values, axis=0) / apart[:, None] ** 2 / 2.0).ravel()
        interval = np.repeat(np.arange(self.N - 1), n)
        every = np.arange(rows)
        by_length = sp.csr_matrix(
            (
                np.tile(slopes, 2),
                (np.tile(every, 2), np.append(interval, interval + 1)),
            ),
            shape=(rows, self.N),
        )
        out = what.after(step.tocsr())
        return Linearised(out.matrix, out.by_length + by_length)
