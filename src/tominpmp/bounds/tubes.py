"""Bounds on quantities over time, from both ends of a motion and through its gates.

All bounds are those of many sets of motions at once, a row each. Between two gates
bounds change as fast as they may; at a gate they are cut to the range that the motions
of a row are in there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.bounds.intervals import Interval, scaled


class Gates(NamedTuple):
    """Ranges of a quantity at some instants.

    Attributes:
        at: Numbers of the instants, G of them, rising.
        low: Lower bounds, shape (m, G).
        high: Upper bounds, shape (m, G).
    """

    at: tuple[int, ...]
    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class Tube:
    """Bounds on a quantity, from the start on and back from the goal.

    Attributes:
        onwards: Bounds from the start, at begin and end of each interval of time,
            shapes (m, K).
        back: The same from the goal.
        bulge: How far bounds from the start are beyond their chords in the mean, as a
            share of their change, shape (m, K).
    """

    onwards: tuple[Interval, Interval]
    back: tuple[Interval, Interval]
    bulge: Array | None = None

    @classmethod
    def of(cls, ends: tuple[float, float], change: Interval, gates: Gates) -> Tube:
        """Add up bounds on the changes in each interval, shape (m, K)."""
        most, least = change.high, -change.low
        grown = _summed
        return cls._around(ends, gates, (grown, most, least), (grown, least, most))

    @classmethod
    def damped(
        cls,
        ends: tuple[float, float],
        rate: Interval,
        drag: Interval,
        h: Array,
        gates: Gates,
    ) -> Tube:
        """Bounds on a quantity x whose rate is another one less a drag times x.

        Args:
            ends: What it is at start and goal.
            rate: Rate in each interval of time without the drag, shape (m, K).
            drag: Drag there, >= 0.
            h: Length of the intervals, shape (m, 1).
            gates: What it is on the way.
        """
        if not np.any(drag.high):
            return cls.of(ends, scaled(rate.with_zero(), h), gates)
        most, least = np.maximum(rate.high, 0.0), np.maximum(-rate.low, 0.0)
        first = Interval(drag.low, drag.high)
        last = first.reversed()

        def decayed(x: float, rate: Array, at: tuple[int, ...], caps: Array) -> _Side:
            return _decayed(x, rate, first, h, at, caps)

        def grown(x: float, rate: Array, at: tuple[int, ...], caps: Array) -> _Side:
            return _grown(x, rate, last.high, h, at, caps)

        bulge = drag.high * (1.0 + drag.high * h) * h / 12.0
        return cls._around(
            ends, gates, (decayed, most, least), (grown, least, most), bulge
        )

    @classmethod
    def _around(
        cls,
        ends: tuple[float, float],
        gates: Gates,
        onwards: tuple[_Grow, Array, Array],
        back: tuple[_Grow, Array, Array],
        bulge: Array | None = None,
    ) -> Tube:
        """Bounds by functions that follow upper ones, with rates up and down."""
        at, low, high = gates
        grow, up, down = onwards
        above = grow(ends[0], up, at, high)
        below = grow(-ends[0], down, at, -low)
        K = up.shape[1]
        turned = tuple(K - k for k in reversed(at))
        grow, up, down = back
        above_back = grow(ends[1], up[:, ::-1], turned, high[:, ::-1])
        below_back = grow(-ends[1], down[:, ::-1], turned, -low[:, ::-1])
        return cls(
            (Interval(-below[0], above[0]), Interval(-below[1], above[1])),
            (
                Interval(-below_back[1], above_back[1]).reversed(),
                Interval(-below_back[0], above_back[0]).reversed(),
            ),
            bulge,
        )

    def at(self, node: int) -> Interval:
        """Bounds at an instant on the way, shape (m,)."""
        one = Interval(self.onwards[0].low[:, node], self.onwards[0].high[:, node])
        other = self.back[1]
        return one.cut(Interval(other.low[:, node - 1], other.high[:, node - 1]))

    @property
    def empty(self) -> BoolArray:
        """In which rows there is an instant at which nothing is left, shape (m,)."""
        out = np.zeros(self.onwards[0].low.shape[0], dtype=bool)
        for side in (0, 1):
            both = self.onwards[side].cut(self.back[side])
            slack = 1e-9 * (1.0 + np.abs(both.low))
            out |= np.any(both.low > both.high + slack, axis=1)
        return out

    def within(self) -> Interval:
        """Bounds in each interval of time, shape (m, K)."""
        return (
            self.onwards[0].hull(self.onwards[1]).cut(self.back[0].hull(self.back[1]))
        )

    def integral(self, h: Array) -> Interval:
        """Bounds on its integral over each interval of time, shape (m, K).

        The bounds are straight lines in each, or hollow ones back from the goal.
        """
        begin, end = self.onwards
        first = scaled(begin.plus(end), 0.5)
        if self.bulge is not None:
            share = np.minimum(self.bulge, 0.5)
            first = Interval(
                first.low + share * (end.low - begin.low),
                first.high + share * (end.high - begin.high),
            )
        return scaled(first.cut(scaled(self.back[0].plus(self.back[1]), 0.5)), h)


# Upper bounds at begin and end of each interval of time, shape (m, K) each.
_Side = tuple[Array, Array]
_Grow = Callable[[float, Array, tuple[int, ...], Array], _Side]


def _summed(x: float, change: Array, at: tuple[int, ...], caps: Array) -> _Side:
    """Upper bounds that change by as much as they may, capped at gates."""
    m, K = change.shape
    begin, end = np.empty((m, K)), np.empty((m, K))
    now = np.full((m, 1), x)
    first = 0
    for number, last in enumerate((*at, K)):
        np.cumsum(change[:, first:last], axis=1, out=end[:, first:last])
        end[:, first:last] += now
        begin[:, first] = now[:, 0]
        begin[:, first + 1 : last] = end[:, first : last - 1]
        if number < len(at):
            now = np.minimum(end[:, last - 1], caps[:, number])[:, None]
        first = last
    return begin, end


def _decayed(
    x: float, rate: Array, drag: Interval, h: Array, at: tuple[int, ...], caps: Array
) -> _Side:
    """Largest value over time of what grows at a rate less its drag."""
    slow = drag.low * h > 1e-9
    decay = np.exp(-drag.low * h)
    gain = np.where(slow, -np.expm1(-drag.low * h), h)
    gain = rate * np.where(slow, gain / np.where(slow, drag.low, 1.0), gain)
    held, change = 1.0 - drag.high * h, rate * h

    def step(now: Array, k: int) -> Array:
        # Below zero the drag helps, at most as long as x is what it is now.
        after = np.where(
            now >= 0.0,
            now * decay[:, k] + gain[:, k],
            now * held[:, k] + change[:, k],
        )
        return np.maximum(now, after)

    return _stepped(x, rate.shape, step, at, caps)


def _grown(
    x: float, rate: Array, drag: Array, h: Array, at: tuple[int, ...], caps: Array
) -> _Side:
    """The same back in time, when drag makes it grow, to infinity if it is strong."""
    fast = drag * h > 1e-9
    with np.errstate(over="ignore"):
        growth = np.exp(drag * h)
        gain = np.where(fast, np.expm1(drag * h) / np.where(fast, drag, 1.0), h)

        # Nothing stays nothing, however much it grows.
        gain = np.multiply(gain, rate, out=np.zeros_like(rate), where=rate > 0.0)

        def step(now: Array, k: int) -> Array:
            grown = np.multiply(now, growth[:, k], out=now.copy(), where=now > 0.0)
            return np.asarray(grown + gain[:, k])

        return _stepped(x, rate.shape, step, at, caps)


def _stepped(
    x: float,
    shape: tuple[int, ...],
    step: Callable[[Array, int], Array],
    at: tuple[int, ...],
    caps: Array,
) -> _Side:
    begin, end = np.empty(shape), np.empty(shape)
    now = np.full(shape[0], x)
    gates = {node: number for number, node in enumerate(at)}
    for k in range(shape[1]):
        begin[:, k] = now
        now = end[:, k] = step(now, k)
        if k + 1 in gates:
            now = np.minimum(now, caps[:, gates[k + 1]])
    return begin, end
