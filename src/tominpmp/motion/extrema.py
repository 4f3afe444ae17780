"""Interior extrema: instants between nodes at which values are least or largest.

The values are tables of samples, with a row for each instant, or functions of time. A
proof that no extremum of the distances is missed between samples is in
:mod:`tominpmp.verification.closest_approach`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray

# Number of instants at which a function is sampled between two times, and number of
# rounds, each of them around the least sample of the round before.
PLACES, ROUNDS = 9, 4


def least_between(
    function: Callable[[Array], Array], low: float, high: float
) -> tuple[float, float]:
    """Instant between two times at which a function is least, and its value there.

    The instant is found by sampling around the least sample again and again: of several
    local minima it may miss the least.

    Args:
        function: Function from times [s] to values, both of shape (m,).
        low: The earlier time [s].
        high: The later time [s].
    """
    for _ in range(ROUNDS):
        times = np.linspace(low, high, PLACES)
        values = function(times)
        k = int(np.argmin(values))
        low, high = times[max(k - 1, 0)], times[min(k + 1, PLACES - 1)]
    return float(times[k]), float(values[k])


def local_maxima(table: Array) -> BoolArray:
    """Whether each value is a local maximum of its column; of equal values the last.

    Args:
        table: Values with a row for each instant, shape (m, p); minus infinity where a
            value is unknown.
    """
    padded = np.pad(table, ((1, 1), (0, 0)), constant_values=-np.inf)
    known = table > -np.inf
    return np.asarray(known & (table >= padded[:-2]) & (table > padded[2:]))


def interior_maxima(values: Array, least: float, more: float) -> BoolArray:
    """Whether each value is the maximum inside its interval, and above both ends.

    Args:
        values: Values at instants of intervals, both ends of the intervals included,
            shape (N, s, p).
        least: Value that a maximum has to exceed.
        more: Least difference between a maximum and the values at both ends.

    Returns:
        Shape (N, s, p); True at no more than one instant of each interval and column.
    """
    inside = values[:, 1:-1]
    peak, place = np.max(inside, axis=1), np.argmax(inside, axis=1)
    ends = np.maximum(values[:, 0], values[:, -1])
    maxima = np.zeros(values.shape, dtype=bool)
    interval, column = np.nonzero((peak > least) & (peak > ends + more))
    maxima[interval, 1 + place[interval, column], column] = True
    return maxima


def between_samples(missing: Array, tolerance: float, close: float) -> IntArray:
    """Instants around which a violation may exceed a tolerance between the samples.

    Args:
        missing: Violations, with a row for each instant in the order of time, shape (m,
            count).
        tolerance: Tolerated violation.
        close: Slack beyond which values are only bounds: the largest rise within half a
            step.

    Returns:
        Indices of the instants.
    """
    # Tables may be large, and most pairs are far apart at all times.
    missing = missing[:, np.max(missing, axis=0, initial=-np.inf) > -close]
    near = missing > -close
    # A bound may be far above its value: from there a value may rise by a whole step.
    step = np.diff(np.where(near, missing, -3.0 * close), axis=0)
    np.abs(step, out=step)
    change = np.zeros_like(missing)
    change[1:] = step
    np.maximum(change[:-1], step, out=change[:-1])
    # Half a step away a value that rises evenly has risen by half of its change.
    change *= 0.5
    change += missing
    return np.flatnonzero(np.any((change > tolerance) & near, axis=1))
