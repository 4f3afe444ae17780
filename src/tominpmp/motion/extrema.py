"""Interior extrema: instants between nodes at which values are least or largest.

The values are tables of samples, one row an instant, or functions of time. A proof that
no extremum of the distances is missed between samples is in
:mod:`tominpmp.verification.closest_approach`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray

# Instants at which a function is sampled between two times, and the number of rounds,
# each around the least sample of the round before.
PLACES, ROUNDS = 9, 4


def least_between(
    look: Callable[[Array], Array], low: float, high: float
) -> tuple[float, float]:
    """Instant between two times at which a function is least, and its value there.

    Args:
        look: Values at times [s], both of shape (m,).
        low: The earlier time [s].
        high: The later time [s].
    """
    for _ in range(ROUNDS):
        times = np.linspace(low, high, PLACES)
        values = look(times)
        k = int(np.argmin(values))
        low, high = times[max(k - 1, 0)], times[min(k + 1, PLACES - 1)]
    return float(times[k]), float(values[k])


def rising_then_falling(
    rate: Callable[[Array], Array], begin: Array, end: Array, halvings: int
) -> tuple[Array, Array]:
    """Times between which values stop to rise, of many values at once, by bisection.

    Args:
        rate: Rates of the values at a time each, both of shape (m,).
        begin: Times before [s], shape (m,).
        end: Times after, shape (m,).
        halvings: Number of halvings of the time between.
    """
    for _ in range(halvings):
        middle = 0.5 * (begin + end)
        rises = rate(middle) > 0.0
        begin, end = np.where(rises, middle, begin), np.where(rises, end, middle)
    return begin, end


def local_maxima(table: Array) -> BoolArray:
    """Whether values are not smaller than before, and larger than after.

    Args:
        table: Values, one row an instant, shape (m, p); minus infinity where unknown.
    """
    padded = np.pad(table, ((1, 1), (0, 0)), constant_values=-np.inf)
    known = table > -np.inf
    return np.asarray(known & (table >= padded[:-2]) & (table > padded[2:]))


def interior_maxima(values: Array, least: float, more: float) -> BoolArray:
    """Whether values are the largest inside an interval, above those at its ends.

    Args:
        values: Values at instants of intervals, the first and the last of which are
            both ends, shape (N, s, p).
        least: Values that are not above this do not count.
        more: Least difference of a maximum to the values at the ends.

    Returns:
        Shape (N, s, p); one instant of an interval and value at most.
    """
    inside = values[:, 1:-1]
    peak, place = np.max(inside, axis=1), np.argmax(inside, axis=1)
    ends = np.maximum(values[:, 0], values[:, -1])
    found = np.zeros(values.shape, dtype=bool)
    interval, column = np.nonzero((peak > least) & (peak > ends + more))
    found[interval, 1 + place[interval, column], column] = True
    return found


def between_samples(missing: Array, tolerance: float, close: float) -> IntArray:
    """Instants around which a violation may exceed a tolerance between the samples.

    Args:
        missing: Violations by instant and value, in the order of time, shape
            (m, count).
        tolerance: Tolerated violation.
        close: Values below minus this are upper bounds, and ignored.

    Returns:
        Indices of the instants.
    """
    # Tables may be large, and most pairs are far apart all the time.
    missing = missing[:, np.max(missing, axis=0, initial=-np.inf) > -close]
    step = np.diff(missing, axis=0)
    np.abs(step, out=step)
    change = np.zeros_like(missing)
    change[1:] = step
    np.maximum(change[:-1], step, out=change[:-1])
    # Half a step away the value has risen by half of the step, if it rises evenly.
    change *= 0.5
    change += missing
    exceeding = change > tolerance
    exceeding &= missing > -close
    return np.flatnonzero(np.any(exceeding, axis=1))
