"""Interior extrema: where between its nodes something of a motion is least or largest.

What is looked at are tables of samples, one row an instant, or functions of time. That
nothing is missed between the samples of distances is proved by
:mod:`tominpmp.verification.closest_approach`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray

# Instants at which a function is looked at between two times, and how often again
# around the least of them.
PLACES, ROUNDS = 9, 4


def least_between(
    look: Callable[[Array], Array], low: float, high: float
) -> tuple[float, float]:
    """Where a function is least between two times, and its value there.

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


def local_maxima(table: Array) -> BoolArray:
    """Where values are not smaller than before, and larger than after.

    Args:
        table: Values, one row an instant, shape (m, p); minus infinity where unknown.
    """
    padded = np.pad(table, ((1, 1), (0, 0)), constant_values=-np.inf)
    known = table > -np.inf
    return np.asarray(known & (table >= padded[:-2]) & (table > padded[2:]))


def between_samples(missing: Array, tolerance: float, close: float) -> IntArray:
    """Instants around which what is missing may pass a tolerance between the samples.

    Args:
        missing: By instant and value, in the order of time, shape (m, count).
        tolerance: What is let pass.
        close: Values below minus this are upper bounds, and not looked at.

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
    # Half a step away it has risen by half of that at the most, if evenly.
    change *= 0.5
    change += missing
    exceeding = change > tolerance
    exceeding &= missing > -close
    return np.flatnonzero(np.any(exceeding, axis=1))
