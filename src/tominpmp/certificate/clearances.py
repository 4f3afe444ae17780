"""Nearest instants of collision pairs in a motion, and derivatives of the distances.

A collision pair limits a motion where it is nearest. That instant moves with the
motion, so that to first order the least distance changes as the distance at that
instant does: a shift of the instant changes no distance, as the distance is stationary
in time there. A row at another instant of the same approach would change with the
shift: it has hardly any slack, and would seem active where no limit is. So each
approach of a pair is one row, at its nearest instant; only a pair that stays near for a
while has further rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.certificate.motion import Motion
from tominpmp.constraints import ClearanceConstraint
from tominpmp.motion.extrema import local_maxima, rising_then_falling

# Shares of intervals at which a pair that stays near is a row, too: middles and ends.
REGULAR = (0.5, 1.0)
# Clearances beyond this, in shares of the reach, are no rows.
ATTENTION = 0.03
# Samples of an interval, between which the nearest instants of pairs are searched.
SAMPLES = 16
# Pairs nearer than this, in shares of the reach, are refined, as corners pass each
# other within a millisecond: by this number of halvings of the time around a sample.
CLOSE, HALVINGS = 0.01, 6
# A pair stays near where its slack, at its speed, lasts for this share of the motion.
STAYING = 0.05


class Nearest(NamedTuple):
    """Nearest instants of collision pairs in a motion, k in all.

    Attributes:
        times: The instants [s], shape (k,).
        pairs: Indices of the pairs, shape (k,).
        missing: Margin less distance, as a share of the reach, shape (k,).
        slopes: Derivatives of the missing clearance at the least distance, as shares of
            the reach, by the configuration, shape (k, n). Where the closest corner
            changes, they are a mean of the slopes before and after.
        rates: Partial derivatives by time, from moving obstacles [1/s], shape (k,).
    """

    times: Array
    pairs: IntArray
    missing: Array
    slopes: Array
    rates: Array


def contacts(motion: Motion, item: ClearanceConstraint) -> Nearest | None:
    """The nearest instants of all pairs, and instants at which pairs stay near.

    Args:
        motion: The motion.
        item: The distances, without padding.

    Returns:
        The pairs at these instants; None if no pair is near.
    """
    looks, changes = _Approaches(motion, item), motion.changes
    at = motion.instants(*(np.arange(1, SAMPLES + 1) / SAMPLES).tolist())
    times = at.times(changes.h)
    table = looks.table(times)
    near = table > -np.inf
    seen = np.flatnonzero(near.any(axis=0))
    if not seen.size:
        return None
    table, near = table[:, seen], near[:, seen]
    nearest = local_maxima(table)
    regular = np.isin(at.share, REGULAR)[:, None] & near & ~nearest

    def sampled(flags: BoolArray) -> Nearest:
        rows, columns = np.nonzero(flags)
        slopes = looks.slopes(times[rows], seen[columns])
        return Nearest(times[rows], seen[columns], table[rows, columns], *slopes)

    found = [sampled(nearest & (table <= -CLOSE)), sampled(regular)]
    # Rows at regular instants are kept for pairs that stay near for a while.
    staying, T = found[1], float(changes.t[-1])
    speed = np.abs(looks.speed(staying.times, staying.slopes, staying.rates))
    kept = np.maximum(-staying.missing, 0.0) >= STAYING * T * speed
    found[1] = Nearest._make(part[kept] for part in staying)
    close = nearest & (table > -CLOSE)
    if close.any():
        found.append(looks.closest(times, seen, table, close))
    return Nearest(*map(np.concatenate, zip(*found, strict=True)))


@dataclass(frozen=True, eq=False)
class _Approaches:
    """Missing clearances of collision pairs along a motion."""

    motion: Motion
    item: ClearanceConstraint

    def table(self, times: Array) -> Array:
        """Missing clearances of all pairs; minus infinity if far, shape (m, pairs)."""
        missing = self.item.values(self.motion.path(times).q, ATTENTION, times)
        return np.where(missing > -ATTENTION, missing, -np.inf)

    def slopes(self, times: Array, pair: IntArray) -> tuple[Array, Array]:
        """Derivatives of the missing clearances of pairs, at a time each."""
        distinct, index = np.unique(times, return_inverse=True)
        q = self.motion.path(distinct).q
        return self.item.derivatives_at(q, index, pair, distinct)

    def speed(self, times: Array, slopes: Array, rates: Array) -> Array:
        """Rate of the missing clearance along the motion [1/s], shape (k,)."""
        v = self.motion.path(times).v
        return np.asarray(np.einsum("kj,kj->k", slopes, v) + rates)

    def closest(
        self, times: Array, seen: IntArray, table: Array, flags: BoolArray
    ) -> Nearest:
        """The nearest instants around flagged samples.

        A corner that passes is a kink of the distance in time, or nearly: the slope
        there is the mean of the slopes before and after that is stationary in time.
        """
        rows, columns = np.nonzero(flags)
        pair, changes = seen[columns], self.motion.changes
        first, last = changes.t[list(self.motion.span)]
        padded = np.concatenate([[first], times, [last]])
        begin, end = rising_then_falling(
            lambda at: self.speed(at, *self.slopes(at, pair)),
            padded[rows],
            padded[rows + 2],
            HALVINGS,
        )
        slopes = [self.slopes(time, pair) for time in (begin, end)]
        speeds = [self.speed(begin, *slopes[0]), self.speed(end, *slopes[1])]
        # The missing clearance grows before and falls after, else peaks at an end.
        rises, falls = np.maximum(speeds[0], 0.0), np.maximum(-speeds[1], 0.0)
        total = np.maximum(rises + falls, 1e-300)
        after = np.where(rises + falls > 0.0, rises / total, 0.5)
        time = (1.0 - after) * begin + after * end
        by_q = (1.0 - after)[:, None] * slopes[0][0] + after[:, None] * slopes[1][0]
        by_t = (1.0 - after) * slopes[0][1] + after * slopes[1][1]
        missing = np.maximum(self._missing(time, pair), table[rows, columns])
        return Nearest(time, pair, missing, by_q, by_t)

    def _missing(self, times: Array, pair: IntArray) -> Array:
        """Missing clearances of pairs at a time each, shape (k,)."""
        item, every = self.item, np.arange(pair.size)
        margin = np.broadcast_to(item.margin, item.count)[pair]
        enough = margin + ATTENTION * item.length
        found = item.checker.measured(
            self.motion.path(times).q, every, pair, enough, times
        )
        missing = (margin - found) / item.length
        return np.where(missing > -ATTENTION, missing, -np.inf)
