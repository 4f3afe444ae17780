"""Bang-bang times: the least for a coordinate of bounded speed and acceleration."""

from __future__ import annotations

import math

from tominpmp.arrays import Array

# Relative rounding that is granted in favour of a shorter time.
ROUNDING = 1e-9
# Products of friction and time below this are as good as none; bounds without friction
# are no less.
SMALL = 1e-6


def double_integrator_time(
    way: float, ends: Array, acceleration: tuple[float, float], top: float
) -> float:
    """Minimum time of a double integrator.

    Args:
        way: Distance to go, with its sign.
        ends: Velocities at start and end, shape (2,).
        acceleration: Largest acceleration and largest deceleration.
        top: Speed limit, possibly infinite.

    Returns:
        The time [s]; infinite if it cannot get there.
    """
    v0, v1 = float(ends[0]), float(ends[1])
    up, down = acceleration
    if up + down <= 0.0:
        return 0.0 if way == 0.0 and v0 == v1 else math.inf
    # Velocity first above both ends, or, mirrored, first below both.
    best = min(
        _peak_time(float(way), v0, v1, up, down, top),
        _peak_time(-float(way), -v0, -v1, down, up, top),
    )
    return best * (1.0 - ROUNDING)


def _peak_time(
    way: float, v0: float, v1: float, up: float, down: float, top: float
) -> float:
    """Time of speeding up to a peak and braking; infinite where that cannot be."""
    highest = max(v0, v1)
    if up <= 0.0 or down <= 0.0:
        return math.inf

    # Speeding up from v0 and braking to v1 around the peak p covers
    # (p^2 - v0^2) / 2 up + (p^2 - v1^2) / 2 down.
    def covered(peak: float) -> float:
        return (peak**2 - v0**2) / (2.0 * up) + (peak**2 - v1**2) / (2.0 * down)

    slack = ROUNDING * (abs(way) + abs(covered(0.0)))
    if way < covered(highest) - slack:
        return math.inf
    square = (way - covered(0.0)) / (0.5 / up + 0.5 / down)
    peak = max(math.sqrt(max(square, 0.0)), highest)
    if peak == highest < 0.0:
        # Already past by the slack: nothing but the change of velocity is sure.
        return abs(v1 - v0) / (up if v1 > v0 else down)
    cruise = 0.0
    if peak > top:
        peak = max(top, highest)
        cruise = max(way - covered(peak), 0.0) / max(peak, 1e-300)
    return (peak - v0) / up + (peak - v1) / down + cruise


def least_time(
    distance: float,
    ends: Array,
    up: float,
    down: float,
    drag: float,
    top: float,
    *,
    least_drag: float = 0.0,
) -> float:
    r"""Time below which a distance cannot be covered.

    The speed is bounded by the solution of :math:`\dot v = a - k v` from the start on,
    with the least friction there is, by that of :math:`\dot v = a + k v` backwards from
    the end, with the most, as friction helps to brake, and by the speed limit; the
    integral of the smallest of the three is at least the distance.

    Args:
        distance: Distance to cover, >= 0.
        ends: Bounds on the speed at start and end, shape (2,), >= 0.
        up: Bound on the acceleration a, > 0.
        down: Bound on the deceleration, > 0.
        drag: Largest friction over inertia, k >= 0 [1/s].
        top: Speed limit, possibly infinite.
        least_drag: Smallest friction over inertia [1/s].

    Returns:
        The time [s].
    """

    def far(T: float) -> float:
        return covered(T, ends, (up, least_drag), (down, drag), top)

    low, high = 0.0, 1.0
    while far(high) < distance:
        low, high = high, 2.0 * high
        if high > 1e9:
            return low
    for _ in range(60):
        T = 0.5 * (low + high)
        if far(T) < distance:
            low = T
        else:
            high = T
    return low * (1.0 - ROUNDING)


def covered(
    T: float,
    ends: Array,
    speeding: tuple[float, float],
    braking: tuple[float, float],
    top: float,
) -> float:
    """Bound on the distance that can be covered in a time.

    Args:
        T: The time.
        ends: Bounds on the speed at start and end, shape (2,), possibly infinite.
        speeding: Acceleration, and the least friction over inertia.
        braking: Deceleration, and the largest friction over inertia.
        top: Speed limit, possibly infinite.
    """
    v0, v1 = float(ends[0]), float(ends[1])
    first, last = 0.0, T
    # Wherever the one bound is exchanged for the other, the sum of the integrals is a
    # bound; it is least where they meet.
    for _ in range(50):
        s = 0.5 * (first + last)
        if _sped(s, v0, *speeding) < _braked(T - s, v1, *braking):
            first = s
        else:
            last = s
    s = 0.5 * (first + last)
    return _speeding_way(s, v0, *speeding, top) + _stopped(T - s, v1, *braking, top)


def _sped(t: float, v: float, up: float, drag: float) -> float:
    """Largest speed that is reached from v in a time."""
    if drag * t < SMALL:
        return v + up * t
    limit = up / drag
    return limit + (v - limit) * math.exp(-drag * t)


def _speeding_way(t: float, v: float, up: float, drag: float, top: float) -> float:
    """Distance covered in a time while speeding up from v."""
    if _sped(t, v, up, drag) > top:
        free = max(top - v, 0.0) / up
        if drag * t >= SMALL:
            limit = up / drag
            free = math.log(max((limit - v) / (limit - top), 1.0)) / drag
        free = min(free, t)
        return _speeding_way(free, v, up, drag, math.inf) + (t - free) * top
    if drag * t < SMALL:
        return t * (v + 0.5 * up * t)
    limit = up / drag
    return limit * t - (v - limit) * math.expm1(-drag * t) / drag


def _braked(t: float, v: float, down: float, drag: float) -> float:
    """Largest speed from which v is reached in a time."""
    if drag * t < SMALL:
        # The second order is left in, so that this is no less than the bound.
        return (v + down * t) * (1.0 + 2.0 * drag * t)
    if drag * t > 600.0:
        return math.inf
    growth = math.exp(drag * t)
    return v * growth + down * (growth - 1.0) / drag


def _stopped(t: float, v: float, down: float, drag: float, top: float) -> float:
    """Distance covered in a time before v is reached by braking."""
    if _braked(t, v, down, drag) <= top:
        return _braking_way(t, v, down, drag)
    first, last = 0.0, t
    for _ in range(50):
        s = 0.5 * (first + last)
        first, last = (s, last) if _braked(s, v, down, drag) < top else (first, s)
    return _braking_way(first, v, down, drag) + (t - first) * top


def _braking_way(t: float, v: float, down: float, drag: float) -> float:
    if drag * t < SMALL:
        return t * (v + 0.5 * down * t) * (1.0 + 2.0 * drag * t)
    if drag * t > 600.0:
        return math.inf
    growth = math.expm1(drag * t) / drag
    return v * growth + down * (growth - t) / drag
