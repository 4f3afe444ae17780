"""Bounds on quantities over time, from both ends of a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.intervals import Interval, scaled

# Bounds at both ends.
Ends = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Tube:
    """Bounds on a quantity at instants, from the start on and back from the goal.

    Attributes:
        onwards: Bounds from the start, shape (K + 1,).
        back: Bounds from the goal, shape (K + 1,).
        bulge: How far bounds from the start are beyond their chords in the mean, as a
            share of their change, shape (K,).
    """

    onwards: Interval
    back: Interval
    bulge: Array | None = None

    @classmethod
    def of(cls, ends: Ends, change: Interval) -> Tube:
        """Add up bounds on the changes in each interval, shape (K,)."""

        def summed(part: Array) -> Array:
            return np.concatenate([[0.0], np.cumsum(part)])

        begin, end = ends
        least, most = summed(change.low), summed(change.high)
        onwards = Interval(begin[0] + least, begin[1] + most)
        back = Interval(end[0] - (most[-1] - most), end[1] - (least[-1] - least))
        return cls(onwards, back)

    @classmethod
    def damped(cls, ends: Ends, rate: Interval, drag: Interval, h: float) -> Tube:
        """Bounds on a quantity x whose rate is another one less a drag times x.

        Args:
            ends: Bounds at start and goal.
            rate: Rate in each interval of time without the drag, shape (K,).
            drag: Drag there, >= 0.
            h: Length of the intervals.
        """
        begin, end = ends
        least, most = np.minimum(rate.low, 0.0), np.maximum(rate.high, 0.0)
        up = _decayed(begin[1], most, drag, h)
        down = _decayed(-begin[0], -least, drag, h)
        last = drag.high[::-1]
        grown = _grown(end[1], -least[::-1], last, h)[::-1]
        fallen = _grown(-end[0], most[::-1], last, h)[::-1]
        bulge = drag.high * (1.0 + drag.high * h) * h / 12.0
        return cls(Interval(-down, up), Interval(-fallen, grown), bulge)

    @property
    def empty(self) -> bool:
        """Whether there is an instant at which nothing is left."""
        both = self.onwards.cut(self.back)
        slack = 1e-9 * (1.0 + np.abs(both.low))
        return bool(np.any(both.low > both.high + slack))

    def within(self) -> Interval:
        """Bounds in each interval of time, shape (K,)."""
        return _hull(self.onwards).cut(_hull(self.back))

    def integral(self, h: float) -> Interval:
        """Bounds on its integral over each interval of time, shape (K,).

        The bounds are straight lines in each, or hollow ones back from the goal.
        """
        sides = [_mean(self.onwards), _mean(self.back)]
        if self.bulge is not None:
            share = np.minimum(self.bulge, 0.5)
            first = self.onwards
            sides[0] = Interval(
                sides[0].low + share * np.diff(first.low),
                sides[0].high + share * np.diff(first.high),
            )
        return scaled(sides[0].cut(sides[1]), h)


@dataclass(frozen=True, eq=False)
class TubeThrough:
    """Bounds on a quantity that is within a range halfway.

    Attributes:
        halves: Those before and those afterwards.
    """

    halves: tuple[Tube, Tube]

    @property
    def empty(self) -> bool:
        """Whether there is an instant at which nothing is left."""
        return self.halves[0].empty or self.halves[1].empty

    def within(self) -> Interval:
        """Bounds in each interval of time, shape (K,)."""
        first, last = (half.within() for half in self.halves)
        return first.followed_by(last)

    def integral(self, h: float) -> Interval:
        """Bounds on its integral over each interval of time, shape (K,)."""
        first, last = (half.integral(h) for half in self.halves)
        return first.followed_by(last)


def known(ends: tuple[float, float]) -> Ends:
    """Ends that are known exactly."""
    return (ends[0], ends[0]), (ends[1], ends[1])


def _mean(at: Interval) -> Interval:
    return Interval(
        0.5 * (at.low[1:] + at.low[:-1]), 0.5 * (at.high[1:] + at.high[:-1])
    )


def _decayed(x: float, rate: Array, drag: Interval, h: float) -> Array:
    """Largest value over time of what grows at a rate less its drag, shape (K + 1,)."""
    out = [x]
    decay = np.exp(-drag.low * h)
    gain = np.where(drag.low * h > 1e-9, -np.expm1(-drag.low * h), 0.0)
    gain = np.where(gain > 0.0, gain / np.maximum(drag.low, 1e-300), h)
    for f, r, d, g in zip(decay, rate, drag.high, gain, strict=True):
        # Below zero the drag helps, at most as long as x is what it is now.
        after = x * f + r * g if x >= 0.0 else x + (r - d * x) * h
        x = max(x, float(after))
        out.append(x)
    return np.array(out)


def _grown(x: float, rate: Array, drag: Array, h: float) -> Array:
    """The same back in time, when drag makes it grow."""
    out = [x]
    with np.errstate(over="ignore"):
        growth = np.exp(drag * h)
        gain = np.where(
            drag * h > 1e-9, np.expm1(drag * h) / np.maximum(drag, 1e-300), h
        )
    for f, r, g in zip(growth, rate, gain, strict=True):
        x = float(x * f + r * g) if x >= 0.0 else float(x + r * g)
        out.append(x)
    return np.array(out)


def _hull(at: Interval) -> Interval:
    return Interval(
        np.minimum(at.low[1:], at.low[:-1]), np.maximum(at.high[1:], at.high[:-1])
    )
