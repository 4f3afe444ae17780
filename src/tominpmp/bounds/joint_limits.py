"""Least times of single joints with limits of speed, acceleration and jerk."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.bang_bang import double_integrator_time
from tominpmp.problem import Problem

# Halvings of intervals of peaks and of times.
HALVINGS = 60
# Relative rounding that is granted in favour of a shorter time.
ROUNDING = 1e-9
# Longest time looked at [s].
LONGEST = 1e6


def jerk_limited_time(
    way: float,
    ends: Array,
    top: float,
    accelerations: tuple[float, float],
    jerk: float,
) -> float:
    """Minimum time of a joint that begins and ends without acceleration.

    Args:
        way: Distance to go, with its sign.
        ends: Velocities at start and end, shape (2,).
        top: Speed limit, possibly infinite.
        accelerations: Largest acceleration and largest deceleration, possibly infinite.
        jerk: Jerk limit, possibly infinite.

    Returns:
        The time [s]; a bound below it where an end moves backwards, or too fast.
    """
    side = 1.0 if way >= 0.0 else -1.0
    v0, v1 = float(side * ends[0]), float(side * ends[1])
    loose = abs(way) / top
    if math.isfinite(sum(accelerations)):
        loose = double_integrator_time(way, ends, accelerations, top)
    if not math.isfinite(jerk) or v0 < 0.0 or v1 < 0.0:
        return loose
    up, down = accelerations if side > 0.0 else accelerations[::-1]
    if min(up, down) <= 0.0:
        return loose

    def covered_by(peak: float) -> tuple[float, float]:
        first, last = (
            _change_time(peak - v0, up, jerk),
            _change_time(peak - v1, down, jerk),
        )
        far = 0.5 * (v0 + peak) * first + 0.5 * (v1 + peak) * last
        return first + last, far

    low, distance = max(v0, v1), abs(way)
    if covered_by(low)[1] > distance:
        return loose
    high = max(2.0 * low, 1e-9)
    while high < top and covered_by(high)[1] < distance:
        high *= 2.0
    high = min(high, top)
    time, far = covered_by(high)
    if far < distance:
        return max(loose, (time + (distance - far) / high) * (1.0 - ROUNDING))
    for _ in range(HALVINGS):
        peak = 0.5 * (low + high)
        low, high = (peak, high) if covered_by(peak)[1] < distance else (low, peak)
    return max(loose, covered_by(low)[0] * (1.0 - ROUNDING))


def _change_time(change: float, acceleration: float, jerk: float) -> float:
    """Least time of changing the speed from one constant speed to another."""
    if math.isfinite(acceleration) and change >= acceleration**2 / jerk:
        return change / acceleration + acceleration / jerk
    return 2.0 * math.sqrt(change / jerk)


@dataclass(frozen=True, eq=False)
class JointReach:
    """How far each joint gets in a time, whatever moves it.

    Attributes:
        top: Speed limits, shape (n,).
        acceleration: Acceleration limits, shape (n,).
        jerk: Jerk limits, shape (n,).
        start: Speeds at the start, shape (n,).
        ends_at_rest: Whether it ends at rest.
    """

    top: Array
    acceleration: Array
    jerk: Array
    start: Array
    ends_at_rest: bool

    @classmethod
    def of(
        cls,
        problem: Problem,
        start: Array | None,
        ends_at_rest: bool,
        smooth_ends: bool = True,
    ) -> JointReach:
        """Take the limits of a problem.

        Args:
            problem: The problem.
            start: Velocities at the start, shape (n,); None if they may be any.
            ends_at_rest: Whether it ends at rest.
            smooth_ends: Whether accelerations that may not jump are zero at both ends.
        """
        n, names = problem.robot.n, problem.robot.joint_names
        most, jerk = np.full(n, np.inf), np.full(n, np.inf)
        if problem.motion_limits is not None:
            more = problem.motion_limits
            most, jerk = (more.by_joint(k, names) for k in ("acceleration", "jerk"))
        if not smooth_ends:
            jerk = np.full(n, np.inf)
        speed = np.full(n, np.inf) if start is None else np.abs(start)
        top = problem.robot.limits.velocity
        return cls(top, most, jerk, speed, ends_at_rest)

    def __call__(self, T: float) -> Array:
        """Farthest that each joint gets in a time, shape (n,)."""
        rows = zip(self.top, self.acceleration, self.jerk, self.start, strict=True)
        return np.array([self._farthest(T, *row) for row in rows])

    def _farthest(
        self, T: float, top: float, acceleration: float, jerk: float, start: float
    ) -> float:
        far = top * T
        end = 0.0 if self.ends_at_rest else math.inf
        if math.isfinite(acceleration):
            far = min(far, _bang_bang_way(T, start, end, acceleration, top))
        if math.isfinite(jerk) and start == 0.0 and self.ends_at_rest:
            far = min(far, _rest_to_rest(T, top, acceleration, jerk))
        return far

    def time(self, ways: Array) -> tuple[float, int]:
        """Time before which some joint has not gone as far as it has to.

        Args:
            ways: How far the joints have to go at least, shape (n,).

        Returns:
            The time, and the joint.
        """
        best, joint = 0.0, 0
        rows = zip(self.top, self.acceleration, self.jerk, self.start, strict=True)
        for i, row in enumerate(rows):
            way = float(ways[i])
            if way <= 0.0 or self._farthest(max(best, 1e-12), *row) >= way:
                continue
            low, high = best, max(2.0 * best, 1e-3)
            while self._farthest(high, *row) < way and high < LONGEST:
                low, high = high, 2.0 * high
            for _ in range(HALVINGS):
                T = 0.5 * (low + high)
                low, high = (T, high) if self._farthest(T, *row) < way else (low, T)
            best, joint = low, i
        return best, joint


def _bang_bang_way(
    T: float, start: float, end: float, acceleration: float, top: float
) -> float:
    """Farthest with bounds on the speeds at start and end, possibly infinite."""
    if math.isinf(start) and math.isinf(end):
        return top * T
    switch = 0.0 if math.isinf(start) else T
    if math.isfinite(start) and math.isfinite(end):
        switch = 0.5 * (T + (end - start) / acceleration)
        switch = min(max(switch, 0.0), T)
    first = _ramp(switch, start, acceleration, top) if switch > 0.0 else 0.0
    last = _ramp(T - switch, end, acceleration, top) if switch < T else 0.0
    return first + last


def _ramp(t: float, v: float, acceleration: float, top: float) -> float:
    """Way while speeding up from v to the speed limit."""
    if v >= top:
        return top * t
    free = min((top - v) / acceleration, t)
    rest = (t - free) * top if t > free else 0.0
    return free * (v + 0.5 * acceleration * free) + rest


def _rest_to_rest(T: float, top: float, acceleration: float, jerk: float) -> float:
    """Farthest from rest to rest without acceleration at either end."""
    half = 0.5 * T
    peak = jerk * (0.5 * half) ** 2
    if math.isfinite(acceleration) and half >= 2.0 * acceleration / jerk:
        peak = acceleration * (half - acceleration / jerk)
    if peak <= top:
        return peak * half
    return top * (T - _change_time(top, acceleration, jerk))
