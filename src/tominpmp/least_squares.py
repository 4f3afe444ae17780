"""Damped least squares within bounds, of many configurations at once.

Each step is the least one that leads to a root to first order, damped where the arm is
singular or the root far (Sugihara, 2011). Joints at a bound that it would lead beyond
are held, so that the others do their part. ``scipy.optimize.least_squares`` takes one
configuration at a time, and does not look for the least step.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.stopping import check

# What is to be brought to zero at configurations, shape (m, n), of rows with given
# numbers, shape (m,): values, shape (m, k), and their Jacobians, shape (m, k, n). What
# a row lacks of k values is zero.
Residual = Callable[[Array, IntArray], tuple[Array, Array]]

# Damping is the squared residual's share of the mean diagonal of a system of equations,
# but no more than the first of these shares, and at least the second, which keeps it
# regular.
MOST, LEAST = 1e-2, 1e-10
# A row is given up when this many steps have not halved its residual; most of the time
# would go into those that get nowhere.
PATIENCE = 12
# How far a step leads beyond a bound that holds the joint [rad or m].
BEYOND = 1e-12


def each(function: Callable[[int, Array], tuple[Array, Array]]) -> Residual:
    """The residual of rows of a function of one row.

    Args:
        function: Of the number of a row and its configuration, shape (n,): values,
            shape (k,), and their Jacobian, shape (k, n); k may vary.
    """

    def residual(q: Array, rows: IntArray) -> tuple[Array, Array]:
        found = [function(*row) for row in zip(rows.tolist(), q, strict=True)]
        most = max(value.size for value, _ in found)
        value, slope = np.zeros((len(q), most)), np.zeros((len(q), most, q.shape[1]))
        for row, (one, by_q) in enumerate(found):
            value[row, : one.size], slope[row, : one.size] = one, by_q
        return value, slope

    return residual


def least_squares(
    residual: Residual,
    q: Array,
    limits: tuple[Array, Array],
    scale: Array,
    longest: Array,
    *,
    reached: float,
    steps: int,
) -> tuple[Array, Array]:
    """Bring residuals to zero within bounds, each by short steps.

    Args:
        residual: What is to be brought to zero.
        q: Where to begin, shape (m, n) [rad or m].
        limits: Lower and upper bounds, shape (n,) each.
        scale: Displacements that count as much as each other, shape (n,) or (m, n): of
            the steps that do the same, the least one is taken.
        longest: Longest step of each joint, likewise [rad or m].
        reached: Norm of a residual that ends the steps of its row.
        steps: How many of them at most.

    Returns:
        Configurations, shape (m, n), and the norms of what is left there, shape (m,).
    """
    low, high = limits
    out = np.clip(q, low, high)
    scale, longest = np.broadcast_to(scale, q.shape), np.broadcast_to(longest, q.shape)
    rows: IntArray = np.arange(len(q))
    value, slope = residual(out, rows)
    error = (value * value).sum(axis=1)
    mark = error.copy()
    for number in range(steps):
        check()
        going = error[rows] >= reached**2
        if number % PATIENCE == PATIENCE - 1:
            going &= error[rows] < 0.25 * mark[rows]
            mark = error.copy()
        if not going.all():
            rows, value, slope = rows[going], value[going], slope[going]
            if not rows.size:
                break
        here, unit = out[rows], scale[rows]
        damping = np.minimum(MOST, error[rows])
        step = damped_step(value, slope, unit, damping)
        there = here + step
        held = ((here <= low) & (there < low - BEYOND)) | (
            (here >= high) & (there > high + BEYOND)
        )
        if held.any():
            step = damped_step(value, slope, unit * ~held, damping)
        far = (np.abs(step) / longest[rows]).max(axis=1, keepdims=True)
        here = np.clip(here + step / np.maximum(far, 1.0), low, high)
        value, slope = residual(here, rows)
        out[rows], error[rows] = here, (value * value).sum(axis=1)
    return out, np.sqrt(error)


def damped_step(value: Array, slope: Array, scale: Array, damping: Array) -> Array:
    """The least steps that bring values to zero to first order, damped.

    Args:
        value: Shape (m, k).
        slope: Jacobians, shape (m, k, n).
        scale: Displacements that count as much as each other, shape (m, n); zero for
            joints that stay.
        damping: Share of the mean diagonal of the system of equations, shape (m,).

    Returns:
        Steps, shape (m, n).
    """
    scaled = slope * scale[:, None]
    turned = scaled.swapaxes(1, 2)
    normal = scaled @ turned
    diagonal = np.arange(value.shape[1])
    size = normal[:, diagonal, diagonal].mean(axis=1)
    # Where all joints stay any other number than zero does.
    damping = np.where(size > 0.0, (damping + LEAST) * size, 1.0)
    normal[:, diagonal, diagonal] += damping[:, None]
    found = turned @ np.linalg.solve(normal, value[:, :, None])
    return np.asarray(-scale * found[:, :, 0])
