"""Nearest instants of collision pairs in a motion, and derivatives of the distances.

A collision pair limits a motion at the instant at which it is nearest. This instant
moves with the motion; as the distance is stationary in time there, a shift of the
instant does not change the distance, and to first order the least distance changes like
the distance at the fixed instant. A row at another instant of the same approach would
change with the shift: it has hardly any slack, and would seem active without limiting
the motion. Therefore each approach of a pair has one row, at its nearest instant; only
a pair that stays near for a while has more rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.certificate.motion import GridMotion
from tominpmp.constraints.clearance import ClearanceConstraint
from tominpmp.motion.extrema import local_maxima

# Shares of intervals at which pairs that stay near have rows in addition, and at which
# constraints have rows wherever they are near their bounds: middles and ends.
REGULAR = (0.5, 1.0)
# Clearance beyond the margin from which a pair has no row, as a share of the reach.
ATTENTION = 0.03
# Number of samples of an interval, between which the nearest instants of pairs and
# constraints are located.
SAMPLES = 16
# Number of bisections of the time around a sample: corners pass each other within a
# millisecond.
HALVINGS = 6
# Share of the motion for which the slack of a pair, at the rate of its distance, has to
# last if the pair counts as staying near.
STAYING = 0.05


class NearestInstants(NamedTuple):
    """Nearest instants of collision pairs in a motion, k in all.

    Attributes:
        times: The instants [s], shape (k,).
        pairs: Indices of the pairs, shape (k,).
        missing: Missing clearance: margin minus distance, as a share of the reach,
            shape (k,).
        slopes: Derivatives of the missing clearance with respect to the configuration,
            at the least distance, in shares of the reach, shape (k, n). Where the
            closest corner changes, they are a mean of the slopes before and after.
        rates: Partial derivatives with respect to time, due to moving obstacles [1/s],
            shape (k,).
    """

    times: Array
    pairs: IntArray
    missing: Array
    slopes: Array
    rates: Array


def nearest_instants(motion: GridMotion, item: ClearanceConstraint) -> NearestInstants:
    """Nearest instants of all pairs, and instants at which pairs stay near.

    Args:
        motion: The motion.
        item: The clearance constraint, without padding.

    Returns:
        The pairs at the instants.
    """
    clearances, T = _Clearances(motion, item), float(motion.changes.t[-1])
    at = motion.instants(*(np.arange(1, SAMPLES + 1) / SAMPLES).tolist())
    times = at.times(motion.changes.h)
    missing = clearances.missing(times)
    nearest = local_maxima(missing)
    regular = np.isin(at.share, REGULAR)[:, None] & (missing > -np.inf) & ~nearest
    rows, pair = np.nonzero(regular)
    # Rows at regular instants are kept for pairs that stay near for a while.
    by_q, by_t, speed = clearances.slopes(times[rows], pair)
    regular_rows = NearestInstants(times[rows], pair, missing[rows, pair], by_q, by_t)
    stays = np.maximum(-regular_rows.missing, 0.0) >= STAYING * T * np.abs(speed)
    closest = clearances.closest(times, missing, *np.nonzero(nearest))
    both = zip(regular_rows, closest, strict=True)
    return NearestInstants(*(np.concatenate([a[stays], b]) for a, b in both))


class _Slopes(NamedTuple):
    """Derivatives of missing clearances.

    Attributes:
        by_q: Derivatives with respect to the configuration, shape (k, n).
        by_t: Partial derivatives with respect to time, shape (k,).
        speed: Total derivatives with respect to time along the motion, shape (k,).
    """

    by_q: Array
    by_t: Array
    speed: Array


@dataclass(frozen=True, eq=False)
class _Clearances:
    """Missing clearances of collision pairs along a motion."""

    motion: GridMotion
    item: ClearanceConstraint

    def missing(self, times: Array) -> Array:
        """Missing clearances of all pairs, -inf for distant pairs, shape (m, pairs)."""
        missing = self.item.values(self.motion.trajectory(times, 0), ATTENTION, times)
        return np.where(missing > -ATTENTION, missing, -np.inf)

    def slopes(self, times: Array, pair: IntArray) -> _Slopes:
        """Derivatives of the missing clearances of pairs, each pair at its time."""
        distinct, index = np.unique(times, return_inverse=True)
        state = self.motion.path(distinct)
        by_q, by_t = self.item.derivatives_at(state.q, index, pair, distinct)
        return _Slopes(by_q, by_t, np.sum(by_q * state.v[index], axis=1) + by_t)

    def closest(
        self, times: Array, missing: Array, rows: IntArray, pair: IntArray
    ) -> NearestInstants:
        """Nearest instants of pairs around samples.

        Where a corner passes, the distance has a kink in time, or nearly: the slope is
        the convex combination of the slopes before and after that is stationary in
        time.

        Args:
            times: Times of the samples [s], shape (m,).
            missing: Missing clearances at the samples, shape (m, pairs).
            rows: Index of the nearest sample of each approach, shape (k,).
            pair: Index of the pair of each approach, shape (k,).
        """
        first, last = self.motion.changes.t[list(self.motion.span)]
        padded = np.concatenate([[first], times, [last]])
        early, late = padded[rows], padded[rows + 2]
        for _ in range(HALVINGS):
            middle = 0.5 * (early + late)
            rising = self.slopes(middle, pair).speed > 0.0
            early = np.where(rising, middle, early)
            late = np.where(rising, late, middle)
        before, after = self.slopes(early, pair), self.slopes(late, pair)
        # The missing clearance rises before its maximum and falls after it; otherwise
        # the maximum is at an end of the motion.
        rises, falls = np.maximum(before.speed, 0.0), np.maximum(-after.speed, 0.0)
        total = np.maximum(rises + falls, 1e-300)
        share = np.where(rises + falls > 0.0, rises / total, 0.5)
        time = (1.0 - share) * early + share * late
        by_q = (1.0 - share)[:, None] * before.by_q + share[:, None] * after.by_q
        by_t = (1.0 - share) * before.by_t + share * after.by_t
        peak = self.missing(time)[np.arange(pair.size), pair]
        most = np.maximum(peak, missing[rows, pair])
        return NearestInstants(time, pair, most, by_q, by_t)
