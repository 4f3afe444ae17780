"""Instants of a motion on a grid, and those at which something is largest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.certificate.perturbations import JUST_INSIDE, Linearised, Perturbations


class Instants(NamedTuple):
    """Instants of a motion on a grid, interval by interval.

    Attributes:
        interval: Interval of each, shape (m,).
        share: Where in it, from 0 to 1, shape (m,).
    """

    interval: IntArray
    share: Array

    @classmethod
    def spread(cls, intervals: int, shares: Array) -> Instants:
        """The same shares of all intervals."""
        every = np.arange(intervals)
        return cls(np.repeat(every, shares.size), np.tile(shares, intervals))

    @classmethod
    def at_times(cls, changes: Perturbations, times: Array) -> Instants:
        """The instants at times [s] within the motion, shape (m,)."""
        interval = np.searchsorted(changes.t, times, side="left") - 1
        interval = np.clip(interval, 0, changes.N - 1)
        share = (times - changes.t[interval]) / changes.h[interval]
        return cls(interval, np.clip(share, 0.0, 1.0))

    @property
    def inside(self) -> Instants:
        """The same, just inside of their intervals where they are at ends of them."""
        share = np.clip(self.share, JUST_INSIDE, 1.0 - JUST_INSIDE)
        return Instants(self.interval, share)

    def times(self, changes: Perturbations) -> Array:
        """When they are [s], shape (m,)."""
        h = changes.h[self.interval]
        return np.asarray(changes.t[self.interval] + self.share * h)

    def with_time(self, change: Linearised, rate: Array) -> Linearised:
        """Rows with what the times of the instants add, which follow the lengths.

        Args:
            change: The rows at the shares of the intervals, whatever the time.
            rate: What they change by with time alone, shape (m,), in their units [1/s].
        """
        columns = np.arange(change.by_length.shape[1])
        passed = np.where(self.interval[:, None] > columns, 1.0, 0.0)
        passed[np.arange(rate.size), self.interval] = self.share
        later = sp.csr_matrix(rate[:, None] * passed)
        return Linearised(change.matrix, (change.by_length + later).tocsr())

    def kept(self, which: IntArray | BoolArray) -> Instants:
        """Some of them."""
        return Instants(self.interval[which], self.share[which])


def local_maxima(table: Array) -> BoolArray:
    """Where values are not smaller than before, and larger than after.

    Args:
        table: Values, one row an instant, shape (m, p); minus infinity where unknown.
    """
    padded = np.pad(table, ((1, 1), (0, 0)), constant_values=-np.inf)
    known = table > -np.inf
    return np.asarray(known & (table >= padded[:-2]) & (table > padded[2:]))


def beside(flags: BoolArray) -> BoolArray:
    """The rows that are flagged, and those before and after them, shape (m, p)."""
    out = flags.copy()
    out[1:] |= flags[:-1]
    out[:-1] |= flags[1:]
    return out
