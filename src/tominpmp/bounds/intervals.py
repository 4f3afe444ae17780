"""Arithmetic of intervals, and the ranges of functions over them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray

TURN = 2.0 * math.pi


class Interval(NamedTuple):
    """Intervals of numbers, bounds of any one shape.

    Attributes:
        low: Lower bounds.
        high: Upper bounds.
    """

    low: Array
    high: Array

    @classmethod
    def everything(cls, size: int) -> Interval:
        """Some intervals without bounds."""
        return cls(np.full(size, -np.inf), np.full(size, np.inf))

    @classmethod
    def around(cls, half: Array) -> Interval:
        """Intervals from -half to half."""
        return cls(-half, half)

    def plus(self, other: Interval) -> Interval:
        """The sum."""
        return Interval(self.low + other.low, self.high + other.high)

    def minus(self, other: Interval) -> Interval:
        """The difference."""
        return Interval(self.low - other.high, self.high - other.low)

    def times(self, other: Interval) -> Interval:
        """The product; zero times infinity is zero."""
        with np.errstate(invalid="ignore"):
            a, b = self.low * other.low, self.low * other.high
            c, d = self.high * other.low, self.high * other.high
            unknown = np.isnan(a + b + c + d).any()
        if unknown:
            a, b, c, d = (np.where(np.isnan(part), 0.0, part) for part in (a, b, c, d))
        low = np.minimum(np.minimum(a, b), np.minimum(c, d))
        high = np.maximum(np.maximum(a, b), np.maximum(c, d))
        return Interval(low, high)

    def over(self, positive: Interval) -> Interval:
        """The quotient by positive numbers."""
        return self.times(Interval(1.0 / positive.high, 1.0 / positive.low))

    def squared(self) -> Interval:
        """The square."""
        ends = np.square(self.low), np.square(self.high)
        within = (self.low <= 0.0) & (self.high >= 0.0)
        return Interval(np.where(within, 0.0, np.minimum(*ends)), np.maximum(*ends))

    def with_zero(self) -> Interval:
        """The least intervals that have zero in them, too."""
        return Interval(np.minimum(self.low, 0.0), np.maximum(self.high, 0.0))

    def cut(self, other: Interval) -> Interval:
        """What both have."""
        return Interval(
            np.maximum(self.low, other.low), np.minimum(self.high, other.high)
        )

    def where(self, known: BoolArray, other: Interval) -> Interval:
        """Its own where that is known, and the other ones elsewhere."""
        return Interval(
            np.where(known, self.low, other.low), np.where(known, self.high, other.high)
        )

    def hull(self, other: Interval) -> Interval:
        """The least intervals that have both in them."""
        return Interval(
            np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        )

    def of_rows(self, rows: IntArray) -> Interval:
        """Those of some rows."""
        return Interval(self.low[rows], self.high[rows])

    @property
    def over_rows(self) -> Interval:
        """One row that holds all rows."""
        return Interval(
            self.low.min(axis=0, keepdims=True), self.high.max(axis=0, keepdims=True)
        )

    def reversed(self) -> Interval:
        """Those of each row from last to first."""
        return Interval(self.low[:, ::-1], self.high[:, ::-1])

    @property
    def none(self) -> BoolArray:
        """Which rows have one that is empty, but for rounding."""
        return np.asarray(np.any(self.low > self.high + 1e-6, axis=1))

    def cosine(self) -> Interval:
        """The cosine."""
        whole = ~(self.high - self.low < TURN)
        low, high = (np.where(whole, 0.0, part) for part in self)
        ends = np.cos(low), np.cos(high)
        tops = np.ceil(low / TURN) * TURN <= high
        dips = np.ceil((low - math.pi) / TURN) * TURN + math.pi <= high
        return Interval(
            np.where(whole | dips, -1.0, np.minimum(*ends)),
            np.where(whole | tops, 1.0, np.maximum(*ends)),
        )

    def sine(self) -> Interval:
        """The sine."""
        quarter = 0.5 * math.pi
        return Interval(self.low - quarter, self.high - quarter).cosine()


def scaled(interval: Interval, factor: float | Array) -> Interval:
    """Intervals times a factor >= 0; none times infinity is none.

    Several factors, of a shape that goes with that of the intervals, are > 0.
    """
    if np.ndim(factor) == 0 and factor == 0.0:
        return Interval(np.zeros_like(interval.low), np.zeros_like(interval.high))
    return Interval(factor * interval.low, factor * interval.high)


class Table:
    """Least and largest values of functions over intervals of one argument.

    Args:
        x: Arguments in equal distances, shape (m,).
        values: Values of the functions there, shape (k, m). Between two arguments they
            are taken to change by no more than second differences tell.
    """

    def __init__(self, x: Array, values: Array) -> None:
        self.first, self.h, self.size = float(x[0]), float(x[1] - x[0]), x.size
        bend = np.max(np.abs(np.diff(values, 2, axis=1)), axis=1, keepdims=True)
        # A parabola passes its chord by an eighth of its second difference.
        least, most = values - 0.25 * bend, values + 0.25 * bend
        self._levels = [(least, most)]
        width = 1
        while 2 * width <= x.size:
            least = np.minimum(least[:, :-width], least[:, width:])
            most = np.maximum(most[:, :-width], most[:, width:])
            self._levels.append((least, most))
            width *= 2

    def ranges(self, over: Interval) -> list[Interval]:
        """Ranges of the functions over intervals, of any shape.

        Intervals that leave the arguments are cut off at their ends.
        """
        shape = over.low.shape
        low, high = over.low.ravel(), over.high.ravel()
        begin = self._place(np.floor((low - self.first) / self.h))
        end = np.maximum(self._place(np.ceil((high - self.first) / self.h)), begin)
        level = np.floor(np.log2(end - begin + 1)).astype(np.intp)
        count = self._levels[0][0].shape[0]
        out = np.empty((2, count, begin.size))
        for k in np.unique(level).tolist():
            mine = np.flatnonzero(level == k)
            left, right = begin[mine], end[mine] + 1 - 2**k
            least, most = self._levels[k]
            out[0][:, mine] = np.minimum(least[:, left], least[:, right])
            out[1][:, mine] = np.maximum(most[:, left], most[:, right])
        return [
            Interval(out[0, i].reshape(shape), out[1, i].reshape(shape))
            for i in range(count)
        ]

    def _place(self, share: Array) -> IntArray:
        return np.asarray(np.clip(share, 0, self.size - 1).astype(np.intp))
