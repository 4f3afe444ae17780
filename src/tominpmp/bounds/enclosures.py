"""Enclosures: sets of motions of an arm with two joints, in intervals over time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.bounds.intervals import Interval
from tominpmp.bounds.tubes import Gates

# Intervals of time.
INTERVALS = 40
# Where gates are: after a third and two thirds of the time, or so.
GATES = (14, 26)
# What is told apart at the gates: the arc of the second joint, its rate, the momentum
# of the first joint, and its place with the first.
S, Y, P, C = range(4)


@dataclass(frozen=True, eq=False)
class Enclosures:
    """Intervals that enclose sets of motions.

    Attributes:
        low: Lower bounds of what is told apart at each gate, shape (m, G, 4).
        high: The upper bounds.
        q1: Positions of the first joint in each interval of time, shape (m, K).
        q2: Those of the second one.
        p: Momenta of the first joint.
        y: Rates of the arc of the second one.
        roams: Where the second joint may be beyond the positions that are known.
    """

    low: Array
    high: Array
    q1: Interval
    q2: Interval
    p: Interval
    y: Interval
    roams: BoolArray

    @property
    def rows(self) -> int:
        """How many sets of motions there are."""
        return int(self.low.shape[0])

    def taken(self, rows: IntArray) -> Enclosures:
        """Some of them."""
        return Enclosures(
            self.low[rows],
            self.high[rows],
            self.q1.of_rows(rows),
            self.q2.of_rows(rows),
            self.p.of_rows(rows),
            self.y.of_rows(rows),
            self.roams[rows],
        )

    def gates(self, index: int) -> Gates:
        """Ranges of one of what is told apart."""
        return Gates(GATES, self.low[:, :, index], self.high[:, :, index])

    def halved(self, width: Array) -> Enclosures:
        """Twice as many, each cut in halves where its range is the widest.

        Args:
            width: What counts as wide, shape (G, 4).
        """
        with np.errstate(invalid="ignore"):
            span = (self.high - self.low) / width
        flat = np.where(np.isfinite(span), span, -1.0).reshape(self.rows, -1)
        where = np.argmax(flat, axis=1)
        twice = self.taken(np.repeat(np.arange(self.rows), 2))
        low, high = twice.low.copy(), twice.high.copy()
        gate, index = np.divmod(where, low.shape[2])
        one, other = np.arange(0, twice.rows, 2), np.arange(1, twice.rows, 2)
        at = one, gate, index
        middle = 0.5 * (low[at] + high[at])
        high[at] = middle
        low[other, gate, index] = middle
        return replace(twice, low=low, high=high)

    def sliced(self, count: int) -> Enclosures:
        """One row cut into equal slices, by each of its ranges in turn."""
        shape = self.low.shape[1:]
        ranges = shape[0] * shape[1]
        steps = (self.high - self.low) / count
        slices = self.taken(np.zeros(ranges * count, dtype=np.intp))
        which = np.repeat(np.arange(ranges), count)
        step = np.tile(np.arange(count), ranges)
        low, high = slices.low.copy(), slices.high.copy()
        at = np.arange(which.size), *np.unravel_index(which, shape)
        wide = steps[0].ravel()[which]
        wide = np.where(np.isfinite(wide), wide, 0.0)  # what is unbounded stays so
        low[at] += step * wide
        high[at] -= (count - 1 - step) * wide
        return replace(slices, low=low, high=high)

    @property
    def hull(self) -> Enclosures:
        """One row that encloses all of them."""
        return Enclosures(
            self.low.min(axis=0, keepdims=True),
            self.high.max(axis=0, keepdims=True),
            self.q1.over_rows,
            self.q2.over_rows,
            self.p.over_rows,
            self.y.over_rows,
            np.asarray(self.roams.any(axis=0, keepdims=True)),
        )

    def cut(self, other: Enclosures) -> Enclosures:
        """What both enclose."""
        return Enclosures(
            np.maximum(self.low, other.low),
            np.minimum(self.high, other.high),
            self.q1.cut(other.q1),
            self.q2.cut(other.q2),
            self.p.cut(other.p),
            self.y.cut(other.y),
            self.roams & other.roams,
        )
