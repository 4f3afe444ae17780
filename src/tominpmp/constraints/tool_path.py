"""Tubes for a tool: around a straight line, a polyline, or an arc.

The orientation of the tool is free; :class:`~tominpmp.KeepUpright` in addition keeps an
axis of it in a cone, and :class:`~tominpmp.KeepOrientation` fixes it.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property, partial
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Converted, array_or_nan, default, record
from tominpmp.checks import Metres, Point, array, number, positive, whole, wrong
from tominpmp.constraints.path import EMPTY, CurveSampler, FrameRows, Linear
from tominpmp.exceptions import brief

POINT = "coordinates [m]"

ArcAngle: TypeAlias = Annotated[float, partial(positive, unit="rad", most=2.0 * np.pi)]


class Tube(FrameRows):
    """Base class: the origin of a frame stays within a radius of a curve."""

    radius: Metres

    quantity = "distance from its path"
    bound = "radius"
    least_scale = 0.02
    unit = "m"

    @abstractmethod
    def _nearest(self, points: Array) -> tuple[Array, Array, Array]:
        """The points of the curve nearest to points in the world, shape (m, 3) [m].

        Returns:
            Their parameters, shape (m,), the vectors from them to the points, shape (m,
            3) [m], and their derivatives by the points, shape (m, 3, 3).
        """

    def from_curve(self, point: Array) -> tuple[Array, Array]:
        """Vector from the nearest point of the curve, and its derivative.

        Args:
            point: Points in the world, shape (..., 3) [m].

        Returns:
            Vectors [m], shape (..., 3), and their derivatives by the points, shape
            (..., 3, 3).
        """
        point = array(point, "point", (..., 3), POINT)
        _, out, slope = self._nearest(point.reshape(-1, 3))
        return out.reshape(point.shape), (np.eye(3) - slope).reshape(*point.shape, 3)

    def progress(self, point: Array) -> float:
        """Parameter of the point of the curve nearest to a point, shape (3,)."""
        return float(self._nearest(array(point, "point", (3,), POINT)[None])[0][0])

    @abstractmethod
    def at(self, progress: float) -> Array:
        """The point of the curve at a parameter, shape (3,) [m]."""

    @property
    def guide(self) -> tuple[str, CurveSampler]:
        """The frame, and the curve that its origin must follow."""
        return self.frame, self.between

    def between(self, first: Array, last: Array, count: int) -> Array:
        """Points of the curve between the nearest ones to two points, (count, 3)."""
        ends = self.progress(first), self.progress(last)
        count = whole(count, "count")
        return np.array([self.at(s) for s in np.linspace(*ends, count).tolist()])

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Distances [m]."""
        found, _ = self.from_curve(self.motions.placements(q).origin)
        return np.asarray(np.linalg.norm(found, axis=1))

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Vectors from the nearest points of the curve [m]."""
        found, by_point = self.from_curve(self.motions.placements(q).origin)
        return found, by_point @ self.motions.jacobians(q)[:, :3], EMPTY, EMPTY


@record
class ToolLine(Tube):
    """The origin of a frame stays within a radius of a straight line, at all times.

    Attributes:
        frame: Name of the frame.
        start: One end of the line in the world, shape (3,) [m].
        end: The other end, shape (3,) [m].
        radius: Largest distance from the line [m].

    Raises:
        ProblemError: If an end is not a point, or the radius is not positive.
    """

    start: Point
    end: Point
    radius: Metres = 1e-3

    def _nearest(self, points: Array) -> tuple[Array, Array, Array]:
        """The nearest points of the line, by shares of it."""
        return _nearest(points, np.stack([self.start, self.end]), np.arange(2.0))

    def at(self, progress: float) -> Array:
        """Point at a share of the line."""
        share = number(progress, "progress")
        return np.asarray(self.start + share * (self.end - self.start))


def _checked_corners(value: ArrayLike, name: str) -> Array:
    points = array_or_nan(value)
    right = points.ndim == 2 and points.shape[0] > 1 and points.shape[1] == 3
    if not right or not np.all(np.isfinite(points)):
        raise wrong(value, name, f"two or more points of three {POINT}")
    return points


Corners: TypeAlias = Annotated[Converted[ArrayLike, Array], _checked_corners]


@record
class ToolPolyline(Tube):
    """The origin of a frame stays within a radius of a polyline, at all times.

    Attributes:
        frame: Name of the frame.
        points: Corners of the polyline in the world, shape (k, 3) [m].
        radius: Largest distance from the polyline [m].

    Raises:
        ProblemError: If there are fewer than two points, or the radius is not positive.
    """

    points: Corners
    radius: Metres = 1e-3

    @property
    def _lengths(self) -> Array:
        """Arc length to each corner, shape (k,) [m]."""
        pieces = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(pieces)])

    def _nearest(self, points: Array) -> tuple[Array, Array, Array]:
        """The nearest points of the polyline, by arc lengths [m]."""
        return _nearest(points, self.points, self._lengths)

    def at(self, progress: float) -> Array:
        """Point at an arc length [m]."""
        length, lengths = number(progress, "progress"), self._lengths
        each = [np.interp(length, lengths, column) for column in self.points.T]
        return np.array(each)


@record
class ToolArc(Tube):
    """The origin of a frame stays within a radius of an arc of a circle.

    Attributes:
        frame: Name of the frame.
        center: Centre of the circle in the world, shape (3,) [m].
        start: Beginning of the arc, shape (3,) [m].
        axis: Axis of the arc, by the right-hand rule, shape (3,); of any length,
            perpendicular to the line from the centre to the start.
        angle: Angle of the arc, up to a full turn [rad].
        radius: Largest distance from the arc [m].

    Raises:
        ProblemError: If a vector is not three numbers, the axis is not perpendicular,
            or a number is not positive.
    """

    center: Point
    start: Point
    axis: Point = default((0.0, 0.0, 1.0))
    angle: ArcAngle = 2.0 * np.pi
    radius: Metres = 1e-3

    def __post_init__(self) -> None:
        """Check and copy the values."""
        super().__post_init__()
        spoke = self.start - self.center
        sizes = np.linalg.norm(self.axis), np.linalg.norm(spoke)
        if not min(sizes) > 0.0 or abs(self.axis @ spoke) > 1e-6 * sizes[0] * sizes[1]:
            across = "a vector across the way from the center to the start"
            expected = f"{across}, {brief(spoke.tolist())}"
            raise wrong(self.axis.tolist(), f"{self._owner}axis", expected)

    @cached_property
    def _plane(self) -> tuple[float, Array, Array]:
        """Radius of the circle [m], and two perpendicular unit vectors in its plane.

        The vectors point from the centre to the start, and along the arc at the start.
        """
        spoke, axis = self.start - self.center, self.axis / np.linalg.norm(self.axis)
        size = float(np.linalg.norm(spoke))
        return size, spoke / size, np.cross(axis, spoke / size)

    def _nearest(self, points: Array) -> tuple[Array, Array, Array]:
        """The nearest points of the arc, by angles from the start [rad]."""
        size, first, second = self._plane
        out = points - self.center
        x, y = out @ first, out @ second
        turn = np.arctan2(y, x) % (2.0 * np.pi)
        beyond = turn > self.angle
        nearer = np.where(turn - self.angle < 2.0 * np.pi - turn, self.angle, 0.0)
        turn = np.where(beyond, nearer, turn)
        spoke = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
        along = np.cos(turn)[:, None] * second - np.sin(turn)[:, None] * first
        rate = np.where(beyond, 0.0, size / np.maximum(np.hypot(x, y), 1e-12))
        return turn, out - size * spoke, _squares(along, rate)

    def at(self, progress: float) -> Array:
        """Point at an angle from the start [rad]."""
        size, first, second = self._plane
        angle = number(progress, "progress")
        spoke = np.cos(angle) * first + np.sin(angle) * second
        return np.asarray(self.center + size * spoke)


def _nearest(
    points: Array, corners: Array, progress: Array
) -> tuple[Array, Array, Array]:
    """The points of a polyline nearest to points; see :class:`Tube`.

    Args:
        points: The points, shape (m, 3).
        corners: Corners of the polyline, shape (k, 3); neighbours may be equal.
        progress: Parameters of the corners, shape (k,).
    """
    along, out = np.diff(corners, axis=0), points[:, None] - corners[:-1]
    square = np.sum(along * along, axis=1)
    square[square == 0.0] = 1.0
    share = np.clip(np.sum(out * along, axis=2) / square, 0.0, 1.0)
    out -= share[:, :, None] * along
    rows, piece = np.arange(len(points)), np.argmin(np.sum(out * out, axis=2), axis=1)
    share = share[rows, piece]
    rate = np.where((share > 0.0) & (share < 1.0), 1.0 / square[piece], 0.0)
    at = progress[piece] + share * np.diff(progress)[piece]
    return at, out[rows, piece], _squares(along[piece], rate)


def _squares(rows: Array, factors: Array) -> Array:
    """Matrices f r r^T for vectors r, shape (m, 3), and factors f, shape (m,)."""
    return np.asarray(factors[:, None, None] * rows[:, :, None] * rows[:, None, :])
