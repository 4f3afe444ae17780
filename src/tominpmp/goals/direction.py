"""Deviations of unit vectors from a direction, with two components each."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array

# Angle below which Taylor series replace quotients that tend to 0 / 0 [rad].
SMALL = 1e-3
# Angle from the opposite direction within which all ways back are equally short [rad].
OPPOSITE = 1e-7


def deviations(axes: Array, direction: Array) -> tuple[Array, Array]:
    r"""Deviations of unit vectors a from a direction d, and their derivatives.

    With the angle :math:`\theta` between a and d and two unit vectors :math:`e_i` that
    are perpendicular to d and to each other,

    .. math:: x_i = \frac{\theta}{\sin \theta} e_i^T a, \quad |x| = \theta,

    so that x is zero at d only, whereas the cross product is zero at -d, too.

    Args:
        axes: Unit vectors a, shape (m, 3).
        direction: Unit vector d, shape (3,).

    Returns:
        Deviations, shape (m, 2) [rad], and their derivatives with respect to a, shape
        (m, 2, 3).
    """
    e = across(direction)
    lateral, cosine = axes @ e.T, axes @ direction
    sine = np.linalg.norm(lateral, axis=1)
    angle = np.arctan2(sine, cosine)
    small = angle < SMALL
    safe = np.where(small | (sine == 0.0), 1.0, sine)
    ratio = np.where(small, 1.0 + angle**2 / 6.0, angle / safe)
    slope = (angle * cosine / safe - 1.0) / safe**2
    slope = np.where(small, -1.0 / 3.0 - 2.0 * angle**2 / 15.0, slope)
    # The slope is the derivative of the ratio with respect to the cosine.
    deviation = ratio[:, None] * lateral
    by_axis = ratio[:, None, None] * e
    by_axis += slope[:, None, None] * lateral[:, :, None] * direction
    opposite = np.pi - angle < OPPOSITE
    deviation[opposite] = np.pi, 0.0
    by_axis[opposite] = -e[0], e[1]
    return deviation, by_axis


def across(direction: Array) -> Array:
    """Two unit vectors that complete a direction to orthogonal axes, shape (2, 3)."""
    least = np.eye(3)[int(np.argmin(np.abs(direction)))]
    first = _cross(direction, least)
    first /= np.linalg.norm(first)
    return np.stack([first, _cross(direction, first)])


def _cross(a: Array, b: Array) -> Array:
    """Cross product of two vectors, (3,); for one pair NumPy's is 20 times as slow."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])
