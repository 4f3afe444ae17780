"""Least time of one joint on which gravity acts alike wherever it is.

Its acceleration is bounded by functions of its speed alone, so that one component of
the costate is constant and the other changes sign once at most: by the minimum
principle there is one switch, or a cruise at the speed limit in its stead. All motions
of that kind are a family with one parameter, the speed at the switch, and the shortest
of them that covers the distance is the optimum.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array

# Relative rounding that is granted in favour of a shorter time.
ROUNDING = 1e-9
# Where a goal is only just reached, it counts as reached this far off [rad or m], and
# with this share of the way.
OFF = 1e-3
SHARE = 5e-3
# Halvings of the interval of speeds at the switch.
HALVINGS = 100
# Speeds are looked for up to this many times those that would do without friction.
FASTER = 4.0
# Accelerations that change by less than this share are integrated as if they were
# straight, as the logarithm loses digits.
STRAIGHT = 1e-3


@dataclass(frozen=True, eq=False)
class AccelerationLimit:
    """Bound on an acceleration, piecewise linear in the speed.

    Attributes:
        v: Speeds between which it is linear, increasing, infinite ones left out, shape
            (k,). Beyond both ends it goes on straight.
        below: Acceleration at each speed coming from lower ones, shape (k,).
        above: Acceleration at each speed coming from higher ones, shape (k,); where dry
            friction jumps it differs.
        slopes: Slopes before the first speed and after the last one.
    """

    v: Array
    below: Array
    above: Array
    slopes: tuple[float, float]

    @classmethod
    def of(
        cls,
        sides: Callable[[float, float], float],
        speeds: Array,
    ) -> AccelerationLimit:
        """Take a function that is linear between some speeds.

        Args:
            sides: Acceleration at a speed, on the side of a sign.
            speeds: Speeds at which its slope changes, or it jumps, shape (k,).
        """
        v = np.unique(np.append(speeds, 0.0))
        below = np.array([sides(x, -1.0) for x in v])
        above = np.array([sides(x, 1.0) for x in v])
        first = below[0] - sides(v[0] - 1.0, -1.0)
        last = sides(v[-1] + 1.0, 1.0) - above[-1]
        return cls(v, below, above, (float(first), float(last)))

    def change(self, start: float, end: float) -> tuple[float, float]:
        """Time and way of changing the speed at this acceleration.

        Args:
            start: Speed at first.
            end: Speed at last; above ``start`` if the acceleration is positive.

        Returns:
            Both infinite where the acceleration does not lead there.
        """
        side = 1.0 if end >= start else -1.0
        knots = self.v[(self.v > min(start, end)) & (self.v < max(start, end))]
        speeds = np.concatenate([[start], knots[:: int(side)], [end]])
        time = way = 0.0
        for a, b in zip(speeds[:-1].tolist(), speeds[1:].tolist(), strict=True):
            if a == b:
                continue
            rates = self._at(a, side), self._at(b, -side)
            if min(side * rates[0], side * rates[1]) <= 0.0:
                return math.inf, math.inf
            piece = _linear_change(a, b, *rates)
            time, way = time + piece[0], way + piece[1]
        return time, way

    def _at(self, v: float, side: float) -> float:
        if v < self.v[0] or (v == self.v[0] and side < 0.0):
            return float(self.below[0] + (v - self.v[0]) * self.slopes[0])
        if v > self.v[-1] or (v == self.v[-1] and side > 0.0):
            return float(self.above[-1] + (v - self.v[-1]) * self.slopes[1])
        k = int(np.searchsorted(self.v, v, "right" if side > 0.0 else "left")) - 1
        share = (v - self.v[k]) / (self.v[k + 1] - self.v[k])
        return float(self.above[k] + share * (self.below[k + 1] - self.above[k]))

    def forwards(self, v: Array) -> Array:
        """Accelerations at speeds >= 0, at zero those of going forwards, shape (k,)."""
        beyond = self.slopes[1] * np.maximum(v - self.v[-1], 0.0)
        known = self.v >= 0.0
        return np.asarray(np.interp(v, self.v[known], self.above[known]) + beyond)

    def mirrored(self) -> AccelerationLimit:
        """The bound on the opposite acceleration, in the mirror."""
        v, below, above = (-part[::-1] for part in (self.v, self.above, self.below))
        return AccelerationLimit(v, below, above, (self.slopes[1], self.slopes[0]))


def _linear_change(a: float, b: float, at_a: float, at_b: float) -> tuple[float, float]:
    """Time and way between two speeds if the acceleration is linear between them."""
    dv, change = b - a, at_b - at_a
    if abs(change) < STRAIGHT * abs(at_a):
        # Simpson's rule of 1 / a and v / a, exact to the fourth power of the change.
        middle = 0.5 * (at_a + at_b)
        weights = (dv / 6.0 / at_a, dv / 1.5 / middle, dv / 6.0 / at_b)
        way = weights[0] * a + weights[1] * 0.5 * (a + b) + weights[2] * b
        return sum(weights), way
    slope = change / dv
    time = math.log(at_b / at_a) / slope
    # With v = a0 + (rate - rate0) / slope the integral of v over the time is this.
    return time, a * time + (dv - at_a * time) / slope


def least_time_of_changes(
    way: float,
    ends: Array,
    fastest: AccelerationLimit,
    slowest: AccelerationLimit,
    top: float,
) -> float:
    """Minimum time of a joint whose acceleration is bounded by its speed.

    Args:
        way: Distance to go, with its sign.
        ends: Velocities at start and end, shape (2,).
        fastest: Upper bound on the acceleration.
        slowest: Lower bound on it.
        top: Speed limit, possibly infinite.

    Returns:
        The time [s]; infinite if it cannot get there.
    """
    v0, v1 = float(ends[0]), float(ends[1])
    best = min(
        _over_a_peak(way, v0, v1, fastest, slowest, top),
        _over_a_peak(-way, -v0, -v1, slowest.mirrored(), fastest.mirrored(), top),
    )
    return best * (1.0 - ROUNDING)


def _over_a_peak(
    way: float,
    v0: float,
    v1: float,
    fastest: AccelerationLimit,
    slowest: AccelerationLimit,
    top: float,
) -> float:
    """Time of speeding up from v0 to a peak and slowing down to v1."""

    def covered(peak: float) -> tuple[float, float]:
        up, down = fastest.change(v0, peak), slowest.change(peak, v1)
        return up[0] + down[0], up[1] + down[1]

    low = max(v0, v1)
    if low > top * (1.0 + ROUNDING):
        return math.inf
    if low < 0.0:
        # Up to a peak that is still backwards the way shrinks with it.
        time, far = covered(low)
        if math.isfinite(time) and far <= way <= far + OFF + SHARE * abs(far):
            return time
        if math.isfinite(time) and far > way:
            if covered(0.0)[1] > way + OFF + SHARE * abs(way):
                return math.inf
            return _where(covered, low, 0.0, way, -1.0)
        low = 0.0
    time, near = covered(low)
    if not math.isfinite(time):
        return math.inf
    if near > way:
        return time if near - way <= OFF + SHARE * abs(near) else math.inf
    high = min(top, FASTER * max(low, 1.0))
    while high < top and covered(high)[1] < way:
        high = min(FASTER * high, top)
    time, far = covered(high)
    if math.isfinite(far) and far < way:
        return time + (way - far) / high if high > 0.0 else math.inf
    return _where(covered, low, high, way, 1.0)


def _where(
    covered: Callable[[float], tuple[float, float]],
    low: float,
    high: float,
    way: float,
    growth: float,
) -> float:
    """Time at the peak where the way is what it is to be, no later."""
    time = covered(low)[0]
    for _ in range(HALVINGS):
        peak = 0.5 * (low + high)
        found, far = covered(peak)
        if growth * (far - way) < 0.0:
            low, time = peak, found
        else:
            high = peak
    # A terminal speed takes for ever to reach: the rest of the way is at that speed.
    missing = growth * (way - covered(low)[1])
    return time + (missing / abs(low) if low > 0.0 and missing > 0.0 else 0.0)
