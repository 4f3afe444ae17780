"""Polynomials between the nodes of a motion.

They are of degree 2 where accelerations of the intervals are given, of degree 5 where
those at the nodes are, else of degree 3. SciPy's ``CubicHermiteSpline`` was measured at
1.2 times the time for positions, velocities and accelerations at 5000 instants, and has
no form for the other two.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tominpmp.arrays import Array, IntArray


def states(
    t: Array, q: Array, v: Array, a: Array | None, times: Array
) -> tuple[Array, Array, Array]:
    """Positions, velocities and accelerations.

    Args:
        t: Times of the nodes [s], increasing, shape (N + 1,).
        q: Positions there [rad or m], shape (N + 1, n).
        v: Velocities there, shape (N + 1, n).
        a: Accelerations of the intervals, shape (N, n), or at the nodes, shape
            (N + 1, n); or None.
        times: Times from the first to the last node [s], shape (m,).

    Returns:
        Shape (m, n) each; at nodes accelerations are those just afterwards.
    """
    if t.size == 1:
        t, q, v, a = _instant(t, q, v, a)
    k = np.minimum(np.searchsorted(t, times, side="right") - 1, t.size - 2)
    s, h = (times - t[k])[:, None], (t[k + 1] - t[k])[:, None]
    q0, v0 = q[k], v[k]
    if a is not None and a.shape[0] == t.size:
        return _quintic(k, s, h, (q, v, a))
    if a is not None:
        return q0 + s * v0 + 0.5 * s**2 * a[k], v0 + s * a[k], a[k]
    c2, c3 = _cubic(q0, v0, q[k + 1], v[k + 1], h)
    return (
        q0 + s * (v0 + s * (c2 + s * c3)),
        v0 + s * (2.0 * c2 + 3.0 * s * c3),
        2.0 * c2 + 6.0 * s * c3,
    )


def polynomials(t: Array, q: Array, v: Array, a: Array | None) -> Any:
    """Positions between the nodes as SciPy's ``PPoly``, NaN outside of the motion.

    Args:
        t: Times of the nodes [s], increasing, shape (N + 1,).
        q: Positions there [rad or m], shape (N + 1, n).
        v: Velocities there, shape (N + 1, n).
        a: Accelerations, as for :func:`states`.
    """
    from scipy.interpolate import PPoly

    if t.size == 1:
        t, q, v, a = _instant(t, q, v, a)
    h = np.diff(t)[:, None]
    if a is not None and a.shape[0] == t.size:
        rest = _rest(np.arange(h.size), h, (q, v, a))
        more = [0.5 * a[:-1], *(c / h**k for k, c in enumerate(rest, start=3))]
    elif a is not None:
        more = [0.5 * a]
    else:
        more = [*_cubic(q[:-1], v[:-1], q[1:], v[1:], h)]
    return PPoly(np.stack([*more[::-1], v[:-1], q[:-1]]), t, extrapolate=False)


def _instant(
    t: Array, q: Array, v: Array, a: Array | None
) -> tuple[Array, Array, Array, Array]:
    """Two nodes of a motion that has one, with the shortest interval between them."""
    still = np.zeros_like(q) if a is None or not len(a) else a
    ends = np.array([t[0], np.nextafter(t[0], np.inf)])
    return ends, np.vstack([q, q]), np.vstack([v, v]), still


def velocities(t: Array, q: Array, v: Array, a: Array | None) -> Array:
    """Velocities on the intervals, as polynomials of the share that has passed.

    Args:
        t: Times of the nodes [s], increasing, shape (N + 1,).
        q: Positions there [rad or m], shape (N + 1, n).
        v: Velocities there, shape (N + 1, n).
        a: Accelerations, as for :func:`states`.

    Returns:
        Coefficients of 1, x, x^2, ..., shape (N, n, K).
    """
    h = np.diff(t)[:, None]
    if a is not None and a.shape[0] == t.size:
        terms = [v[:-1] * h, a[:-1] * h**2]
        for power, part in enumerate(_rest(np.arange(h.size), h, (q, v, a)), start=3):
            terms.append(power * part)
        return np.stack(terms, axis=2) / h[..., None]
    if a is not None:
        return np.stack([v[:-1], a * h], axis=2)
    c2, c3 = _cubic(q[:-1], v[:-1], q[1:], v[1:], h)
    return np.stack([v[:-1], 2.0 * c2 * h, 3.0 * c3 * h**2], axis=2)


def _cubic(q0: Array, v0: Array, q1: Array, v1: Array, h: Array) -> tuple[Array, Array]:
    """Coefficients of s^2 and s^3."""
    c2 = (3.0 * (q1 - q0) / h - 2.0 * v0 - v1) / h
    return c2, (2.0 * (q0 - q1) / h + v0 + v1) / h**2


def _quintic(
    k: IntArray, s: Array, h: Array, nodes: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """Polynomials of degree 5 through position, velocity, acceleration at nodes."""
    q0, v0, a0 = nodes[0][k], nodes[1][k] * h, nodes[2][k] * h**2
    c3, c4, c5 = _rest(k, h, nodes)
    x = s / h
    q = q0 + x * (v0 + x * (0.5 * a0 + x * (c3 + x * (c4 + x * c5))))
    v = v0 + x * (a0 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)))
    a = a0 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5))
    return q, v / h, a / h**2


def _rest(
    k: IntArray, h: Array, nodes: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """What is left for the powers 3 to 5 after those at the left end."""
    q0, v0, a0 = nodes[0][k], nodes[1][k] * h, nodes[2][k] * h**2
    q1, v1, a1 = nodes[0][k + 1], nodes[1][k + 1] * h, nodes[2][k + 1] * h**2
    dq, dv, da = q1 - q0 - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
    return (
        10.0 * dq - 4.0 * dv + 0.5 * da,
        -15.0 * dq + 7.0 * dv - da,
        6.0 * dq - 3.0 * dv + 0.5 * da,
    )
