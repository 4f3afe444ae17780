r"""Paths in joint space: straight pieces with rounded corners.

Along a polyline the derivative q'(s) jumps at every corner. On a rounded path it
changes from one piece to the next within an interval of half width r around the corner,
by the smooth step

.. math:: \sigma(u) = \tfrac12 + \tfrac34 u - \tfrac14 u^3, \quad u = (s - s_c) / r

so that q'' is continuous. As the step is odd about its middle, the path coincides with
the polyline outside of the interval; inside, it deviates by at most 3/16 r times the
jump.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array

# Joint displacement between two collision checks on a path [rad or m].
RESOLUTION = 0.05
# Number of intervals of a path whose inner configurations are shifted into constraints,
# and of points at which two paths, or two motions, are compared.
PLACES = 24
# Most halvings of a rounding that collides.
HALVINGS = 5
# Corners, and grid points, closer than this, as a share of the path, are merged.
SHORTEST = 1e-6


def speed_weights(velocity: Array) -> Array:
    """Weights that convert displacements of joints to times at speed limits, (n,).

    A joint without a speed limit counts like the slowest of the other joints.
    """
    finite = np.isfinite(velocity)
    weights = np.divide(1.0, velocity, out=np.zeros_like(velocity), where=finite)
    weights[~finite] = np.max(weights, initial=0.0) or 1.0
    return weights


@dataclass(frozen=True, eq=False)
class RoundedPath:
    """A path over s from 0 to 1.

    Attributes:
        corners: Corners of the polyline, shape (m, n) [rad or m].
        s: Path parameter of the corners, shape (m,).
        radii: Half widths, in s, of the rounded corners, shape (m,); 0 at both ends.
    """

    corners: Array
    s: Array
    radii: Array

    @classmethod
    def through(cls, corners: Array, velocity: Array) -> RoundedPath:
        """Path with the widest roundings that do not overlap.

        The pieces have shares of s in proportion to their times at the speed limits, so
        that the path speed changes little at the corners.

        Args:
            corners: Corners, shape (m, n); repeated corners are left out.
            velocity: Speed limits, shape (n,) [rad/s or m/s], possibly infinite.
        """
        weights = speed_weights(velocity)
        lengths = np.max(np.abs(np.diff(corners, axis=0)) * weights, axis=1)
        if not lengths.any():
            lengths = np.ones_like(lengths)  # the arm rests
        kept = lengths > SHORTEST * lengths.sum()
        corners = np.vstack([corners[:-1][kept], corners[-1:]])
        s = np.concatenate([[0.0], np.cumsum(lengths[kept])]) / lengths[kept].sum()
        s[-1] = 1.0
        steps = np.diff(s)
        room = 0.5 * steps
        room[0], room[-1] = steps[0], steps[-1]  # both ends of the path are not rounded
        radii = np.zeros_like(s)
        radii[1:-1] = np.minimum(room[:-1], room[1:])
        return cls(corners, s, radii)

    def clear_of_obstacles(self, is_free: Callable[[Array], bool]) -> RoundedPath:
        """Path whose roundings are narrowed until they are collision-free.

        A corner that remains in collision keeps its narrowest rounding.
        """
        radii = self.radii.copy()
        speeds = np.abs(self._slopes).max(axis=1)
        for k in range(1, self.s.size - 1):
            speed = max(speeds[k - 1], speeds[k])
            for _ in range(HALVINGS):
                path = replace(self, radii=radii)
                count = 2 + int(2.0 * radii[k] * speed / RESOLUTION)
                u = np.linspace(-1.0, 1.0, count + 1)
                q, _, _ = path.evaluate(self.s[k] + radii[k] * u)
                if all(is_free(row) for row in q):
                    break
                radii[k] *= 0.5
        return replace(self, radii=radii)

    @property
    def _slopes(self) -> Array:
        """Derivatives q' on the pieces, shape (m - 1, n)."""
        return np.asarray(np.diff(self.corners, axis=0) / np.diff(self.s)[:, None])

    def evaluate(self, s: Array) -> tuple[Array, Array, Array]:
        """Configurations q and their derivatives q' and q'' by s, shapes (k, n)."""
        slopes = self._slopes
        piece = np.searchsorted(self.s, s, side="right") - 1
        piece = np.clip(piece, 0, len(slopes) - 1)
        q = self.corners[piece] + (s - self.s[piece])[:, None] * slopes[piece]
        first, second = slopes[piece], np.zeros_like(q)
        for k in range(1, self.s.size - 1):
            radius = float(self.radii[k])
            inside = np.abs(s - self.s[k]) < radius
            jump = slopes[k] - slopes[k - 1]
            u = ((s[inside] - self.s[k]) / radius)[:, None]
            lag = 3.0 / 16.0 + u * (0.5 + u * (0.375 - u * u / 16.0))
            q[inside] += radius * (lag - np.maximum(u, 0.0)) * jump
            first[inside] = slopes[k - 1] + (0.5 + u * (0.75 - 0.25 * u * u)) * jump
            second[inside] = 0.75 * (1.0 - u * u) / radius * jump
        return q, first, second

    def grid(self, points: int, corner_points: int) -> Array:
        """Grid of s for timing, finer at the ends and in the rounded corners."""
        # Near the ends s grows with the square of time: the spacing is even in time.
        whole = 0.5 * (1.0 - np.cos(np.pi * np.linspace(0.0, 1.0, points)))
        u = np.linspace(-1.0, 1.0, corner_points)
        inner = slice(1, -1)
        corners = self.s[inner, None] + self.radii[inner, None] * u
        s = np.sort(np.concatenate([whole, np.clip(corners, 0.0, 1.0).ravel()]))
        return np.asarray(s[np.diff(s, append=2.0) > SHORTEST])
