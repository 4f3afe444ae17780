r"""Least time of a joint, or of any coordinate, whose acceleration is bounded.

Let a motion begin with a speed of at most :math:`v_0`, end with at most :math:`v_1`,
and never be faster than p. It takes at least :math:`t_1(v)` until it is faster than v,
the time of speeding up from :math:`v_0`, and at least :math:`t_2(v)` from then to its
end, the time of slowing down. So it is faster than v for no longer than T less both,
and whatever it does, detours and pauses included, it covers no more than

.. math:: \int_0^p (T - t_1(v) - t_2(v)) \, dv.

A motion that speeds up as fast as it can, cruises at p, and slows down as fast as it
can covers just that. The least time is that of the highest peak p which the way leaves
room for, or of a cruise at the speed limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tominpmp.arrays import Array

# Relative rounding of times, in favour of a shorter time.
ROUNDING = 1e-9
# Tolerances of the goal [rad or m], and as a share of the braking distance, in
# accordance with those of the verification.
OFF, SHARE = 1e-3, 5e-3
# Halvings of the interval of peaks, and the speed of a peak that counts as infinite.
HALVINGS, FASTEST = 60, 1e12
# Accelerations that change by a smaller share are integrated by Simpson's rule, as the
# logarithm loses digits.
STRAIGHT = 1e-3


class Change(Protocol):
    """The fastest change of the speed between two values.

    The same object is for speeding up from the lower one, and slowing down to it.
    """

    def __call__(self, low: float, high: float) -> tuple[float, float]:
        """Least time of the change, and its integral over the higher speed.

        Args:
            low: The lower speed.
            high: The higher speed, >= 0.

        Returns:
            The time t(high), infinite for an impossible change, and the integral of
            t(v) from the lower speed to the higher one.
        """

    @property
    def abrupt(self) -> Change:
        """The change where accelerations may jump."""


@dataclass(frozen=True)
class Ramp:
    """Changes with a constant limit of the acceleration, and of the jerk.

    Attributes:
        acceleration: Largest acceleration, possibly infinite.
        jerk: Largest jerk; if finite, accelerations at both ends are zero.
    """

    acceleration: float
    jerk: float = math.inf

    def __call__(self, low: float, high: float) -> tuple[float, float]:
        """See :class:`Change`."""
        change, most = high - low, self.acceleration
        if change <= 0.0:
            return 0.0, 0.0
        if most <= 0.0:
            return math.inf, math.inf
        if math.isinf(self.jerk):
            time = change / most
        elif change * self.jerk >= most**2:
            time = change / most + most / self.jerk
        else:
            time = 2.0 * math.sqrt(change / self.jerk)
        return time, 0.5 * change * time

    @property
    def abrupt(self) -> Ramp:
        """See :class:`Change`."""
        return Ramp(self.acceleration)


@dataclass(frozen=True, eq=False)
class SpeedLaw:
    """Changes with a limit of the acceleration that is piecewise linear in the speed.

    Attributes:
        knots: Speeds between which it is linear, increasing, shape (k,).
        level: Acceleration that each line has at speed zero, shape (k + 1,).
        slope: Slope of each line, shape (k + 1,).
    """

    knots: Array
    level: Array
    slope: Array

    @classmethod
    def line(cls, level: float, slope: float = 0.0) -> SpeedLaw:
        """One line for all speeds."""
        return cls(np.zeros(0), np.array([level]), np.array([slope]))

    @property
    def reflected(self) -> SpeedLaw:
        """The law for speeds in the opposite direction."""
        return SpeedLaw(-self.knots[::-1], self.level[::-1], -self.slope[::-1])

    def plus(self, other: SpeedLaw) -> SpeedLaw:
        """The sum of two laws."""
        knots = np.union1d(self.knots, other.knots)
        (a, b), (c, d) = self._lines(knots), other._lines(knots)
        return SpeedLaw(knots, a + c, b + d)

    def lower_of(self, other: SpeedLaw) -> SpeedLaw:
        """The lower one of two laws at each speed."""
        gap = self.plus(SpeedLaw(other.knots, -other.level, -other.slope))
        edges = np.concatenate([[-np.inf], gap.knots, [np.inf]])
        with np.errstate(divide="ignore", invalid="ignore"):
            meet = -gap.level / gap.slope
        between = (meet > edges[:-1]) & (meet < edges[1:])
        knots = np.union1d(gap.knots, meet[between])
        (a, b), (c, d) = self._lines(knots), other._lines(knots)
        lower = a - c + (b - d) * _within(knots) <= 0.0
        return SpeedLaw(knots, np.where(lower, a, c), np.where(lower, b, d))

    def _lines(self, knots: Array) -> tuple[Array, Array]:
        """Its lines between more knots than its own."""
        piece = np.searchsorted(self.knots, _within(knots))
        return self.level[piece], self.slope[piece]

    def highest(self, top: float) -> float:
        """The largest acceleration at speeds from zero to a speed."""
        if math.isinf(top):
            if self.slope[-1] > 0.0:
                return math.inf
            top = max(float(np.max(self.knots, initial=0.0)), 0.0) + 1.0
        return max(max(ends) for *_, ends in self._pieces(0.0, top))

    def _pieces(
        self, low: float, high: float
    ) -> list[tuple[float, float, tuple[float, float]]]:
        """Lines between two speeds: their ends, and the accelerations there."""
        inner = self.knots[(self.knots > low) & (self.knots < high)].tolist()
        first = int(np.searchsorted(self.knots, low, "right"))
        found = []
        for k, (v, w) in enumerate(zip([low, *inner], [*inner, high], strict=True)):
            a, b = float(self.level[first + k]), float(self.slope[first + k])
            found.append((v, w, (a + b * v, a + b * w)))
        return found

    def __call__(self, low: float, high: float) -> tuple[float, float]:
        """See :class:`Change`."""
        time = integral = 0.0
        for v, w, ends in self._pieces(low, high):
            if v == w:
                continue
            if min(ends) <= 0.0:
                return math.inf, math.inf
            t, more = _along_a_line(w - v, *ends)
            integral += time * (w - v) + more
            time += t
        return time, integral

    @property
    def abrupt(self) -> SpeedLaw:
        """See :class:`Change`."""
        return self


def last_bracket(
    holds: Callable[[float], bool], first: float, most: float, halvings: int
) -> tuple[float, float]:
    """Numbers between which is the last up to which a condition holds.

    Args:
        holds: Whether it holds; it does for zero, and below any number for which it
            does.
        first: The first number to be tried, which is doubled as long as it holds.
        most: The largest one; both numbers are this where it holds even there.
        halvings: Number of halvings of what is between.
    """
    low, high = 0.0, min(first, most)
    while holds(high):
        low, high = high, min(2.0 * high, most)
        if low == most:
            return most, most
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low, high


def _within(knots: Array) -> Array:
    """A speed on each piece between knots, and beyond both ends."""
    if not knots.size:
        return np.zeros(1)
    return np.concatenate(
        [[knots[0] - 1.0], 0.5 * (knots[1:] + knots[:-1]), [knots[-1] + 1.0]]
    )


def _along_a_line(change: float, first: float, last: float) -> tuple[float, float]:
    """Time of a change during which the acceleration is linear, and its integral."""
    if abs(last - first) < STRAIGHT * first:
        middle = 0.5 * (first + last)
        time = change / 6.0 * (1.0 / first + 4.0 / middle + 1.0 / last)
        return time, change**2 / 6.0 * (1.0 / first + 2.0 / middle)
    slope = (last - first) / change
    time = math.log(last / first) / slope
    return time, (last * time - change) / slope


@dataclass(frozen=True, eq=False)
class Both:
    """Changes within two limits, the second of which is known from speed zero on.

    Attributes:
        law: The limit for all speeds.
        ramp: The second limit.
    """

    law: Change
    ramp: Change

    def __call__(self, low: float, high: float) -> tuple[float, float]:
        """See :class:`Change`: neither is less than for one of the limits alone."""
        one, other = self.law(low, high), self.ramp(max(low, 0.0), high)
        return max(one[0], other[0]), max(one[1], other[1])

    @property
    def abrupt(self) -> Change:
        """See :class:`Change`."""
        return self.law


@dataclass(frozen=True, eq=False)
class OneWay:
    """Motions in one direction.

    Attributes:
        up: Their increase of speed.
        down: Their decrease of speed.
        top: Speed limit, possibly infinite.
        ends: Largest speeds at the start and at the end, negative in the opposite
            direction, possibly infinite.
    """

    up: Change
    down: Change
    top: float
    ends: tuple[float, float]

    def least_time(self, way: float) -> float:
        """Least time for a displacement [s]; infinite for an impossible one."""
        peak, missed = self._peak(lambda time, peak, lost: peak * time - lost >= way)
        if peak > 0.0:
            return (way + missed) / peak * (1.0 - ROUNDING)
        return math.inf if way + missed > 0.0 else 0.0

    def farthest(self, T: float) -> float:
        """Largest displacement in a time [s]."""
        peak, missed = self._peak(lambda time, peak, lost: time >= T)
        return peak * T - missed

    def _peak(
        self, enough: Callable[[float, float, float], bool]
    ) -> tuple[float, float]:
        """The highest possible peak speed, and the loss against a cruise at it.

        Args:
            enough: Whether a peak, and all higher ones, are too high: a function of the
                time of both changes of the speed, the peak, and the displacement that
                both changes lose against a cruise at the peak.

        Returns:
            An upper bound of the peak, possibly infinite, and a lower bound of the
            loss.
        """

        def room(peak: float) -> bool:
            time, lost = self._around(peak)
            return math.isfinite(time) and not enough(time, peak, lost)

        if not room(0.0):
            return 0.0, self._around(0.0)[1]
        first = self.top if math.isfinite(self.top) else 1.0
        low, high = last_bracket(room, first, min(self.top, FASTEST), HALVINGS)
        return math.inf if high == FASTEST else high, self._around(low)[1]

    def _around(self, peak: float) -> tuple[float, float]:
        """Time of speeding up to a peak and of slowing down, and its integral."""
        first = self.up(min(self.ends[0], peak), peak)
        last = self.down(min(self.ends[1], peak), peak)
        return first[0] + last[0], first[1] + last[1]


@dataclass(frozen=True, eq=False)
class Drive:
    """Limits of the acceleration of a coordinate in both directions.

    Attributes:
        ahead: Increase and decrease of the speed of forward motions.
        back: Increase and decrease of the speed of backward motions.
        top: Speed limit, possibly infinite.
    """

    ahead: tuple[Change, Change]
    back: tuple[Change, Change]
    top: float

    def farthest(self, T: float, ends: tuple[float, float]) -> float:
        """Largest displacement in a time, in either direction.

        Args:
            T: The time [s].
            ends: Largest speeds at start and end, possibly infinite.
        """
        return max(self._one_way(side, ends).farthest(T) for side in (1.0, -1.0))

    def least_time(self, way: float, ends: tuple[float, float]) -> float:
        """Least time for a displacement or a larger one.

        Args:
            way: Least displacement, with its sign.
            ends: Its velocities at start and end; infinite for any velocity.

        Returns:
            The time [s]; infinite for an impossible displacement.
        """
        side = 1.0 if way >= 0.0 else -1.0
        along = [v if math.isinf(v) else side * v for v in ends]
        return self._one_way(side, (along[0], along[1])).least_time(abs(way))

    def least_time_between(self, way: float, ends: tuple[float, float]) -> float:
        """Least time for an exact displacement, with a given final velocity.

        Args:
            way: The displacement, with its sign.
            ends: Its velocities at start and end.

        Returns:
            The time [s]; infinite for an impossible displacement.
        """
        side = 1.0 if way >= 0.0 else -1.0
        v0, v1 = side * ends[0], side * ends[1]
        up, down = self.ahead if way >= 0.0 else self.back
        time, integral = (up if v1 >= v0 else down).abrupt(min(v0, v1), max(v0, v1))
        braking = max(v0, v1) * time - integral
        if braking - abs(way) <= OFF + SHARE * abs(braking) or math.isinf(time):
            return self._one_way(side, (v0, v1)).least_time(abs(way))
        # It cannot brake before the goal: it passes the goal and comes back.
        return self._one_way(-side, (-v0, -v1)).least_time(-abs(way))

    def _one_way(self, side: float, ends: tuple[float, float]) -> OneWay:
        """Motions forwards, for a side of 1, or backwards, for one of -1."""
        changes = self.ahead if side > 0.0 else self.back
        return OneWay(*changes, self.top, ends)
