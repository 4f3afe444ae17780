"""Regions for a tool: inside a box, or away from a point."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array, BoolArray, default, record
from tominpmp.checks import Corner, Metres, Point
from tominpmp.constraints.path import EMPTY, FrameRows, Linear
from tominpmp.exceptions import ProblemError
from tominpmp.goals.frames import BoxRegion, PoseOrNone

# Scale of the excess over a side of the box [m].
SCALE = 0.1


@record
class WithinRegion(FrameRows, BoxRegion):
    """The origin of a frame stays within a box, at all times.

    Attributes:
        frame: Name of the frame.
        lower: Lower corner of the box, along its axes, shape (3,) [m]; minus infinity
            for an open side.
        upper: Upper corner, shape (3,) [m]; infinity for an open side.
        pose: Placement box_to_world; None for a box along the axes of the world.

    Raises:
        ProblemError: If the corners are invalid, or all sides are open.
    """

    lower: Corner
    upper: Corner
    pose: PoseOrNone = default(None)

    quantity = "distance from its region"
    unit = "m"
    largest = 0.0
    scale = SCALE

    def __post_init__(self) -> None:
        """Check and copy the values."""
        super().__post_init__()
        if not self.count:
            raise ProblemError("lower, upper: the box is infinite", "lower")

    @property
    def count(self) -> int:
        """Number of values: one for each side of the box that is not open."""
        return int(self._sides.sum())

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Distances from the box, zero inside [m]."""
        return self._apart(self.motions.placements(q).origin)

    @property
    def _sides(self) -> BoolArray:
        """Whether each side is closed, lower sides first, shape (6,)."""
        return np.asarray(np.isfinite(np.concatenate([self.lower, self.upper])))

    def value_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Excess of the frame's origin over each closed side, shape (m, count)."""
        point = self._local(self.motions.placements(q).origin)
        sides = np.concatenate([self.lower - point, point - self.upper], axis=1)
        return np.asarray(sides[:, self._sides] / self.scale)

    def term_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Excess over each closed side, with derivatives."""
        jacobian = self._box.rotation.T @ self.motions.jacobians(q)[:, :3]
        by_q = np.concatenate([-jacobian, jacobian], axis=1)[:, self._sides]
        return self.value_rows(q, v, a), by_q / self.scale, EMPTY, EMPTY


@record
class KeepAway(FrameRows):
    """The origin of a frame stays away from a point, at all times.

    Attributes:
        frame: Name of the frame.
        point: The point in the world, shape (3,) [m].
        distance: Least distance from the point [m].

    Raises:
        ProblemError: If the point is invalid, or the distance is not positive.
    """

    point: Point
    distance: Metres

    quantity = "intrusion"
    unit = "m"
    largest = 0.0

    @property
    def scale(self) -> float:
        """The distance."""
        return self.distance

    def _out(self, q: Array) -> Array:
        """Vectors from the point to the frame's origin, shape (m, 3) [m]."""
        return np.asarray(self.motions.placements(q).origin - self.point)

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Missing distance, zero outside the sphere [m]."""
        away = np.linalg.norm(self._out(q), axis=1)
        return np.asarray(np.maximum(self.distance - away, 0.0))

    def value_rows(self, q: Array, v: Array, a: Array) -> Array:
        """(d^2 - |p - c|^2) / (2 d^2), which has no kink at the point."""
        square = np.sum(self._out(q) ** 2, axis=1)
        return np.asarray(0.5 * (1.0 - square / self.distance**2)[:, None])

    def term_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Values of :meth:`value_rows`, with derivatives."""
        out = self._out(q)[:, None, :]
        by_q = -(out @ self.motions.jacobians(q)[:, :3]) / self.distance**2
        return self.value_rows(q, v, a), by_q, EMPTY, EMPTY
