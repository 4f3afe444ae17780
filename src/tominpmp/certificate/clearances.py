"""Where pairs of bodies are nearest in a motion, and what the distances change by.

A pair of bodies limits a motion where it is nearest. That instant moves with the
motion, so that to first order the least distance changes as the distance at that
instant does: what is lost by coming there sooner or later is nothing, as the distance
does not change with time there. A row at another instant of the same approach would say
that it is: it has hardly any room, and would hold a motion that nothing holds. So each
approach of a pair is one row, at its nearest instant; only where a pair stays as near
as it is for a while there are others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.certificate.motion import Motion
from tominpmp.certificate.perturbations import Instants

# Where a pair that stays near is a row, too: the middles and the ends of the intervals.
REGULAR = (0.5, 1.0)
# Clearances beyond this, in shares of the reach, are no rows.
ATTENTION = 0.03
# Samples of an interval, between which the nearest instants of pairs are looked for.
SAMPLES = 16
# Pairs nearer than this, in shares of the reach, are looked at more closely: corners
# pass each other within a millisecond. So often the time around a sample is halved.
CLOSE, HALVINGS = 0.01, 6
# A pair stays near where at its speed the room would last for this share of the motion.
STAYING = 0.05


class Nearest(NamedTuple):
    """Where pairs are nearest in a motion, k times in all.

    Attributes:
        times: When [s], shape (k,).
        pairs: Which, shape (k,).
        slopes: Derivatives of what the least distances lack, as shares of the reach, by
            the configuration, shape (k, n). Where a corner passes, which has others
            before and after, they are those of the least distance of all.
        rates: Derivatives by time, of what moves by itself [1/s], shape (k,).
    """

    times: Array
    pairs: IntArray
    slopes: Array
    rates: Array

    @classmethod
    def none(cls, n: int) -> Nearest:
        """Nothing near an arm of so many joints."""
        index = np.zeros(0, dtype=np.int64)
        return cls(np.zeros(0), index, np.zeros((0, n)), np.zeros(0))

    def kept(self, which: IntArray | BoolArray) -> Nearest:
        """Some of them."""
        times, pairs, slopes, rates = self
        return Nearest(times[which], pairs[which], slopes[which], rates[which])


def contacts(motion: Motion, attention: float = ATTENTION) -> tuple[Nearest, Array]:
    """The nearest instants of all pairs, and those at which they stay near.

    Args:
        motion: The motion.
        attention: Pairs with more room than this share of the reach are left out.

    Returns:
        The pairs then, and what each lacks of its margin, as a share of the reach.
    """
    parts = [(Nearest.none(motion.changes.n), np.zeros(0))]
    if motion.task.problem.checker.pairs:
        parts += _Approaches(motion, attention).contacts()
    found, missing = zip(*parts, strict=True)
    together = map(np.concatenate, zip(*found, strict=True))
    return Nearest(*together), np.concatenate(missing)


@dataclass(frozen=True, eq=False)
class _Approaches:
    """Looks for the instants at which pairs limit a motion."""

    motion: Motion
    attention: float

    @cached_property
    def _margins(self) -> Array:
        """Distances to keep, shape (pairs,) [m]."""
        problem = self.motion.task.problem
        return problem.checker.margins(problem.margin)

    def contacts(self) -> Iterator[tuple[Nearest, Array]]:
        """Pairs when they are nearest, or stay near, and what they lack."""
        task, changes = self.motion.task, self.motion.changes
        at = Instants.spread(self.motion.span, np.arange(1, SAMPLES + 1) / SAMPLES)
        times = changes.times(at)
        cutoff = self._margins + self.attention * task.reach
        found = task.problem.checker.distances(self._q(times), cutoff, times)
        table = (self._margins - found) / task.reach
        near = table > -self.attention
        seen = np.flatnonzero(near.any(axis=0))
        if not seen.size:
            return
        table = np.where(near, table, -np.inf)[:, seen]
        nearest = local_maxima(table)
        rough, close = nearest & (table <= -CLOSE), nearest & (table > -CLOSE)
        regular = np.isin(at.share, REGULAR)[:, None] & near[:, seen] & ~nearest

        def sampled(flags: BoolArray) -> tuple[Nearest, Array]:
            rows, columns = np.nonzero(flags)
            time, pair = times[rows], seen[columns]
            found = Nearest(time, pair, *self._slopes(time, pair))
            return found, table[rows, columns]

        yield sampled(rough)
        staying, missing = sampled(regular)
        # They stay as near as they are for a while.
        speed = np.abs(self._speed(staying.times, staying.slopes, staying.rates))
        room, T = np.maximum(-missing, 0.0), float(changes.t[-1])
        kept = room >= STAYING * T * speed
        yield staying.kept(kept), missing[kept]
        if close.any():
            yield self._closest(times, seen, table, close)

    def _q(self, times: Array) -> Array:
        """Configurations, shape (m, n)."""
        return np.asarray(self.motion.trajectory(times).q)

    def _slopes(self, times: Array, pair: IntArray) -> tuple[Array, Array]:
        """Derivatives of what pairs lack, at a time each."""
        if not times.size:
            return np.zeros((0, self.motion.changes.n)), np.zeros(0)
        task = self.motion.task
        distinct, index = np.unique(times, return_inverse=True)
        q = self._q(distinct)
        found = task.problem.checker.derivatives_at(q, index, pair, distinct)
        return -found[0] / task.reach, -found[1] / task.reach

    def _speed(self, times: Array, slopes: Array, rates: Array) -> Array:
        """How fast what is missing grows along the motion [1/s], shape (k,)."""
        v = self.motion.trajectory(times).v
        return np.asarray(np.einsum("kj,kj->k", slopes, v) + rates)

    def _closest(
        self, times: Array, seen: IntArray, table: Array, flags: BoolArray
    ) -> tuple[Nearest, Array]:
        """The nearest instants around flagged samples, found by halving the time.

        A corner that passes is a kink of the distance in time, or nearly: its slope
        there is that mean of those before and after which does not change with time.
        """
        rows, columns = np.nonzero(flags)
        pair, changes = seen[columns], self.motion.changes
        first, end = changes.t[list(self.motion.span)]
        padded = np.concatenate([[first], times, [end]])
        ends = [padded[rows], padded[rows + 2]]
        slopes = [self._slopes(time, pair) for time in ends]
        speeds = [self._speed(ends[i], *slopes[i]) for i in (0, 1)]
        for _ in range(HALVINGS):
            middle = 0.5 * (ends[0] + ends[1])
            by_q, by_t = self._slopes(middle, pair)
            speed = self._speed(middle, by_q, by_t)
            for i, side in enumerate((speed > 0.0, speed <= 0.0)):
                ends[i] = np.where(side, middle, ends[i])
                speeds[i] = np.where(side, speed, speeds[i])
                slopes[i] = (
                    np.where(side[:, None], by_q, slopes[i][0]),
                    np.where(side, by_t, slopes[i][1]),
                )
        # What is missing grows before and falls after; else it is nearest at an end.
        rises, falls = np.maximum(speeds[0], 0.0), np.maximum(-speeds[1], 0.0)
        total = np.maximum(rises + falls, 1e-300)
        after = np.where(rises + falls > 0.0, rises / total, 0.5)
        time = (1.0 - after) * ends[0] + after * ends[1]
        by_q = (1.0 - after)[:, None] * slopes[0][0] + after[:, None] * slopes[1][0]
        by_t = (1.0 - after) * slopes[0][1] + after * slopes[1][1]
        missing = np.maximum(self._missing(time, pair), table[rows, columns])
        return Nearest(time, pair, by_q, by_t), missing

    def _missing(self, times: Array, pair: IntArray) -> Array:
        """What pairs lack at a time each, shape (k,)."""
        task, margin = self.motion.task, self._margins[pair]
        enough, every = margin + self.attention * task.reach, np.arange(pair.size)
        q = self._q(times)
        found = task.problem.checker.measured(q, every, pair, enough, times)
        missing = (margin - found) / task.reach
        return np.where(missing > -self.attention, missing, -np.inf)


def local_maxima(table: Array) -> BoolArray:
    """Where values are not smaller than before, and larger than after.

    Args:
        table: Values, one row an instant, shape (m, p); minus infinity where unknown.
    """
    padded = np.pad(table, ((1, 1), (0, 0)), constant_values=-np.inf)
    known = table > -np.inf
    return np.asarray(known & (table >= padded[:-2]) & (table > padded[2:]))
