"""How far a direction deviates from another one, as two numbers."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array

# Below this angle series replace quotients that tend to 0 / 0 [rad].
SMALL = 1e-3
# This close to the opposite direction any way back is as short [rad].
OPPOSITE = 1e-7


def deviation(a: Array, direction: Array) -> tuple[Array, Array]:
    r"""Deviation of a unit vector a from a direction d, and its derivative.

    With the angle :math:`\theta` between them and two axes :math:`e_i` across d,

    .. math:: x_i = \frac{\theta}{\sin \theta} e_i^T a, \quad |x| = \theta,

    so that x is zero at d alone, and not at -d, too, as the cross product is.

    Args:
        a: Unit vector, shape (3,).
        direction: Unit vector d, shape (3,).

    Returns:
        Deviation, shape (2,) [rad], and its derivative by a, shape (2, 3).
    """
    e = across(direction)
    part = e @ a
    cosine, sine = float(direction @ a), float(np.linalg.norm(part))
    angle = float(np.arctan2(sine, cosine))
    if np.pi - angle < OPPOSITE:
        return np.array([np.pi, 0.0]), np.stack([-e[0], e[1]])
    if angle < SMALL:
        ratio = 1.0 + angle**2 / 6.0
        slope = -1.0 / 3.0 - 2.0 * angle**2 / 15.0
    else:
        ratio = angle / sine
        slope = (angle * cosine / sine - 1.0) / sine**2
    # The slope is that of the ratio over the cosine.
    return ratio * part, ratio * e + slope * np.outer(part, direction)


def deviations(axes: Array, direction: Array) -> tuple[Array, Array]:
    """Deviations of many unit vectors, and their derivatives: see :func:`deviation`.

    Args:
        axes: Unit vectors, shape (m, 3).
        direction: Unit vector, shape (3,).

    Returns:
        Shapes (m, 2) [rad] and (m, 2, 3).
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
    for k in np.flatnonzero(np.pi - angle < OPPOSITE).tolist():
        found[k], by_axis[k] = deviation(axes[k], direction)
    return found, by_axis


def across(direction: Array) -> Array:
    """Two unit vectors that complete a direction to a frame, shape (2, 3)."""
    least = np.eye(3)[int(np.argmin(np.abs(direction)))]
    first = cross(direction, least)
    first /= np.linalg.norm(first)
    return np.stack([first, cross(direction, first)])


def cross(a: Array, b: Array) -> Array:
    """Cross product of two vectors; NumPy's takes twenty times as long for so few."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])
