r"""Small changes of a motion, as linear maps of a few unknowns.

A motion is changed by its states at nodes, its accelerations between them, and the
lengths of its intervals. On each interval, with :math:`s` the share of it that has
passed,

.. math:: \delta\ddot q = (1 - s)\, \delta a_0 + s\, \delta a_1,

and the double integrator carries positions and velocities over the interval exactly, so
that limits on them hold between the nodes as they do at the nodes. The limits are those
of the programs that plan motions: their derivatives by states at instants are pulled
back to these unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.constraints import Partials, States
from tominpmp.linear_programs.compressed import Compressed
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.instants import Instants

# The quantity that is constant on an interval: the acceleration, its slope, or the
# torque.
Shape: TypeAlias = Literal["steps", "ramps", "torques"]

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


@dataclass(frozen=True, eq=False)
class Perturbations:
    """Small changes of a motion on a grid.

    The unknowns are, one after the other, the states (q, v) at all nodes but the first,
    which is given, the accelerations, one of each interval or with "ramps" one of each
    node, and the lengths of the intervals.

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
        return (2 * self.N + self.controls) * self.n + self.N

    def pull_back(
        self,
        at: Instants,
        states: States,
        partials: Partials,
        *,
        carried: bool = False,
    ) -> sp.csr_matrix:
        """Derivatives by the unknowns from derivatives by states at instants.

        States inside an interval begin from the node before it; at its end they are
        those of the node there. The times of instants follow the lengths.

        Args:
            at: The instants.
            states: The states of the motion there.
            partials: Derivatives of k values.
            carried: Whether ends of intervals begin from the node before, too.

        Returns:
            Shape (k, size); a row for each row of the partial derivatives.
        """
        n, N, which = self.n, self.N, partials.at
        interval, share = at.interval[which], at.share[which]
        none = np.zeros((which.size, n))
        by_states = partials.by_q, partials.by_v, partials.by_a
        by_q, by_v, by_a = (none if part is None else part for part in by_states)
        ended = (share >= 1.0) & (not carried)
        node, h = interval + ended, self.h[interval]
        passed = np.where(ended, 0.0, share)
        p, t, after = (part[:, None] for part in (passed, passed * h, share))
        by_unknowns = [
            by_q,
            t * by_q + by_v,
            (1 / 2 - p / 6) * t**2 * by_q + (1 - p / 2) * t * by_v + (1 - after) * by_a,
            p / 6 * t**2 * by_q + p / 2 * t * by_v + after * by_a,
        ]
        last = interval + (self.shape == "ramps")
        # Column -1 is the state at the first node, which does not change.
        first = [2 * node - 2, 2 * node - 1, 2 * N + interval, 2 * N + last]
        columns = [n * k[:, None] + np.arange(n) for k in first]
        # A longer interval with unchanged accelerations adds twice the displacement,
        # less its part by the initial velocity.
        run = ~ended[:, None] / h[:, None]
        way = (states.q[which] - self.q[node]) * run
        gained = (states.v[which] - self.v[node]) * run
        longer = 2.0 * way - p * self.v[node]
        by_length = np.sum(by_q * longer + by_v * gained, axis=1)
        data = np.concatenate([*by_unknowns, by_length[:, None]], axis=1)
        lengths = self.size - N
        columns.append((lengths + interval)[:, None])
        places = np.concatenate(columns, axis=1)
        matrix = Compressed.of_table(data, places, self.size).rows()
        matrix.sum_duplicates()
        if partials.by_t is not None:
            before = np.where(interval[:, None] > np.arange(N), 1.0, 0.0)
            before[np.arange(which.size), interval] = share
            later = sp.csr_matrix(partials.by_t[:, None] * before)
            matrix += sp.hstack([sp.csr_matrix((which.size, lengths)), later])
        if partials.row is not None:
            terms = partials.row, np.arange(which.size)
            matrix = sp.csr_matrix((np.ones(which.size), terms)) @ matrix
        return sp.csr_matrix(matrix)

    def gaps(self) -> sp.csr_matrix:
        """Defects: states at the nodes less the states that the intervals lead to.

        Zero for changes that a motion can make: the equations of motion. Rows are
        (q, v) of one node after the other, shape (2 N n, size).
        """
        n, N = self.n, self.N
        ends = Instants.spread(N, (1.0,))
        states = States(self.t[1:], self.q[1:], self.v[1:], np.zeros((0, n)))
        by_q, by_v = np.hsplit(np.tile(np.eye(2 * n), (N, 1)), 2)
        partials = Partials(np.repeat(np.arange(N), 2 * n), by_q, by_v)
        nodes = sp.eye(2 * N * n, self.size, format="csr")
        return nodes - self.pull_back(ends, states, partials, carried=True)

    def pairs(self, interval: IntArray) -> Instants:
        """Pairs of instants between which slopes over time are taken.

        These are the ends of intervals where accelerations are continuous, else the
        middles of an interval and of the next one.

        Args:
            interval: The intervals, shape (k,).
        """
        if self.shape == "ramps":
            pairs = np.stack([interval, interval], axis=1), (0.0, 1.0)
        else:
            pairs = np.stack([interval, interval + 1], axis=1), (0.5, 0.5)
        return Instants(pairs[0].ravel(), np.tile(pairs[1], interval.size))
