"""Deviations of directions from another one, as two numbers each."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array

# Below this angle series replace quotients that tend to 0 / 0 [rad].
SMALL = 1e-3
# This close to the opposite direction any way back is as short [rad].
OPPOSITE = 1e-7


def deviations(axes: Array, direction: Array) -> tuple[Array, Array]:
    r"""Deviations of unit vectors a from a direction d, and their derivatives.

    With the angle :math:`\theta` between them and two axes :math:`e_i` across d,

    .. math:: x_i = \frac{\theta}{\sin \theta} e_i^T a, \quad |x| = \theta,

    so that x is zero at d alone, and not at -d, too, as the cross product is.

    Args:
        axes: Unit vectors a, shape (m, 3).
        direction: Unit vector d, shape (3,).

    Returns:
        Deviations, shape (m, 2) [rad], and their derivatives by a, shape (m, 2, 3).
    """
    e = across(direction)
    part, cosine = axes @ e.T, axes @ direction
    sine = np.linalg.norm(part, axis=1)
    angle = np.arctan2(sine, cosine)
    small = angle < SMALL
    safe = np.where(small | (sine == 0.0), 1.0, sine)
    ratio = np.where(small, 1.0 + angle**2 / 6.0, angle / safe)
    slope = (angle * cosine / safe - 1.0) / safe**2
    slope = np.where(small, -1.0 / 3.0 - 2.0 * angle**2 / 15.0, slope)
    # The slope is that of the ratio over the cosine.
    found = ratio[:, None] * part
    by_axis = ratio[:, None, None] * e
    by_axis += slope[:, None, None] * part[:, :, None] * direction
    opposite = np.pi - angle < OPPOSITE
    found[opposite] = np.pi, 0.0
    by_axis[opposite] = -e[0], e[1]
    return found, by_axis


def across(direction: Array) -> Array:
    """Two unit vectors that complete a direction to a frame, shape (2, 3)."""
    least = np.eye(3)[int(np.argmin(np.abs(direction)))]
    first = _cross(direction, least)
    first /= np.linalg.norm(first)
    return np.stack([first, _cross(direction, first)])


def _cross(a: Array, b: Array) -> Array:
    """Cross product of two vectors; NumPy's takes twenty times as long for so few."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])
