r"""Quadratic splines in time: position with a constant acceleration on each interval.

The unknowns are the middle Bezier points P_k of the N pieces and the lengths h_k. With
s_k = h_{k-1} + h_k,

.. math::
    v_k = 2 (P_k - P_{k-1}) / s_k, \qquad
    q_k = P_{k-1} + h_{k-1} (P_k - P_{k-1}) / s_k, \qquad
    a_k = (v_{k+1} - v_k) / h_k,

so that the double integrator holds exactly without a row for it, everything on interval
k depends on P_{k-1}, P_k, P_{k+1} alone, the curve lies in the convex hull of the
points (position limits hold at every time) and speed is piecewise linear (speed limits
too).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array


@dataclass(frozen=True)
class Spline:
    """A quadratic spline through given end states.

    Attributes:
        points: Middle Bezier points, shape (N, n).
        h: Lengths of the intervals [s], shape (N,).
        q_ends: Positions at start and end, shape (2, n).
        v_ends: Velocities at start and end, shape (2, n).
    """

    points: Array
    h: Array
    q_ends: Array
    v_ends: Array

    @property
    def q(self) -> Array:
        """Positions at the nodes, shape (N + 1, n)."""
        h, p = self.h, self.points
        share = h[:-1] / (h[:-1] + h[1:])
        inner = p[:-1] + share[:, None] * np.diff(p, axis=0)
        return np.concatenate([self.q_ends[:1], inner, self.q_ends[1:]])

    @property
    def v(self) -> Array:
        """Velocities at the nodes, shape (N + 1, n)."""
        inner = 2.0 * np.diff(self.points, axis=0) / (self.h[:-1] + self.h[1:])[:, None]
        return np.concatenate([self.v_ends[:1], inner, self.v_ends[1:]])

    @property
    def a(self) -> Array:
        """Accelerations on the intervals, shape (N, n)."""
        return np.asarray(np.diff(self.v, axis=0) / self.h[:, None])


@dataclass(frozen=True)
class SplineDerivatives:
    """How states within intervals depend on points and lengths.

    For each interval k the arrays hold coefficients for (P_{k-1}, P_k, P_{k+1}), which
    are scalars as the joints do not mix, and vectors for (h_{k-1}, h_k, h_{k+1}). What
    does not exist at the ends has the coefficient zero.

    Attributes:
        q_points: For positions at both ends of each interval, shape (2, N, 3).
        v_points: For velocities there, shape (2, N, 3).
        a_points: For the acceleration, shape (N, 3).
        q_lengths: Shape (2, N, 3, n).
        v_lengths: Shape (2, N, 3, n).
        a_lengths: Shape (N, 3, n).
    """

    q_points: Array
    v_points: Array
    a_points: Array
    q_lengths: Array
    v_lengths: Array
    a_lengths: Array


def differentiate(spline: Spline) -> SplineDerivatives:
    """Derivatives of a spline with respect to its points and lengths.

    The given end states do not move; how P_0 and P_{N-1} hang on them is the caller's.

    Args:
        spline: The spline.

    Returns:
        The coefficients.
    """
    h, v = spline.h, spline.v
    N, n = spline.points.shape
    before = np.concatenate([[0.0], h[:-1]])
    after = np.concatenate([h[1:], [0.0]])
    left = np.where(np.arange(N) > 0, 1.0, 0.0)  # the left end is an inner node
    right = np.where(np.arange(N) < N - 1, 1.0, 0.0)
    sl = np.where(left > 0, before + h, 1.0)
    sr = np.where(right > 0, h + after, 1.0)
    zero = np.zeros(N)
    v_points = np.stack(
        [
            np.stack([-2.0 * left / sl, 2.0 * left / sl, zero], axis=1),
            np.stack([zero, -2.0 * right / sr, 2.0 * right / sr], axis=1),
        ]
    )
    q_points = np.stack(
        [
            np.stack([left * h / sl, left * before / sl, zero], axis=1),
            np.stack([zero, right * after / sr, right * h / sr], axis=1),
        ]
    )
    vl, vr = v[:-1], v[1:]
    none = np.zeros((N, n))
    by_left, by_right = -(left / sl)[:, None] * vl, -(right / sr)[:, None] * vr
    v_lengths = np.stack(
        [
            np.stack([by_left, by_left, none], axis=1),
            np.stack([none, by_right, by_right], axis=1),
        ]
    )
    half_l, half_r = 0.5 * (left / sl)[:, None] * vl, 0.5 * (right / sr)[:, None] * vr
    q_lengths = np.stack(
        [
            np.stack([h[:, None] * half_l, -before[:, None] * half_l, none], axis=1),
            np.stack([none, after[:, None] * half_r, -h[:, None] * half_r], axis=1),
        ]
    )
    a_points = (v_points[1] - v_points[0]) / h[:, None]
    a_lengths = (v_lengths[1] - v_lengths[0]) / h[:, None, None]
    a_lengths[:, 1] -= spline.a / h[:, None]
    return SplineDerivatives(
        q_points, v_points, a_points, q_lengths, v_lengths, a_lengths
    )


def jumps_by_length(spline: Spline, shares: Array) -> Array:
    """How jumps of the accelerations at inner nodes depend on lengths, (N - 1, n, m).

    Shares are lengths of the intervals by the m unknowns, shape (N, m).
    """
    N = shares.shape[0]
    around, by = np.pad(shares, ((1, 1), (0, 0))), differentiate(spline).a_lengths
    parts = [by[:, j, :, None] * around[j : j + N, None] for j in range(3)]
    return np.diff(parts[0] + parts[1] + parts[2], axis=0)
