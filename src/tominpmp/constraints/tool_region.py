"""Regions for a tool: within a box, or away from a point."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array, BoolArray, default, record
from tominpmp.checks import Corner, Metres, Point
from tominpmp.constraints.path import NONE, FrameRows, Linear
from tominpmp.exceptions import ProblemError
from tominpmp.goals.frames import PoseOrNone

# Scale of an excess [m].
SCALE = 0.1


@record
class WithinRegion(FrameRows):
    """The origin of a frame stays within a box, at all times.

    Attributes:
        frame: Name of the frame.
        lower: Lower corner of the box, along its axes, shape (3,) [m]; minus infinity
            for an open side.
        upper: Upper corner, shape (3,) [m]; infinity for an open side.
        pose: Placement box_to_world; None for the world itself.

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
        wrong = (self.lower > self.upper) | (self.lower == np.inf)
        if np.any(wrong | (self.upper == -np.inf)):
            raise ProblemError(
                f"lower is {self.lower.tolist()} and upper {self.upper.tolist()}, "
                "expected the lower corner below the upper one",
                "lower",
            )
        if not np.any(np.isfinite([self.lower, self.upper])):
            raise ProblemError("lower, upper: the box is infinite", "lower")

    def _local(self, q: Array) -> Array:
        """The origin of the frame along the axes of the box, shape (m, 3) [m]."""
        points = self.motions.placements(q).origin
        if self.pose is None:
            return points
        return np.asarray((points - self.pose.translation) @ self.pose.rotation)

    @property
    def count(self) -> int:
        """One value for each side of the box that is not open."""
        return int(np.isfinite([self.lower, self.upper]).sum())

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Distances from the box, zero within [m]."""
        point = self._local(q)
        out = point - np.clip(point, self.lower, self.upper)
        return np.asarray(np.linalg.norm(out, axis=1))

    @property
    def _sides(self) -> BoolArray:
        return np.asarray(np.isfinite(np.concatenate([self.lower, self.upper])))

    def value_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Excess of the points over each side."""
        point = self._local(q)
        sides = np.concatenate([self.lower - point, point - self.upper], axis=1)
        return np.asarray(sides[:, self._sides] / self.scale)

    def term_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Excess over each side, with derivatives."""
        jacobian = self.motions.jacobians(q)[:, :3]
        if self.pose is not None:
            jacobian = self.pose.rotation.T @ jacobian
        by_q = np.concatenate([-jacobian, jacobian], axis=1)[:, self._sides]
        return self.value_rows(q, v, a), by_q / self.scale, NONE, NONE


@record
class KeepAway(FrameRows):
    """The origin of a frame stays away from a point, at all times.

    Attributes:
        frame: Name of the frame.
        point: The point in the world, shape (3,) [m].
        distance: Least distance from it [m].

    Raises:
        ProblemError: If the point is invalid, or the distance no positive number.
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
        return np.asarray(self.motions.placements(q).origin - self.point)

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Missing distance, zero outside [m]."""
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
        return self.value_rows(q, v, a), by_q, NONE, NONE
