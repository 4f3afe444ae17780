"""Damped least squares within bounds, for many configurations at once.

Each step is the shortest one that leads to a root to first order, damped where the arm
is singular or the root is far (Sugihara, 2011). Joints at a bound that the step would
cross are held, so that the other joints make up for them.
``scipy.optimize.least_squares`` takes one configuration at a time, and does not seek
the shortest step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.stopping import check

# Residuals at configurations, shape (m, n), of the rows with the given indices, shape
# (m,): values, shape (m, k), and their Jacobians, shape (m, k, n). Rows with fewer than
# k residuals are padded with zeros.
Residual = Callable[[Array, IntArray], tuple[Array, Array]]

# Damping relative to the mean diagonal of the normal equations: it equals the squared
# residual, but no more than the first number, plus the second one, which keeps the
# equations regular.
MAX_DAMPING, MIN_DAMPING = 1e-2, 1e-10
# Usual limits: most steps from a start, and the longest step of a joint [rad, or shares
# of the length that counts as 1 rad].
STEPS, LONGEST_STEP = 60, 0.5
# Number of steps after which a row is given up if they have not halved its residual;
# otherwise rows that make no progress would take most of the time.
PATIENCE = 12
# Distance by which a step must cross a bound for the joint to be held there [rad or m].
CROSSING = 1e-12


def padded(rows: Iterable[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Stack residuals of several lengths, padded with zeros.

    Args:
        rows: Residuals of each row, shape (k,), and their Jacobian, shape (k, n); k may
            vary.

    Returns:
        Residuals, shape (m, k), and their Jacobians, shape (m, k, n).
    """
    values, slopes = zip(*rows, strict=True)
    shape = len(values), max(map(len, values))
    value, slope = np.zeros(shape), np.zeros((*shape, slopes[0].shape[1]))
    for row, (one, by_q) in enumerate(zip(values, slopes, strict=True)):
        value[row, : len(one)], slope[row, : len(one)] = one, by_q
    return value, slope


def least_squares(
    residual: Residual,
    q: Array,
    limits: tuple[Array, Array],
    scale: Array,
    longest: Array,
    *,
    reached: float,
    steps: int = STEPS,
) -> tuple[Array, Array]:
    """Drive residuals to zero within bounds by a damped Gauss-Newton iteration.

    Args:
        residual: The residuals and their Jacobians.
        q: Initial configurations, shape (m, n) [rad or m].
        limits: Lower and upper bounds, shape (n,) each.
        scale: Displacements of the joints that count as equally long, shape (n,) or (m,
            n): among the steps with the same effect, the shortest in this norm is
            taken.
        longest: Longest step of each joint, shape (n,) or (m, n) [rad or m].
        reached: Norm of a residual below which its row has converged.
        steps: Largest number of steps.

    Returns:
        Configurations, shape (m, n), and the norms of their residuals, shape (m,).
    """
    low, high = limits
    out = np.clip(q, low, high)
    scale, longest = np.broadcast_to(scale, q.shape), np.broadcast_to(longest, q.shape)
    rows: IntArray = np.arange(len(q))
    value, slope = residual(out, rows)
    error = (value * value).sum(axis=1)
    earlier = error.copy()
    for number in range(steps):
        check()
        active = error[rows] >= reached**2
        if number % PATIENCE == PATIENCE - 1:
            active &= error[rows] < 0.25 * earlier[rows]
            earlier = error.copy()
        if not active.all():
            rows, value, slope = rows[active], value[active], slope[active]
            if not rows.size:
                break
        current, units = out[rows], scale[rows]
        damping = np.minimum(MAX_DAMPING, error[rows])
        step = damped_step(value, slope, units, damping)
        target = current + step
        at_bound = np.where(step < 0.0, current <= low, current >= high)
        held = at_bound & (np.clip(target, low - CROSSING, high + CROSSING) != target)
        if held.any():
            step = damped_step(value, slope, units * ~held, damping)
        excess = (np.abs(step) / longest[rows]).max(axis=1, keepdims=True)
        current = np.clip(current + step / np.maximum(excess, 1.0), low, high)
        value, slope = residual(current, rows)
        out[rows], error[rows] = current, (value * value).sum(axis=1)
    return out, np.sqrt(error)


def damped_step(value: Array, slope: Array, scale: Array, damping: Array) -> Array:
    """Damped Gauss-Newton steps of least norm.

    Args:
        value: Residuals, shape (m, k).
        slope: Jacobians, shape (m, k, n).
        scale: Displacements of the joints that count as equally long, shape (m, n);
            zero for joints that are held.
        damping: Damping relative to the mean diagonal of the equations, shape (m,).

    Returns:
        Steps, shape (m, n).
    """
    scaled = slope * scale[:, None]
    turned = scaled.swapaxes(1, 2)
    normal = scaled @ turned
    diagonal = np.arange(value.shape[1])
    size = normal[:, diagonal, diagonal].mean(axis=1)
    # If all joints are held, any positive damping keeps the equations regular.
    damping = np.where(size > 0.0, (damping + MIN_DAMPING) * size, 1.0)
    normal[:, diagonal, diagonal] += damping[:, None]
    step = turned @ np.linalg.solve(normal, value[:, :, None])
    return np.asarray(-scale * step[:, :, 0])
