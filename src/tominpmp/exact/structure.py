"""Arcs: stretches of time on which each joint has one torque, or one speed.

A time-optimal motion mostly has every torque at a limit, or the joint at its speed
limit. Between the instants at which that changes lies an arc; its length is exact where
an interval of a grid is a compromise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray

# Torque shares this near a limit are at it.
SATURATED = 0.98
# Speeds this near the limit, relatively, are at it.
AT_SPEED = 3e-3
# Stretches of this many intervals with torques between their limits stand for switches,
# and those that take no more than this share of the duration.
SWITCH_INTERVALS = 3
SWITCH_SHARE = 0.04
# Longer ones are cut into this many arcs at most.
PIECES = 6
# Arcs shorter than this share of the duration are joined to their neighbours.
SHORTEST = 1e-7
# Switches of different joints closer than this share of the duration are one at first.
TOGETHER = 1e-3


@dataclass(frozen=True, eq=False)
class Arcs:
    """What the joints do, arc by arc.

    Attributes:
        lengths: Lengths [s], shape (K,).
        levels: Torques as shares of their limits, in [-1, 1], shape (K, n).
        free: Whether a torque lies between its limits, to be found, shape (K, n).
        held: 1 or -1 where a joint runs at its speed limit forwards or backwards, else
            0, shape (K, n).
        follows: Whether a torque follows from joints that are held, as many as these in
            each arc, shape (K, n); by default their own.
    """

    lengths: Array
    levels: Array
    free: BoolArray
    held: IntArray
    follows: BoolArray = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """Held joints are held by their own torques unless others are given."""
        if self.follows is None:
            object.__setattr__(self, "follows", self.held != 0)

    @property
    def count(self) -> int:
        """Number of arcs."""
        return self.lengths.size

    @property
    def duration(self) -> float:
        """T [s]."""
        return float(self.lengths.sum())

    @property
    def entries(self) -> BoolArray:
        """Where a joint begins to be held after the start, shape (K, n)."""
        before = np.vstack([self.held[:1], self.held[:-1]])
        return np.asarray((self.held != 0) & (self.held != before))

    def pick(self, index: IntArray, lengths: Array) -> Arcs:
        """Arcs of chosen kinds with given lengths."""
        kinds: tuple[Any, ...] = self.levels, self.free, self.held, self.follows
        return Arcs(lengths, *(part[index] for part in kinds))

    def _cut(self, arc: int, shares: Sequence[float]) -> Arcs:
        """An arc cut into pieces by their shares of its length; arrays are its own."""
        repeated = np.ones(self.count, dtype=np.int64)
        repeated[arc] = len(shares)
        index = np.repeat(np.arange(self.count), repeated)
        lengths = self.lengths[index]
        lengths[arc : arc + len(shares)] *= np.array(shares)
        return self.pick(index, lengths)

    def insert(
        self, arc: int, share: float, joint: int, level: float, held: int = 0
    ) -> Arcs:
        """Cut an arc and put in one without length, with another torque of a joint.

        Args:
            arc: The arc to be cut.
            share: Where, in [0, 1].
            joint: The joint.
            level: Its torque on the new arc, as a share of the limits.
            held: 1 or -1 if it runs at its speed limit there.
        """
        cut, new = self._cut(arc, (share, 0.0, 1.0 - share)), (arc + 1, joint)
        cut.levels[new], cut.free[new] = level, False
        cut.held[new], cut.follows[new] = held, held != 0
        return cut

    def lean(
        self, arc: int, joint: int, level: float, other: int, *, last: bool
    ) -> Arcs:
        """Put in an arc without length on which another torque holds a joint.

        Args:
            arc: The arc on which its own torque holds it, before which it is put, or
                behind which.
            joint: The joint.
            level: The limit that its torque has come to, as a share of the limits.
            other: The joint whose torque holds it.
            last: Whether it is put behind.
        """
        cut, new = self._cut(arc, (1.0, 0.0) if last else (0.0, 1.0)), arc + int(last)
        cut.levels[new, joint], cut.free[new, other] = level, False
        cut.follows[new, joint], cut.follows[new, other] = False, True
        return cut

    def split(
        self, arc: int, joint: int, shares: Sequence[float], levels: Sequence[float]
    ) -> Arcs:
        """Cut an arc into some on which a torque has limits in place of one value.

        Args:
            arc: The arc to be cut.
            joint: The joint whose torque it is.
            shares: How much of the arc each piece takes.
            levels: Its torque on each, as a share of the limits.
        """
        cut, pieces = self._cut(arc, shares), slice(arc, arc + len(shares))
        cut.levels[pieces, joint], cut.free[pieces, joint] = levels, False
        return cut

    def cleaned(self) -> Arcs:
        """Without arcs of hardly any length, and equal neighbours joined."""
        keep = np.flatnonzero(self.lengths > SHORTEST * self.duration)
        if not keep.size:  # the motion itself has vanished: one arc remains of it
            keep = np.argmax(self.lengths, keepdims=True)
        arcs = self.pick(keep, self.lengths[keep])
        kinds = np.stack([arcs.held, arcs.follows])
        fixed = ~arcs.free[1:] & ~arcs.free[:-1] & (np.diff(arcs.levels, axis=0) == 0.0)
        alike = np.all(kinds[:, 1:] == kinds[:, :-1], axis=0)
        same = np.all(alike & (arcs.follows[1:] | fixed), axis=1)
        first = np.flatnonzero(np.append(True, ~same))
        return arcs.pick(first, np.add.reduceat(arcs.lengths, first))

    def loosened(self) -> Arcs:
        """With all torques to be found that can be."""
        driven = np.any((self.levels != 0.0) | self.free | (self.held != 0), axis=0)
        return replace(self, free=(self.held == 0) & ~self.follows & driven)

    def saturated(self) -> Arcs:
        """With torques that have come to a limit no longer to be found."""
        bound = self.free & (np.abs(self.levels) >= 1.0 - 1e-9)
        levels = np.where(bound, np.sign(self.levels), self.levels)
        return replace(self, levels=levels, free=self.free & ~bound)


class Stretch(NamedTuple):
    """What one joint does for some time.

    Attributes:
        end: When it ends [s].
        level: Torque as a share of its limits.
        free: Whether it is to be found.
        held: 1, -1 or 0, see :class:`Arcs`.
    """

    end: float
    level: float
    free: bool
    held: int


def read_arcs(lengths: Array, shares: Array, speeds: Array, driven: BoolArray) -> Arcs:
    """Read arcs off a motion whose torques are constant on intervals.

    Args:
        lengths: Lengths of the intervals [s], shape (N,).
        shares: Torques as shares of their limits, shape (N, n).
        speeds: Velocities at the nodes as shares of their limits, shape (N + 1, n).
        driven: Which joints have motors, shape (n,).
    """
    t = np.concatenate([[0.0], np.cumsum(lengths)])
    T, n = float(t[-1]), shares.shape[1]
    tracks = [
        _read_joint(t, shares[:, j], speeds[:, j])
        if driven[j]
        else [Stretch(T, float(shares[0, j]), False, 0)]
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
    return Arcs(lengths, levels, free > 0.0, held.astype(np.int64)).cleaned()


def _read_joint(t: Array, shares: Array, speeds: Array) -> list[Stretch]:
    """What one joint does."""
    fast = 1.0 - AT_SPEED
    forwards = (speeds[:-1] > fast) & (speeds[1:] > fast)
    backwards = (speeds[:-1] < -fast) & (speeds[1:] < -fast)
    inside = np.abs(shares) < SATURATED
    code = np.select([forwards, backwards, inside, shares > 0.0], [2, -2, 0, 1], -1)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(code)) + 1, [code.size]])
    runs = [(int(a), int(b), int(code[a])) for a, b in pairwise(starts)]
    out: list[Stretch] = []
    for index, (a, b, kind) in enumerate(runs):
        end = float(t[b])
        if abs(kind) == 2:
            out.append(Stretch(end, 0.0, False, kind // 2))
        elif kind != 0:
            out.append(Stretch(end, float(kind), False, 0))
        elif b - a <= SWITCH_INTERVALS or t[b] - t[a] <= SWITCH_SHARE * t[-1]:
            before = out[-1] if out else None
            after = runs[index + 1][2] if index + 1 < len(runs) else 0
            out += _short_stretches(t[a : b + 1], shares[a:b], before, after)
        else:
            pieces = min(PIECES, (b - a) // 2)
            cuts = np.unique(np.linspace(a, b, pieces + 1).round().astype(int))
            for first, last in pairwise(cuts):
                h = np.diff(t[first : last + 1])
                level = float(h @ shares[first:last] / h.sum())
                out.append(Stretch(float(t[last]), level, True, 0))
    return out


def _short_stretches(
    t: Array, shares: Array, before: Stretch | None, after: int
) -> list[Stretch]:
    """Switches that have about the same mean torque as a few intervals."""
    h = np.diff(t)
    mean = float(h @ shares / h.sum())
    begin, end = float(t[0]), float(t[-1])
    high = 0.5 * (1.0 + mean) * (end - begin)  # how long the torque is high
    left = before.level if before is not None and before.held == 0 else 0.0
    right = float(after) if abs(after) == 1 else 0.0
    if abs(left) != 1.0 and abs(right) != 1.0:
        return [Stretch(end, float(np.sign(mean) or 1.0), False, 0)]
    if left != right:
        # From one limit to the other.
        first = left if abs(left) == 1.0 else -right
        cut = begin + (high if first > 0.0 else end - begin - high)
        return [Stretch(cut, first, False, 0), Stretch(end, -first, False, 0)]
    # Away from a limit and back to it.
    short = end - begin - high if left > 0.0 else high
    middle = 0.5 * (begin + end)
    return [
        Stretch(middle - 0.5 * short, left, False, 0),
        Stretch(middle + 0.5 * short, -left, False, 0),
        Stretch(end, left, False, 0),
    ]
