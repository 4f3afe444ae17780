"""Polynomials between the nodes of a motion, as SciPy's ``PPoly``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import Array

if TYPE_CHECKING:
    from scipy.interpolate import PPoly


def curve_through(t: Array, q: Array, v: Array, a: Array | None = None) -> PPoly:
    """Positions over time, as polynomials between nodes.

    Their degree is 2 if accelerations of the intervals are given, 5 if accelerations at
    the nodes are given, and 3 otherwise.

    Args:
        t: Times of the nodes [s], increasing, shape (N + 1,). A single node is followed
            by the shortest interval.
        q: Positions at the nodes [rad or m], shape (N + 1, n).
        v: Velocities at the nodes [rad/s or m/s], shape (N + 1, n).
        a: Accelerations of the intervals, shape (N, n), or at the nodes, shape
            (N + 1, n) [rad/s^2 or m/s^2]; None for cubics.

    Returns:
        A function of times, which is NaN outside of the motion. Derivatives that jump
        at a node have the value just after it.
    """
    from scipy.interpolate import PPoly

    if t.size == 1:
        t = np.array([t[0], np.nextafter(t[0], np.inf)])
        q, v = np.vstack([q, q]), np.vstack([v, v])
        a = 0.0 * q[:1] if a is None or not len(a) else a
    h = np.diff(t)[:, None]
    if a is not None and len(a) < t.size:
        terms = [q[:-1], v[:-1], 0.5 * a]
    elif a is None:
        c2 = (3.0 * np.diff(q, axis=0) / h - 2.0 * v[:-1] - v[1:]) / h
        c3 = (v[:-1] + v[1:] - 2.0 * np.diff(q, axis=0) / h) / h**2
        terms = [q[:-1], v[:-1], c2, c3]
    else:
        c1, c2, a1 = v[:-1] * h, 0.5 * a[:-1] * h**2, a[1:] * h**2
        # Differences at the right end, which the powers 3 to 5 have to remove.
        dq, dv = np.diff(q, axis=0) - c1 - c2, v[1:] * h - c1 - 2.0 * c2
        da = a1 - 2.0 * c2
        rest = (
            10.0 * dq - 4.0 * dv + 0.5 * da,
            -15.0 * dq + 7.0 * dv - da,
            6.0 * dq - 3.0 * dv + 0.5 * da,
        )
        powers = (c / h**n for n, c in enumerate(rest, start=3))
        terms = [q[:-1], v[:-1], 0.5 * a[:-1], *powers]
    return PPoly.construct_fast(np.stack(terms[::-1]), t, extrapolate=False)
