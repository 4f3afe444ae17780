r"""Least time of a joint, or of any coordinate, whose acceleration is bounded.

Let a motion begin with a speed of at most :math:`v_0`, end with a speed of at most
:math:`v_1`, and never be faster than p. It takes at least :math:`t_1(v)`, the time of
speeding up from :math:`v_0`, until it is faster than v, and at least :math:`t_2(v)`,
the time of slowing down, from the last time at which it is faster than v to its end. So
it is faster than v for at most :math:`T - t_1(v) - t_2(v)`, and its displacement,
detours and pauses included, is at most

.. math:: \int_0^p (T - t_1(v) - t_2(v)) \, dv.

A motion that speeds up as fast as possible, cruises at p, and slows down as fast as
possible attains this displacement. The least time belongs to the highest peak p that
the displacement admits, or to a cruise at the speed limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array

# Relative rounding of times, in favour of a shorter time.
ROUNDING = 1e-9
# Tolerance of the goal [rad or m], and tolerance as a share of the braking distance, in
# accordance with the tolerances of the verification.
TOLERANCE, SHARE = 1e-3, 5e-3
# Tolerance of the final velocity [rad/s or m/s], in accordance with the verification:
# a speed at which the torque is exhausted is approached, but never attained.
SPEED = 1e-2
# Number of bisections for a peak, and the peak speed that counts as infinite.
HALVINGS, FASTEST = 60, 1e12
# Relative change of an acceleration below which it is integrated by Simpson's rule, as
# the logarithm loses digits.
STRAIGHT = 1e-3


@dataclass(frozen=True)
class Ramp:
    """Changes of speed with constant limits of the acceleration and of the jerk.

    Attributes:
        acceleration: Largest acceleration, possibly infinite.
        jerk: Largest jerk; if finite, accelerations at both ends are zero.
    """

    acceleration: float
    jerk: float = math.inf

    def __call__(self, low: float, high: float) -> tuple[float, float]:
        """Least time of a change of speed, and the integral of the time over the speed.

        Args:
            low: The lower speed.
            high: The higher speed, >= 0.

        Returns:
            The time t(high), infinite for an impossible change, and the integral of
            t(v) from the lower to the higher speed.
        """
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
        """The change if accelerations may jump."""
        return Ramp(self.acceleration)


@dataclass(frozen=True, eq=False)
class SpeedLaw:
    """Changes of speed with an acceleration limit that is piecewise linear in it.

    Attributes:
        knots: Speeds between which the limit is linear, increasing, shape (k,).
        level: Acceleration of each line at speed zero, shape (k + 1,).
        slope: Slope of each line, shape (k + 1,).
        ramp: Limits in addition, for speeds from zero on; None without any.
    """

    knots: Array
    level: Array
    slope: Array
    ramp: Ramp | None = None

    @classmethod
    def least_of(cls, limits: Callable[[Array], Array], bends: Array) -> SpeedLaw:
        """The law of the least of several limits at each speed.

        Args:
            limits: Function from speeds, shape (m,), to the accelerations that each
                limit allows at them, shape (p, m).
            bends: Speeds between which each limit is linear, increasing, shape (k,).
        """
        one, other = _within(bends, 1.0 / 3.0), _within(bends, 2.0 / 3.0)
        slopes = (limits(other) - limits(one)) / (other - one)
        levels = limits(one) - slopes * one
        i, k = np.triu_indices(len(levels), 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = (levels[k] - levels[i]) / (slopes[i] - slopes[k])
        edges = np.concatenate([[-np.inf], bends, [np.inf]])
        inside = (crossing > edges[:-1]) & (crossing < edges[1:])
        knots = np.union1d(bends, crossing[inside])
        v = _within(knots, 0.5)
        piece = np.searchsorted(bends, v)
        least = np.argmin(levels[:, piece] + slopes[:, piece] * v, axis=0)
        return cls(knots, levels[least, piece], slopes[least, piece])

    @property
    def reflected(self) -> SpeedLaw:
        """The law for speeds in the opposite direction."""
        return SpeedLaw(-self.knots[::-1], self.level[::-1], -self.slope[::-1])

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
        """Pieces between two speeds: end speeds, and the accelerations at both ends."""
        inner = self.knots[(self.knots > low) & (self.knots < high)].tolist()
        first = int(np.searchsorted(self.knots, low, "right"))
        pieces = []
        for k, (v, w) in enumerate(zip([low, *inner], [*inner, high], strict=True)):
            a, b = float(self.level[first + k]), float(self.slope[first + k])
            pieces.append((v, w, (a + b * v, a + b * w)))
        return pieces

    def __call__(self, low: float, high: float) -> tuple[float, float]:
        """The larger time and integral of the limits and of the ramp: see Ramp."""
        time = integral = 0.0
        for v, w, ends in self._pieces(low, high):
            if v == w:
                continue
            if min(ends) <= 0.0:
                return math.inf, math.inf
            t, more = _along_a_line(w - v, *ends)
            integral += time * (w - v) + more
            time += t
        if self.ramp is None:
            return time, integral
        least = self.ramp(max(low, 0.0), high)
        return max(time, least[0]), max(integral, least[1])

    @property
    def abrupt(self) -> SpeedLaw:
        """The change if accelerations may jump."""
        return replace(self, ramp=None)


# The fastest change of the speed between two values. The same object describes speeding
# up from the lower value, and slowing down to it.
SpeedChange = Ramp | SpeedLaw


def last_bracket(
    holds: Callable[[float], bool], first: float, most: float, halvings: int
) -> tuple[float, float]:
    """Bracket the largest number for which a condition holds.

    Args:
        holds: Whether the condition holds; it holds for zero, and for all numbers below
            a number for which it holds.
        first: First number to be tried; it is doubled as long as the condition holds.
        most: Largest number to be tried; both ends of the bracket are equal to it if
            the condition holds for it.
        halvings: Number of bisections of the bracket.

    Returns:
        The lower and the upper end of the bracket.
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


def _within(knots: Array, share: float) -> Array:
    """A speed at a share of each piece between knots, and beyond both end knots."""
    ends = np.concatenate([knots[:1] - 2.0, knots, knots[-1:] + 2.0])
    return np.asarray(ends[:-1] + share * np.diff(ends))


def _along_a_line(change: float, first: float, last: float) -> tuple[float, float]:
    """Time and integral of a change whose acceleration is linear in the speed."""
    if abs(last - first) < STRAIGHT * first:
        middle = 0.5 * (first + last)
        time = change / 6.0 * (1.0 / first + 4.0 / middle + 1.0 / last)
        return time, change**2 / 6.0 * (1.0 / first + 2.0 / middle)
    slope = (last - first) / change
    time = math.log(last / first) / slope
    return time, (last * time - change) / slope


@dataclass(frozen=True, eq=False)
class OneWay:
    """Motions in one direction.

    Attributes:
        up: Law of increasing speed.
        down: Law of decreasing speed.
        top: Speed limit, possibly infinite.
        ends: Largest speeds at the start and at the end, negative in the opposite
            direction, possibly infinite.
    """

    up: SpeedChange
    down: SpeedChange
    top: float
    ends: tuple[float, float]

    def least_time(self, distance: float) -> float:
        """Least time for a displacement [s]; infinite if it is impossible."""
        peak, loss = self._peak(lambda time, peak, loss: peak * time - loss >= distance)
        if peak > 0.0:
            return (distance + loss) / peak * (1.0 - ROUNDING)
        return math.inf if distance + loss > 0.0 else 0.0

    def farthest(self, T: float) -> float:
        """Largest displacement in a time [s]."""
        peak, loss = self._peak(lambda time, peak, loss: time >= T)
        return peak * T - loss

    def _peak(
        self, too_high: Callable[[float, float, float], bool]
    ) -> tuple[float, float]:
        """The highest possible peak speed, and the loss against a cruise at the peak.

        Args:
            too_high: Whether a peak, and all higher peaks, are too high: a function of
                the time of both changes of speed, the peak, and the displacement that
                both changes lose against a cruise at the peak.

        Returns:
            An upper bound of the peak, possibly infinite, and a lower bound of the
            loss.
        """

        def possible(peak: float) -> bool:
            time, loss = self._changes(peak)
            return math.isfinite(time) and not too_high(time, peak, loss)

        first = self.top if math.isfinite(self.top) else 1.0
        low, high = last_bracket(possible, first, min(self.top, FASTEST), HALVINGS)
        # If no speed above zero is possible, the bisection ends at a tiny speed.
        most = 0.0 if low == 0.0 else high
        return math.inf if most == FASTEST else most, self._changes(low)[1]

    def _changes(self, peak: float) -> tuple[float, float]:
        """Time of speeding up to a peak and slowing down, and the displacement lost."""
        first = self.up(min(self.ends[0], peak), peak)
        last = self.down(min(self.ends[1], peak), peak)
        return first[0] + last[0], first[1] + last[1]


@dataclass(frozen=True, eq=False)
class Drive:
    """Speed and acceleration limits of a coordinate in both directions.

    Attributes:
        ahead: Laws of increasing and decreasing speed of forward motions.
        back: Laws of increasing and decreasing speed of backward motions.
        top: Speed limit, possibly infinite.
    """

    ahead: tuple[SpeedChange, SpeedChange]
    back: tuple[SpeedChange, SpeedChange]
    top: float

    def farthest(self, T: float, ends: tuple[float, float]) -> float:
        """Largest displacement in a time, in either direction.

        Args:
            T: The time [s].
            ends: Largest speeds at the start and at the end, possibly infinite.
        """
        return max(self._one_way(side, ends).farthest(T) for side in (1.0, -1.0))

    def least_time(self, way: float, ends: tuple[float, float]) -> float:
        """Least time for a displacement or a larger displacement.

        Args:
            way: Least displacement, with its sign.
            ends: Velocities at the start and at the end; infinite where a velocity is
                free.

        Returns:
            The time [s]; infinite for an impossible displacement.
        """
        side = 1.0 if way >= 0.0 else -1.0
        along = [v if math.isinf(v) else side * v for v in ends]
        return self._one_way(side, (along[0], along[1])).least_time(abs(way))

    def least_time_between(self, way: float, ends: tuple[float, float]) -> float:
        """Least time for an exact displacement, with a fixed final velocity.

        Args:
            way: The displacement, with its sign.
            ends: Velocities at the start and at the end.

        Returns:
            The time [s]; infinite for an impossible displacement.
        """
        side = 1.0 if way >= 0.0 else -1.0
        v0, v1 = side * ends[0], side * ends[1]
        up, down = self.ahead if way >= 0.0 else self.back
        nearest = min(max(v0, v1 - SPEED), v1 + SPEED)
        low, high = min(v0, nearest), max(v0, nearest)
        time, integral = (up if nearest >= v0 else down).abrupt(low, high)
        braking = high * time - integral
        if braking - abs(way) <= TOLERANCE + SHARE * abs(braking) or math.isinf(time):
            return self._one_way(side, (v0, v1)).least_time(abs(way))
        # Braking takes longer than the displacement: the motion overshoots and returns.
        return self._one_way(-side, (-v0, -v1)).least_time(-abs(way))

    def least_change(self, ends: tuple[float, float]) -> float:
        """Least time of a change of velocity, whatever the displacement.

        Args:
            ends: Velocities at the start and at the end; infinite where a velocity is
                free.

        Returns:
            The time [s], 0 for a free velocity; infinite for an impossible change.
        """
        if not all(map(math.isfinite, ends)):
            return 0.0
        law = self.ahead[0 if ends[1] >= ends[0] else 1]
        return law(min(ends), max(ends))[0] * (1.0 - ROUNDING)

    def _one_way(self, side: float, ends: tuple[float, float]) -> OneWay:
        """Forward motions, for a side of 1, or backward motions, for a side of -1."""
        changes = self.ahead if side > 0.0 else self.back
        return OneWay(*changes, self.top, ends)
