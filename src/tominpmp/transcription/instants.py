"""Instants of a motion on a grid: intervals, and shares of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tominpmp.arrays import Array, IntArray


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants within intervals.

    Attributes:
        interval: Index of the interval, shape (m,).
        share: Where in it, from 0 to 1, shape (m,).
    """

    interval: IntArray
    share: Array

    @classmethod
    def none(cls) -> Instants:
        """No instants at all."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros(0))

    @classmethod
    def of_pairs(cls, pairs: Sequence[tuple[int, float]]) -> Instants:
        """Instants from pairs of an interval and a share of it."""
        interval = np.array([k for k, _ in pairs], dtype=np.int64)
        return cls(interval, np.array([share for _, share in pairs]))

    @property
    def pairs(self) -> list[tuple[int, float]]:
        """Pairs of the interval and the share of it."""
        return list(zip(self.interval.tolist(), self.share.tolist(), strict=True))

    @staticmethod
    @lru_cache(maxsize=64)
    def spread(intervals: int, shares: tuple[float, ...]) -> Instants:
        """The same shares of all intervals, interval by interval.

        Instants that are equal are one object, which caches of values are keyed by.
        """
        every = np.repeat(np.arange(intervals), len(shares))
        where = np.tile(shares, intervals)
        every.flags.writeable = where.flags.writeable = False
        return Instants(every, where)

    @classmethod
    def end(cls, intervals: int) -> Instants:
        """The end of the motion."""
        return cls(np.array([intervals - 1]), np.ones(1))

    @classmethod
    def nodes(cls, intervals: int) -> Instants:
        """Beginnings of all intervals, and the end."""
        return cls.spread(intervals, (0.0,)).joined(cls.end(intervals))

    @classmethod
    def at_times(cls, times: Array, h: Array, delays: float | Array = 0.0) -> Instants:
        """Instants at times [s]; times after the end are put at the end.

        Args:
            times: Shape (m,).
            h: Lengths of the intervals [s], shape (N,).
            delays: Sum of the dwells before each interval [s].
        """
        ends = np.cumsum(h) + delays
        interval = np.minimum(np.searchsorted(ends, times), h.size - 1)
        share = (times - (ends - h)[interval]) / h[interval]
        return cls(interval, np.clip(share, 0.0, 1.0))

    @property
    def size(self) -> int:
        """Number of instants."""
        return int(self.interval.size)

    def within(self, first: int, end: int) -> Instants:
        """The instants in the intervals from ``first`` to before ``end``."""
        mine = (self.interval >= first) & (self.interval < end)
        if np.all(mine):
            return self
        return Instants(self.interval[mine], self.share[mine])

    def joined(self, other: Instants) -> Instants:
        """These instants and others."""
        return Instants(
            np.concatenate([self.interval, other.interval]),
            np.concatenate([self.share, other.share]),
        )

    def times(self, h: Array) -> Array:
        """Times of the instants [s], shape (m,).

        Args:
            h: Lengths of the intervals [s], shape (N,); or shares of them by durations,
                shape (N, k), for shares of the times, shape (m, k).
        """
        begins, share = np.cumsum(h, axis=0) - h, self.share
        share = share if h.ndim == 1 else share[:, None]
        return np.asarray(begins[self.interval] + share * h[self.interval])

    @property
    def middles(self) -> Instants:
        """The middles of their intervals."""
        return Instants(self.interval, np.full(self.size, 0.5))
