"""Instants of a motion on a grid: indices of intervals, and shares of their length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants within the intervals of a grid.

    Attributes:
        interval: Index of the interval of each instant, shape (m,).
        share: Share of the interval before the instant, from 0 to 1, shape (m,).
    """

    interval: IntArray
    share: Array

    @classmethod
    def of_pairs(cls, pairs: Sequence[tuple[int, float]]) -> Instants:
        """Instants from pairs of the index of an interval and a share of it."""
        interval = np.array([k for k, _ in pairs], dtype=np.int64)
        return cls(interval, np.array([share for _, share in pairs]))

    @property
    def pairs(self) -> list[tuple[int, float]]:
        """Pairs of the index of the interval and the share of it."""
        return list(zip(self.interval.tolist(), self.share.tolist(), strict=True))

    @staticmethod
    @lru_cache(maxsize=64)
    def spread(intervals: int, shares: tuple[float, ...]) -> Instants:
        """The same shares of all intervals, interval by interval.

        Equal arguments give the same object, which is the key of caches of values.
        """
        interval = np.repeat(np.arange(intervals), len(shares))
        share = np.tile(shares, intervals)
        interval.flags.writeable = share.flags.writeable = False
        return Instants(interval, share)

    @classmethod
    def end(cls, intervals: int) -> Instants:
        """The end of the motion."""
        return cls(np.array([intervals - 1]), np.ones(1))

    @classmethod
    def nodes(cls, intervals: int) -> Instants:
        """All nodes: the beginnings of all intervals, and the end of the motion."""
        return cls.spread(intervals, (0.0,)).joined(cls.end(intervals))

    @classmethod
    def at_times(cls, times: Array, h: Array, delays: float | Array = 0.0) -> Instants:
        """Instants at times [s]; times after the end are moved to the end.

        Args:
            times: Times [s], shape (m,).
            h: Lengths of the intervals [s], shape (N,).
            delays: Total duration of the dwells before each interval [s].
        """
        ends = np.cumsum(h) + delays
        interval = np.minimum(np.searchsorted(ends, times), h.size - 1)
        share = (times - (ends - h)[interval]) / h[interval]
        return cls(interval, np.clip(share, 0.0, 1.0))

    @property
    def size(self) -> int:
        """Number of instants."""
        return int(self.interval.size)

    def __getitem__(self, chosen: IntArray | BoolArray) -> Instants:
        """The instants of an index or a mask."""
        return Instants(self.interval[chosen], self.share[chosen])

    def within(self, first: int, end: int) -> Instants:
        """The instants in the intervals from ``first`` to before ``end``."""
        mine = (self.interval >= first) & (self.interval < end)
        return self if np.all(mine) else self[mine]

    def joined(self, other: Instants) -> Instants:
        """These instants and others."""
        return Instants(
            np.concatenate([self.interval, other.interval]),
            np.concatenate([self.share, other.share]),
        )

    def times(self, h: Array) -> Array:
        """Times of the instants without dwells [s], shape (m,).

        Args:
            h: Lengths of the intervals [s], shape (N,); or derivatives of the lengths
                by k durations, shape (N, k), for derivatives of the times, shape
                (m, k).
        """
        begins, share = np.cumsum(h, axis=0) - h, self.share
        share = share if h.ndim == 1 else share[:, None]
        return np.asarray(begins[self.interval] + share * h[self.interval])

    @property
    def middles(self) -> Instants:
        """The middles of the intervals of these instants."""
        return Instants(self.interval, np.full(self.size, 0.5))
