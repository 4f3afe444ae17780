"""Arcs: spans of time between switches, with constant torques or speeds.

In a time-optimal motion, almost every torque is at a limit, or its joint is at its
speed limit. An arc lies between two successive instants at which a joint changes from
one limit to another. The lengths of arcs are unknowns, so that switches are exact,
whereas the nodes of a grid only approximate them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray

# Torques beyond this share of a limit count as saturated.
SATURATED = 0.98
# Speeds within this share of their limit count as being at it.
AT_SPEED = 3e-3
# A run of intervals with torques between their limits stands for a switch if it has at
# most this number of intervals, or takes at most this share of the duration.
SWITCH_INTERVALS = 3
SWITCH_SHARE = 0.04
# Longer runs are divided into at most this number of arcs.
PIECES = 6
# Arcs shorter than this share of the duration are dropped.
SHORTEST = 1e-7
# Switches of different joints closer than this share of the duration are merged.
TOGETHER = 1e-3


class Edit(NamedTuple):
    """Fixed torque of a joint on a piece of an arc, and whether the joint is held.

    Attributes:
        piece: Index of the piece.
        joint: Index of the joint.
        level: Torque as a share of its limits.
        held: 1, -1 or 0, see :class:`Arcs`.
        follows: Whether the torque follows from held joints.
    """

    piece: int
    joint: int
    level: float
    held: int = 0
    follows: bool = False


@dataclass(frozen=True, eq=False)
class Arcs:
    """Structure of a motion: torques and held joints on each arc.

    Attributes:
        lengths: Lengths of the arcs [s], shape (K,).
        levels: Torques as shares of their limits, in [-1, 1], shape (K, n).
        free: Whether a torque is an unknown between its limits, shape (K, n).
        held: 1 or -1 if a joint moves at its speed limit forwards or backwards, 0
            otherwise, shape (K, n).
        follows: Whether a torque follows from held joints, shape (K, n); each arc has
            one such torque for each held joint, mostly the torque of the joint.
    """

    lengths: Array
    levels: Array
    free: BoolArray
    held: IntArray
    follows: BoolArray

    @property
    def count(self) -> int:
        """Number of arcs."""
        return self.lengths.size

    @property
    def duration(self) -> float:
        """Duration T [s]."""
        return float(self.lengths.sum())

    @property
    def entries(self) -> BoolArray:
        """Whether a joint begins to be held at each arc after the first, (K, n)."""
        before = np.vstack([self.held[:1], self.held[:-1]])
        return np.asarray((self.held != 0) & (self.held != before))

    def pick(self, index: IntArray, lengths: Array) -> Arcs:
        """The arcs with given indices, with new lengths."""
        kinds: tuple[Any, ...] = self.levels, self.free, self.held, self.follows
        return Arcs(lengths, *(part[index] for part in kinds))

    def divided(self, arc: int, shares: Sequence[float], edits: Sequence[Edit]) -> Arcs:
        """Divide an arc into pieces with other torques.

        Args:
            arc: Index of the arc.
            shares: Length of each piece as a share of the arc; zero for a piece whose
                length an optimisation finds.
            edits: The torques that differ from the torques of the arc.
        """
        repeated = np.ones(self.count, dtype=np.int64)
        repeated[arc] = len(shares)
        index = np.repeat(np.arange(self.count), repeated)
        lengths = self.lengths[index]
        lengths[arc : arc + len(shares)] *= np.array(shares)
        out = self.pick(index, lengths)
        for piece, joint, level, held, follows in edits:
            place = arc + piece, joint
            out.levels[place], out.free[place] = level, False
            out.held[place], out.follows[place] = held, follows
        return out

    def cleaned(self) -> Arcs:
        """The arcs without negligibly short arcs, and with equal neighbours merged."""
        keep = np.flatnonzero(self.lengths > SHORTEST * self.duration)
        if not keep.size:  # all lengths are zero: keep one arc
            keep = np.argmax(self.lengths, keepdims=True)
        arcs = self.pick(keep, self.lengths[keep])
        kinds = np.stack([arcs.held, arcs.follows])
        fixed = ~arcs.free[1:] & ~arcs.free[:-1] & (np.diff(arcs.levels, axis=0) == 0.0)
        alike = np.all(kinds[:, 1:] == kinds[:, :-1], axis=0)
        same = np.all(alike & (arcs.follows[1:] | fixed), axis=1)
        first = np.flatnonzero(np.append(True, ~same))
        return arcs.pick(first, np.add.reduceat(arcs.lengths, first))

    def saturated(self) -> Arcs:
        """The arcs with the free torques that are at a limit fixed there."""
        bound = self.free & (np.abs(self.levels) >= 1.0 - 1e-9)
        levels = np.where(bound, np.sign(self.levels), self.levels)
        return replace(self, levels=levels, free=self.free & ~bound)


class _JointArc(NamedTuple):
    """Arc of a single joint.

    Attributes:
        end: End of the arc [s].
        level: Torque as a share of its limits.
        free: Whether the torque is an unknown.
        held: 1, -1 or 0, see :class:`Arcs`.
    """

    end: float
    level: float
    free: bool
    held: int


def read_arcs(lengths: Array, shares: Array, speeds: Array, driven: BoolArray) -> Arcs:
    """Detect the arcs of a motion whose torques are constant on intervals.

    Args:
        lengths: Lengths of the intervals [s], shape (N,).
        shares: Torques as shares of their limits, shape (N, n).
        speeds: Velocities at the nodes as shares of their limits, shape (N + 1, n).
        driven: Whether each joint has a motor, shape (n,).
    """
    t = np.concatenate([[0.0], np.cumsum(lengths)])
    T, n = float(t[-1]), shares.shape[1]
    tracks = [
        _read_joint(t, shares[:, j], speeds[:, j])
        if driven[j]
        else [_JointArc(T, float(shares[0, j]), False, 0)]
        for j in range(n)
    ]
    ends = np.sort([item.end for track in tracks for item in track])
    ends = ends[np.diff(ends, prepend=0.0) > TOGETHER * T]
    ends[-1] = T
    lengths = np.diff(ends, prepend=0.0)
    table = np.empty((4, ends.size, n))
    for j, track in enumerate(tracks):
        rows = np.array(track)
        of = np.searchsorted(rows[:, 0], ends - 0.5 * lengths)
        table[:, :, j] = rows[np.minimum(of, len(track) - 1)].T
    _, levels, free, held = table
    follows = held != 0.0
    return Arcs(lengths, levels, free > 0.0, held.astype(np.int64), follows).cleaned()


def _read_joint(t: Array, shares: Array, speeds: Array) -> list[_JointArc]:
    """Arcs of one joint.

    Args:
        t: Nodes [s], shape (N + 1,).
        shares: Torques of the intervals as shares of their limits, shape (N,).
        speeds: Velocities at the nodes as shares of their limits, shape (N + 1,).
    """
    fast = 1.0 - AT_SPEED
    forwards = (speeds[:-1] > fast) & (speeds[1:] > fast)
    backwards = (speeds[:-1] < -fast) & (speeds[1:] < -fast)
    inside = np.abs(shares) < SATURATED
    code = np.select([forwards, backwards, inside, shares > 0.0], [2, -2, 0, 1], -1)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(code)) + 1, [code.size]])
    runs = [(int(a), int(b), int(code[a])) for a, b in pairwise(starts)]
    out: list[_JointArc] = []
    for index, (a, b, kind) in enumerate(runs):
        end = float(t[b])
        if abs(kind) == 2:
            out.append(_JointArc(end, 0.0, False, kind // 2))
        elif kind != 0:
            out.append(_JointArc(end, float(kind), False, 0))
        elif b - a <= SWITCH_INTERVALS or t[b] - t[a] <= SWITCH_SHARE * t[-1]:
            before = out[-1].level if out else 0.0
            after = runs[index + 1][2] if index + 1 < len(runs) else 0
            out += _switches(t[a : b + 1], shares[a:b], before, after)
        else:
            pieces = min(PIECES, (b - a) // 2)
            cuts = np.unique(np.linspace(a, b, pieces + 1).round().astype(int))
            for first, last in pairwise(cuts):
                h = np.diff(t[first : last + 1])
                level = float(h @ shares[first:last] / h.sum())
                out.append(_JointArc(float(t[last]), level, True, 0))
    return out


def _switches(t: Array, shares: Array, left: float, after: int) -> list[_JointArc]:
    """Saturated arcs with the same mean torque as a few intervals.

    Args:
        t: Nodes of the intervals [s], shape (N + 1,).
        shares: Torques of the intervals as shares of their limits, shape (N,).
        left: Torque before the intervals as a share of its limits; 0 at the start, and
            for a held joint.
        after: 1, -1 or 0 for a torque at the upper, lower or no limit after them; 2 or
            -2 for a held joint.
    """
    h = np.diff(t)
    mean = float(h @ shares / h.sum())
    begin, end = float(t[0]), float(t[-1])
    high = 0.5 * (1.0 + mean) * (end - begin)  # total time at the upper limit
    right = float(after) if abs(after) == 1 else 0.0
    if abs(left) != 1.0 and abs(right) != 1.0:
        return [_JointArc(end, float(np.sign(mean) or 1.0), False, 0)]
    if left != right:
        # From one limit to the other.
        first = left if abs(left) == 1.0 else -right
        cut = begin + (high if first > 0.0 else end - begin - high)
        return [_JointArc(cut, first, False, 0), _JointArc(end, -first, False, 0)]
    # Away from a limit and back to it.
    short = end - begin - high if left > 0.0 else high
    middle = 0.5 * (begin + end)
    return [
        _JointArc(middle - 0.5 * short, left, False, 0),
        _JointArc(middle + 0.5 * short, -left, False, 0),
        _JointArc(end, left, False, 0),
    ]
