r"""Small changes of a motion, as linear maps of a few unknowns.

A motion is changed by its states at nodes, its accelerations between them, and its
duration. On each interval, with :math:`s` the share of it that has passed,

.. math:: \delta\ddot q = (1 - s)\, \delta a_0 + s\, \delta a_1,

and the double integrator carries positions and velocities over the interval exactly, so
that limits on them hold between the nodes as they do at the nodes. The rows of the
limits turn accelerations into torques, by the inverse dynamics.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.motion.trajectory import Trajectory

# The quantity that is constant on an interval: the acceleration, its slope, or the
# torque.
Shape: TypeAlias = Literal["steps", "ramps", "torques"]

# Offset of an interval, its beginning (0) or end (1), and weight of the value there.
Stencil: TypeAlias = tuple[tuple[int, int, float], ...]
BEGIN: Stencil = ((0, 0, 1.0),)
END: Stencil = ((0, 1, 1.0),)
MEAN: Stencil = ((0, 0, 0.5), (0, 1, 0.5))

# Intervals longer than this share of the motion are cut.
LONGEST = 0.05
# Beyond this number of intervals neighbours are merged up to this share of the motion.
MOST = 300
SHORTEST = 0.0125
# Torques that change by this share of their range at a node jump there.
JUMP = 0.2
# Distance from a node at which torques just after and before a jump are evaluated, in
# shares of the interval.
JUST_INSIDE = 1e-9


def certificate_grid(trajectory: Trajectory) -> tuple[Array, bool]:
    """Nodes at which a motion is examined.

    Returns:
        Times [s], and whether intervals of the motion were merged. Without merging, all
        nodes of the motion are kept; with it, nodes at which the torque jumps are kept,
        unless there are many.
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
    """The change of a quantity, linearised about the motion, row by row.

    Attributes:
        matrix: Derivatives by the unknowns, shape (m, size).
        by_length: Derivatives by the lengths of the intervals, which all grow with the
            duration, shape (m, N) [1/s].
    """

    matrix: sp.csr_matrix
    by_length: sp.csr_matrix

    def __add__(self, other: object) -> Linearised:
        """Sum, row by row."""
        if not isinstance(other, Linearised):
            return NotImplemented
        return Linearised(self.matrix + other.matrix, self.by_length + other.by_length)

    def times(self, factor: Array) -> Linearised:
        """Each row multiplied by its factor, shape (m,)."""
        scale = sp.diags(factor)
        return Linearised(*((scale @ part).tocsr() for part in self))

    def kept(self, rows: IntArray | BoolArray) -> Linearised:
        """Some of the rows."""
        return Linearised(self.matrix[rows], self.by_length[rows])

    @classmethod
    def stacked(cls, parts: list[Linearised]) -> Linearised:
        """The rows of one quantity after the other."""
        both = zip(*parts, strict=True)
        return cls(*(sp.vstack(each, format="csr") for each in both))


class Instants(NamedTuple):
    """Instants of a motion on a grid, interval by interval.

    Attributes:
        interval: Interval of each instant, shape (m,).
        share: Share of the interval that has passed, from 0 to 1, shape (m,).
    """

    interval: IntArray
    share: Array

    @classmethod
    def spread(cls, span: tuple[int, int], shares: Array) -> Instants:
        """The same shares of all intervals from a first one, up to an end."""
        every = np.arange(*span)
        return cls(np.repeat(every, shares.size), np.tile(shares, every.size))

    @property
    def inside(self) -> Instants:
        """The instants, moved just inside of their intervals from the ends of them."""
        share = np.clip(self.share, JUST_INSIDE, 1.0 - JUST_INSIDE)
        return Instants(self.interval, share)

    def kept(self, which: IntArray | BoolArray) -> Instants:
        """Some of the instants."""
        return Instants(self.interval[which], self.share[which])


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
        shape: The quantity that is constant on the intervals.
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

    # -- instants ----------------------------------------------------------------------

    def times(self, at: Instants) -> Array:
        """Times of instants [s], shape (m,)."""
        inside = self.t[at.interval] + at.share * self.h[at.interval]
        return np.where(at.share >= 1.0, self.t[at.interval + 1], inside)

    def instants(self, times: Array) -> Instants:
        """The instants at times [s] within the motion, shape (m,)."""
        interval = np.searchsorted(self.t, times, side="left") - 1
        interval = np.clip(interval, 0, self.N - 1)
        share = (times - self.t[interval]) / self.h[interval]
        return Instants(interval, np.clip(share, 0.0, 1.0))

    # -- states ------------------------------------------------------------------------

    def values(
        self,
        at: Instants,
        q: Array,
        v: Array,
        *slopes: Array,
        carried: bool = False,
    ) -> Linearised:
        """Values that depend on the states at instants.

        States inside an interval begin from the node before it; at its end they are
        those of the node there.

        Args:
            at: The instants, m of them.
            q: Positions there, shape (m, n).
            v: Velocities there, shape (m, n).
            *slopes: Derivatives by position, velocity and acceleration, up to the order
                of the values, shape (m, n), or of k values at an instant (m, k, n).
            carried: Whether ends of intervals begin from the node before, too.

        Returns:
            Rows of one instant after the other, m k in all.
        """
        n, N, interval, s = self.n, self.N, at.interval, at.share
        given = [part if part.ndim == 3 else part[:, None] for part in slopes]
        none = np.zeros_like(given[0])
        by_q, by_v, by_a = (*given, none, none)[:3]
        ended = (s >= 1.0) & (not carried)
        node, h = interval + ended, self.h[interval]
        passed = np.where(ended, 0.0, s)
        p, t, after = (part[:, None, None] for part in (passed, passed * h, s))
        by_unknowns = [
            by_q,
            t * by_q + by_v,
            (1 / 2 - p / 6) * t**2 * by_q + (1 - p / 2) * t * by_v + (1 - after) * by_a,
            p / 6 * t**2 * by_q + p / 2 * t * by_v + after * by_a,
        ]
        last = interval + (self.shape == "ramps")
        first = [2 * node - 2, 2 * node - 1, 2 * N + interval, 2 * N + last]
        columns = np.concatenate([n * k[:, None] + np.arange(n) for k in first], axis=1)
        # The state at the first node does not change.
        data = np.where(columns[:, None] < 0, 0.0, np.concatenate(by_unknowns, axis=2))
        columns = np.broadcast_to(np.maximum(columns, 0)[:, None], data.shape)
        rows = data.shape[0] * data.shape[1]
        starts = 4 * n * np.arange(rows + 1)
        matrix = sp.csr_matrix(
            (data.ravel(), columns.ravel(), starts), (rows, self.size)
        )
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
        # A longer interval with unchanged accelerations adds twice the displacement,
        # less its part by the initial velocity.
        run = ~ended[:, None] / h[:, None]
        way, gained = (q - self.q[node]) * run, (v - self.v[node]) * run
        longer = 2.0 * way - passed[:, None] * self.v[node]
        own = np.einsum("mkn,mn->mk", by_q, longer)
        own += np.einsum("mkn,mn->mk", by_v, gained)
        owner = np.repeat(interval, own.shape[1])
        by_length = sp.csr_matrix((own.ravel(), owner, np.arange(rows + 1)), (rows, N))
        by_length.eliminate_zeros()
        return Linearised(matrix, by_length)

    def nothing(self, rows: int) -> Linearised:
        """Rows that do not change, as many as given."""
        columns = self.size, self.N
        return Linearised(*(sp.csr_matrix((rows, count)) for count in columns))

    def gaps(self) -> Linearised:
        """Defects: states at the nodes less the states that the intervals lead to.

        Zero for changes that a motion can make: the equations of motion. Rows are
        (q, v) of one node after the other, shape (2 N n,).
        """
        states = 2 * self.N * self.n
        ends = Instants.spread((0, self.N), np.ones(1))
        by_state = np.broadcast_to(np.eye(2 * self.n), (self.N, 2 * self.n, 2 * self.n))
        slopes = np.split(by_state, 2, axis=2)
        led = self.values(ends, self.q[1:], self.v[1:], *slopes, carried=True)
        nodes = sp.eye(states, self.size, format="csr")
        return Linearised(nodes - led.matrix, -led.by_length)

    # -- time --------------------------------------------------------------------------

    def with_time(self, change: Linearised, at: Instants, rate: Array) -> Linearised:
        """Rows with the effect of the times of instants, which follow the lengths.

        Args:
            change: The rows at the shares of the intervals, without the effect of time.
            at: The instants, m of them.
            rate: Partial derivatives by time, shape (m,), in units of the rows [1/s].
        """
        passed = np.where(at.interval[:, None] > np.arange(self.N), 1.0, 0.0)
        passed[np.arange(rate.size), at.interval] = at.share
        later = sp.csr_matrix(rate[:, None] * passed)
        return Linearised(change.matrix, (change.by_length + later).tocsr())

    @property
    def rise(self) -> Stencil:
        """Rise of a quantity over the time over which its slope is limited.

        A continuous quantity has a slope over each interval: slopes between the middles
        of intervals would leave half of the first interval free, and with it the level
        of all later values.
        """
        if self.shape == "ramps":
            return (0, 0, -1.0), (0, 1, 1.0)
        return (0, 0, -0.5), (0, 1, -0.5), (1, 0, 0.5), (1, 1, 0.5)

    @property
    def passing(self) -> Array:
        """Shares of an interval, and of the next one if any, that the rise takes."""
        return np.ones(1) if self.shape == "ramps" else np.full(2, 0.5)

    def _passed(self, interval: IntArray) -> sp.csr_matrix:
        """Shares of all intervals that the rises take, from given ones on, (m, N)."""
        offsets = range(self.passing.size)
        every = sp.diags(self.passing, offsets, shape=(self.N, self.N))
        return every.tocsr()[interval]

    def apart(self, interval: IntArray) -> Array:
        """Times that the rises take, from given intervals on [s], shape (m,)."""
        return np.asarray(self._passed(interval) @ self.h)

    def slopes(self, rise: Linearised, slopes: Array, interval: IntArray) -> Linearised:
        """Slopes over time of a quantity of each joint.

        Args:
            rise: Changes of the rises of the quantity, m n rows.
            slopes: Slopes of the motion, shape (m, n).
            interval: The intervals at which the rises begin, shape (m,).
        """
        n = slopes.shape[1]
        longer = sp.kron(self._passed(interval), np.ones((n, 1)))
        by_length = rise.by_length - sp.diags(slopes.ravel()) @ longer
        change = Linearised(rise.matrix, by_length)
        return change.times(1.0 / np.repeat(self.apart(interval), n))
