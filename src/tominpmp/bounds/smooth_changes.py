r"""Least time of one joint whose acceleration may not jump.

Gravity acts on it alike wherever it is: speed and acceleration are all there is.
Between two speeds, at both of which it does not accelerate, a joint has no larger
acceleration than the limits allow at its speed, than their rates make of what they
allow at lower speeds, and than those can take away until a higher one. A motion of
duration T that is never faster than p covers no more than
:math:`\int_0^p (T - t_1(v) - t_2(v)) dv`, where :math:`t_1` is the least time until it
is faster than v, and :math:`t_2` the same before its end. All times are enclosed from
below, not approximated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.speed_changes import ROUNDING, AccelerationLimit

# Steps of a change of speed, and halvings of the interval of highest speeds.
STEPS, HALVINGS = 600, 45
# Halvings that find an acceleration, and how near one is looked at that is never had.
INVERSIONS, NEARLY = 30, 1.0 - 1e-9
# Where friction changes a rate by less than this share, a series has more digits.
SERIES = 1e-4


@dataclass(frozen=True)
class Rate:
    """How fast an acceleration may grow, or shrink, by its magnitude.

    Attributes:
        jerk: Jerk limit, possibly infinite.
        effort_rate: Limit of the torque rate over the inertia, possibly infinite.
        drag: Viscous friction over the inertia [1/s], below zero where the acceleration
            grows: the torque has to follow the speed.
    """

    jerk: float
    effort_rate: float
    drag: float

    @property
    def constant(self) -> float | None:
        """The rate, if it is the same at all accelerations."""
        if self.drag == 0.0 or not math.isfinite(self.effort_rate):
            return min(self.jerk, self.effort_rate)
        return None

    @property
    def most(self) -> float:
        """Acceleration that is never reached; infinite if there is none."""
        if self.constant is not None or self.drag > 0.0:
            return math.inf
        return self.effort_rate / -self.drag

    def at(self, a: Array) -> Array:
        """Rates at accelerations >= 0."""
        if self.constant is not None:
            return np.full(np.shape(a), self.constant)
        return np.asarray(np.minimum(self.jerk, self.effort_rate + self.drag * a))

    def change(self, a: Array) -> Array:
        """By how much the speed changes between no acceleration and these, >= 0."""
        if self.constant is not None:
            return np.asarray(0.5 * a**2 / self.constant)
        a = np.minimum(a, NEARLY * self.most)
        # On one side of this acceleration the jerk is limited, on the other the torque.
        knee = np.minimum(max((self.jerk - self.effort_rate) / self.drag, 0.0), a)
        if self.drag > 0.0:
            parts = self._by_torque(knee) + 0.5 * (a**2 - knee**2) / self.jerk
        else:
            slower = self._by_torque(a) - self._by_torque(knee)
            parts = slower + 0.5 * knee**2 / self.jerk
        return np.asarray(parts)

    def _by_torque(self, a: Array) -> Array:
        """The same where the torque rate alone limits it."""
        x = self.drag * a / self.effort_rate
        series = 0.5 * a**2 / self.effort_rate * (1.0 - x * (2.0 / 3.0 - 0.5 * x))
        exact = self.effort_rate / self.drag**2 * (x - np.log1p(x))
        return np.where(np.abs(x) < SERIES, series, exact)

    def after(self, change: Array, most: float) -> Array:
        """Accelerations after a change of the speed, no less than they are.

        Args:
            change: The changes, beginning without acceleration, shape (k,).
            most: Bound on all accelerations.
        """
        if self.constant is not None:
            return np.sqrt(2.0 * self.constant * np.maximum(change, 0.0))
        low, high = np.zeros(change.shape), np.full(change.shape, most)
        for _ in range(INVERSIONS):
            a = 0.5 * (low + high)
            less = self.change(a) < change
            low, high = np.where(less, a, low), np.where(less, high, a)
        return high

    def highest(self, a: Array, most: Array) -> Array:
        """Bound on the rates from accelerations on, up to some largest ones."""
        return np.maximum(self.at(a), self.at(np.maximum(a, most)))


@dataclass(frozen=True, eq=False)
class SpeedUp:
    """Changes between two speeds at which there is no acceleration.

    Attributes:
        limit: Bound on the acceleration.
        sign: 1 for speeding up; -1 for slowing down, seen backwards.
        first: How fast the acceleration changes from the lower speed on.
        last: How fast it does before the higher one.
    """

    limit: AccelerationLimit
    sign: float
    first: Rate
    last: Rate

    def change(self, start: float, end: float) -> tuple[float, float]:
        """Bounds on the time of a change, and on its integral over the speed.

        Args:
            start: The lower speed, >= 0.
            end: The higher one.

        Returns:
            Neither is larger than it is; both infinite where there is no such change.
        """
        if end <= start:
            return 0.0, 0.0
        inner = self.limit.v[(self.limit.v > start) & (self.limit.v < end)]
        shares = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, STEPS + 1))
        v = np.union1d(start + (end - start) * shares, inner)
        top = np.minimum(self.sign * self.limit.forwards(v), self.first.most)
        if np.min(top[:-1]) <= 0.0:
            return math.inf, math.inf
        top = np.maximum(top, 0.0)
        most = float(np.max(top))
        rising = self.first.change(top)
        rising[0] = 0.0
        rising = np.minimum.accumulate(rising - v) + v
        falling = self.last.change(top)
        falling[-1] = 0.0
        falling = np.minimum.accumulate((falling + v)[::-1])[::-1] - v
        a = np.minimum(self.first.after(rising, most), self.last.after(falling, most))
        return self._summed(v, np.minimum(a, top), top)

    def _summed(self, v: Array, a: Array, top: Array) -> tuple[float, float]:
        """Time and its integral, given bounds on the acceleration at speeds.

        Within a step the acceleration is below the line between the limits at its ends,
        and below what can be made of it from either end on.
        """
        h, most = np.diff(v), np.maximum(top[1:], top[:-1])
        for _ in range(2):  # rates are those of what the first look leaves
            up = np.sqrt(a[:-1] ** 2 + 2.0 * h * self.first.highest(a[:-1], most))
            down = np.sqrt(a[1:] ** 2 + 2.0 * h * self.last.highest(a[1:], most))
            most = np.minimum(np.minimum(up, down), most)
        sums = np.minimum(a[:-1] + up, a[1:] + down)
        steps = 2.0 * h / np.minimum(sums, top[1:] + top[:-1])
        before = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
        area = np.sum(h * (before + 0.5 * h / most))
        return float(np.sum(steps)), float(area)


def least_time_of_smooth_changes(
    way: float,
    ends: Array,
    limits: tuple[AccelerationLimit, AccelerationLimit],
    top: float,
    rates: tuple[float, float, float],
) -> float:
    """Time that no motion without jumps of the acceleration can beat.

    Args:
        way: Distance to go, with its sign.
        ends: Velocities at start and end, shape (2,), where it does not accelerate.
        limits: Upper and lower bound on the acceleration.
        top: Speed limit, possibly infinite.
        rates: Jerk limit, limit of the torque rate over the inertia, both possibly
            infinite, and viscous friction over the inertia.

    Returns:
        The time [s]; 0 where an end moves backwards, or it has to overshoot.
    """
    if way < 0.0:
        way, ends = -way, -ends
        limits = limits[1].mirrored(), limits[0].mirrored()
    v0, v1 = float(ends[0]), float(ends[1])
    if min(v0, v1) < 0.0 or max(v0, v1) > top:
        return 0.0
    growing = Rate(rates[0], rates[1], -rates[2])
    shrinking = Rate(*rates)
    first = SpeedUp(limits[0], 1.0, growing, shrinking)
    last = SpeedUp(limits[1], -1.0, shrinking, growing)

    def around(peak: float) -> tuple[float, float]:
        """Time of both changes, and the way by which they fall short of the peak."""
        changes = first.change(v0, peak), last.change(v1, peak)
        return changes[0][0] + changes[1][0], changes[0][1] + changes[1][1]

    def reaches(time: float, missing: float, peak: float) -> bool:
        return not math.isfinite(time) or peak * time - missing >= way

    low, high = max(v0, v1), min(max(2.0 * max(v0, v1), way), top)
    time, missing = around(low)
    if low > 0.0 and reaches(time, missing, low):
        return 0.0
    while not reaches(*around(high), high):
        if high >= top:
            return (way + around(top)[1]) / top * (1.0 - ROUNDING)
        low, high = high, min(2.0 * high, top)
    for _ in range(HALVINGS):
        peak = 0.5 * (low + high)
        low, high = (low, peak) if reaches(*around(peak), peak) else (peak, high)
    return around(low)[0] * (1.0 - ROUNDING)
