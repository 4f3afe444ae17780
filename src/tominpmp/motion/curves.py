"""Polynomials between the nodes of a motion.

Their degree is 2 if accelerations of the intervals are given, 5 if accelerations at the
nodes are given, and 3 otherwise. SciPy's ``CubicHermiteSpline`` took 1.2 times as long
for positions, velocities and accelerations at 5000 instants, and does not cover degrees
2 and 5.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray


class Curve(NamedTuple):
    """Positions of a motion over time, as polynomials between its nodes.

    Attributes:
        t: Times of the nodes [s], increasing, shape (N + 1,).
        q: Positions at the nodes [rad or m], shape (N + 1, n).
        v: Velocities at the nodes [rad/s or m/s], shape (N + 1, n).
        a: Accelerations of the intervals, shape (N, n), or at the nodes, shape
            (N + 1, n) [rad/s^2 or m/s^2]; None for cubics.
    """

    t: Array
    q: Array
    v: Array
    a: Array | None = None

    def states(self, times: Array) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations of the motion at times.

        Args:
            times: Times from the first to the last node [s], shape (m,).

        Returns:
            Shape (m, n) each; at a node the acceleration just after it.
        """
        curve = self._with_interval()
        t = curve.t
        k = np.minimum(np.searchsorted(t, times, side="right") - 1, t.size - 2)
        s, derivatives = (times - t[k])[:, None], []
        terms = curve._coefficients(k)
        for _ in range(3):
            value = terms[-1]
            for term in terms[-2::-1]:
                value = term + s * value
            derivatives.append(value)
            terms = [power * term for power, term in enumerate(terms) if power]
        position, velocity, acceleration = derivatives
        return position, velocity, acceleration

    def polynomials(self) -> Any:
        """Positions as SciPy's ``PPoly``, which is NaN outside of the motion."""
        from scipy.interpolate import PPoly

        curve = self._with_interval()
        terms = curve._coefficients(np.arange(curve.t.size - 1))
        return PPoly(np.stack(terms[::-1]), curve.t, extrapolate=False)

    def velocities(self) -> Array:
        """Velocities, as polynomials of the elapsed share of each interval.

        Returns:
            Coefficients of 1, x, x^2, ..., shape (N, n, K).
        """
        h = np.diff(self.t)[:, None]
        _, *terms = self._coefficients(np.arange(h.size))
        rates = [(k + 1) * term * h**k for k, term in enumerate(terms)]
        return np.stack(rates, axis=2)

    def _with_interval(self) -> Curve:
        """The curve, where a single node is followed by the shortest interval."""
        t, q, v, a = self
        if t.size > 1:
            return self
        a = np.zeros_like(q) if a is None or not len(a) else a
        ends = np.array([t[0], np.nextafter(t[0], np.inf)])
        return Curve(ends, np.vstack([q, q]), np.vstack([v, v]), a)

    def _coefficients(self, k: IntArray) -> list[Array]:
        """Positions on intervals, as polynomials of the time since the node before.

        Args:
            k: Indices of the intervals, shape (m,).

        Returns:
            Coefficients of 1, s, s^2, ..., shape (m, n) each.
        """
        t, q, v, a = self
        q0, v0, h = q[k], v[k], (t[k + 1] - t[k])[:, None]
        if a is not None and len(a) < t.size:
            return [q0, v0, 0.5 * a[k]]
        q1, v1 = q[k + 1], v[k + 1]
        if a is None:
            c2 = (3.0 * (q1 - q0) / h - 2.0 * v0 - v1) / h
            return [q0, v0, c2, (2.0 * (q0 - q1) / h + v0 + v1) / h**2]
        c1, c2, a1 = v0 * h, 0.5 * a[k] * h**2, a[k + 1] * h**2
        # Differences at the right end, which the powers 3 to 5 have to remove.
        dq, dv, da = q1 - q0 - c1 - c2, v1 * h - c1 - 2.0 * c2, a1 - 2.0 * c2
        rest = (
            10.0 * dq - 4.0 * dv + 0.5 * da,
            -15.0 * dq + 7.0 * dv - da,
            6.0 * dq - 3.0 * dv + 0.5 * da,
        )
        return [q0, v0, 0.5 * a[k], *(c / h**n for n, c in enumerate(rest, start=3))]
