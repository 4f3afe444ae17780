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
        slopes: Partial derivatives of the missing clearance at the least distance, by
            the configuration and last by time [1/s], due to moving obstacles, in shares
            of the reach, shape (k, n + 1). Where the closest corner changes, they are a
            mean of the slopes before and after.
    """

    times: Array
    pairs: IntArray
    missing: Array
    slopes: Array


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
    slopes, speed = clearances.slopes(times[rows], pair)
    regular_rows = NearestInstants(times[rows], pair, missing[rows, pair], slopes)
    stays = np.maximum(-regular_rows.missing, 0.0) >= STAYING * T * np.abs(speed)
    closest = clearances.closest(times, missing, *np.nonzero(nearest))
    both = zip(regular_rows, closest, strict=True)
    return NearestInstants(*(np.concatenate([a[stays], b]) for a, b in both))


@dataclass(frozen=True, eq=False)
class _Clearances:
    """Missing clearances of collision pairs along a motion."""

    motion: GridMotion
    item: ClearanceConstraint

    def missing(self, times: Array) -> Array:
        """Missing clearances of all pairs, -inf for distant pairs, shape (m, pairs)."""
        missing = self.item.values(self.motion.trajectory(times, 0), ATTENTION, times)
        return np.where(missing > -ATTENTION, missing, -np.inf)

    def slopes(self, times: Array, pair: IntArray) -> tuple[Array, Array]:
        """Derivatives of the missing clearances of pairs, each pair at its time.

        Returns:
            Partial derivatives, see :class:`NearestInstants`; and total derivatives by
            time along the motion, shape (k,).
        """
        distinct, index = np.unique(times, return_inverse=True)
        state = self.motion.path(distinct)
        by_q, by_t = self.item.derivatives_at(state.q, index, pair, distinct)
        speed = np.sum(by_q * state.v[index], axis=1) + by_t
        return np.column_stack([by_q, by_t]), speed

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
            rising = self.slopes(middle, pair)[1] > 0.0
            early = np.where(rising, middle, early)
            late = np.where(rising, late, middle)
        (before, rise), (after, fall) = (self.slopes(t, pair) for t in (early, late))
        # The missing clearance rises before its maximum and falls after it; otherwise
        # the maximum is at an end of the motion.
        rises, falls = np.maximum(rise, 0.0), np.maximum(-fall, 0.0)
        total = np.maximum(rises + falls, 1e-300)
        share = np.where(rises + falls > 0.0, rises / total, 0.5)
        time = (1.0 - share) * early + share * late
        slopes = (1.0 - share)[:, None] * before + share[:, None] * after
        peak = self.missing(time)[np.arange(pair.size), pair]
        most = np.maximum(peak, missing[rows, pair])
        return NearestInstants(time, pair, most, slopes)
