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

from tominpmp.arrays import Array, IntArray
from tominpmp.certificate.motion import Motion
from tominpmp.constraints.clearance import ClearanceConstraint
from tominpmp.motion.extrema import local_maxima, rising_then_falling

# Shares of intervals at which a pair that stays near is a row, too, and constraints are
# in any case: middles and ends.
REGULAR = (0.5, 1.0)
# Clearances beyond this, in shares of the reach, are no rows.
ATTENTION = 0.03
# Samples of an interval, between which the nearest instants of pairs and constraints
# are searched.
SAMPLES = 16
# Number of halvings of the time around a sample: corners pass each other within a
# millisecond.
HALVINGS = 6
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


def contacts(motion: Motion, item: ClearanceConstraint) -> Nearest:
    """The nearest instants of all pairs, and instants at which pairs stay near.

    Args:
        motion: The motion.
        item: The distances, without padding.

    Returns:
        The pairs at these instants.
    """
    looks, T = _Approaches(motion, item), float(motion.changes.t[-1])
    at = motion.instants(*(np.arange(1, SAMPLES + 1) / SAMPLES).tolist())
    times = at.times(motion.changes.h)
    missing = looks.missing(times)
    nearest = local_maxima(missing)
    regular = np.isin(at.share, REGULAR)[:, None] & (missing > -np.inf) & ~nearest
    rows, pair = np.nonzero(regular)
    # Rows at regular instants are kept for pairs that stay near for a while.
    by_q, by_t, speed = looks.slopes(times[rows], pair)
    samples = Nearest(times[rows], pair, missing[rows, pair], by_q, by_t)
    kept = np.maximum(-samples.missing, 0.0) >= STAYING * T * np.abs(speed)
    found = looks.closest(times, missing, *np.nonzero(nearest))
    both = zip(samples, found, strict=True)
    return Nearest(*(np.concatenate([one[kept], other]) for one, other in both))


class _Slopes(NamedTuple):
    """Derivatives of missing clearances by configuration and time, and along a motion.

    Shapes (k, n), (k,) and (k,).
    """

    by_q: Array
    by_t: Array
    speed: Array


@dataclass(frozen=True, eq=False)
class _Approaches:
    """Missing clearances of collision pairs along a motion."""

    motion: Motion
    item: ClearanceConstraint

    def missing(self, times: Array) -> Array:
        """Missing clearances of all pairs; minus infinity if far, shape (m, pairs)."""
        missing = self.item.values(self.motion.path(times).q, ATTENTION, times)
        return np.where(missing > -ATTENTION, missing, -np.inf)

    def slopes(self, times: Array, pair: IntArray) -> _Slopes:
        """Derivatives of the missing clearances of pairs, at a time each."""
        distinct, index = np.unique(times, return_inverse=True)
        state = self.motion.path(distinct)
        by_q, by_t = self.item.derivatives_at(state.q, index, pair, distinct)
        return _Slopes(by_q, by_t, np.sum(by_q * state.v[index], axis=1) + by_t)

    def closest(
        self, times: Array, missing: Array, rows: IntArray, pair: IntArray
    ) -> Nearest:
        """The nearest instants of pairs around samples.

        A corner that passes is a kink of the distance in time, or nearly: the slope
        there is the mean of the slopes before and after that is stationary in time.
        """
        first, last = self.motion.changes.t[list(self.motion.span)]
        padded = np.concatenate([[first], times, [last]])
        ends = rising_then_falling(
            lambda at: self.slopes(at, pair).speed,
            padded[rows],
            padded[rows + 2],
            HALVINGS,
        )
        before, after = (self.slopes(time, pair) for time in ends)
        # The missing clearance grows before and falls after, else peaks at an end.
        rises, falls = np.maximum(before.speed, 0.0), np.maximum(-after.speed, 0.0)
        total = np.maximum(rises + falls, 1e-300)
        late = np.where(rises + falls > 0.0, rises / total, 0.5)
        time = (1.0 - late) * ends[0] + late * ends[1]
        by_q = (1.0 - late)[:, None] * before.by_q + late[:, None] * after.by_q
        by_t = (1.0 - late) * before.by_t + late * after.by_t
        there = self.missing(time)[np.arange(pair.size), pair]
        return Nearest(time, pair, np.maximum(there, missing[rows, pair]), by_q, by_t)
