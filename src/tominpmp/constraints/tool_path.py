"""Tubes for a tool: around a straight line, a polyline, or an arc.

The orientation of the tool is free; :class:`~tominpmp.KeepUpright` in addition keeps an
axis of it in a cone, and :class:`~tominpmp.KeepOrientation` fixes it.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property, partial
from itertools import pairwise
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
    def from_curve(self, point: Array) -> tuple[Array, Array]:
        """Vector from the nearest point of the curve, and its derivative.

        Args:
            point: A point in the world, shape (3,) [m].

        Returns:
            Vector [m], shape (3,), and its derivative by the point, shape (3, 3).
        """

    @abstractmethod
    def progress(self, point: Array) -> float:
        """Parameter of the point of the curve nearest to a point, shape (3,)."""

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
        points = self.motions.placements(q).origin
        return np.array([np.linalg.norm(self.from_curve(point)[0]) for point in points])

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Vectors from the nearest points of the curve [m]."""
        every = [self.from_curve(point) for point in self.motions.placements(q).origin]
        found = np.array([vector for vector, _ in every])
        by_point = np.array([slope for _, slope in every])
        jacobian = self.motions.jacobians(q)[:, :3]
        return found, by_point @ jacobian, EMPTY, EMPTY


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

    def progress(self, point: Array) -> float:
        """Share of the line at its nearest point."""
        return _share_of_segment(point, self.start, self.end)

    def at(self, progress: float) -> Array:
        """Point at a share of the line."""
        share = number(progress, "progress")
        return np.asarray(self.start + share * (self.end - self.start))

    def from_curve(self, point: Array) -> tuple[Array, Array]:
        """Vector from the nearest point of the line."""
        return _from_segment(point, self.start, self.end)


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

    def progress(self, point: Array) -> float:
        """Arc length of the nearest point [m]."""
        pairs = list(pairwise(self.points))
        apart = [np.linalg.norm(_from_segment(point, *pair)[0]) for pair in pairs]
        k, lengths = int(np.argmin(apart)), self._lengths
        share = _share_of_segment(point, *pairs[k])
        return float(lengths[k] + share * (lengths[k + 1] - lengths[k]))

    def at(self, progress: float) -> Array:
        """Point at an arc length [m]."""
        length, lengths = number(progress, "progress"), self._lengths
        each = [np.interp(length, lengths, column) for column in self.points.T]
        return np.array(each)

    def from_curve(self, point: Array) -> tuple[Array, Array]:
        """Vector from the nearest point of the polyline."""
        found = [_from_segment(point, *ends) for ends in pairwise(self.points)]
        return min(found, key=lambda pair: float(pair[0] @ pair[0]))


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
            raise wrong(self.axis.tolist(), "axis", expected)

    @cached_property
    def _plane(self) -> tuple[float, Array, Array]:
        """Radius of the circle [m], and two perpendicular unit vectors in its plane.

        The vectors point from the centre to the start, and along the arc at the start.
        """
        spoke, axis = self.start - self.center, self.axis / np.linalg.norm(self.axis)
        size = float(np.linalg.norm(spoke))
        return size, spoke / size, np.cross(axis, spoke / size)

    def progress(self, point: Array) -> float:
        """Angle from the start to the nearest point of the arc [rad]."""
        _, first, second = self._plane
        out = array(point, "point", (3,), POINT) - self.center
        turn = float(np.arctan2(out @ second, out @ first)) % (2.0 * np.pi)
        if turn > self.angle:  # beyond the arc: take the nearer end
            return self.angle if turn - self.angle < 2.0 * np.pi - turn else 0.0
        return turn

    def at(self, progress: float) -> Array:
        """Point at an angle from the start [rad]."""
        size, first, second = self._plane
        angle = number(progress, "progress")
        spoke = np.cos(angle) * first + np.sin(angle) * second
        return np.asarray(self.center + size * spoke)

    def from_curve(self, point: Array) -> tuple[Array, Array]:
        """Vector from the nearest point of the arc."""
        size, first, second = self._plane
        out = array(point, "point", (3,), POINT) - self.center
        x, y = float(out @ first), float(out @ second)
        turn = float(np.arctan2(y, x)) % (2.0 * np.pi)
        if turn > self.angle:
            return point - self.at(self.progress(point)), np.eye(3)
        flat = max(float(np.hypot(x, y)), 1e-12)
        along = (x * first + y * second) / flat
        across = (x * second - y * first) / flat
        return out - size * along, np.eye(3) - (size / flat) * np.outer(across, across)


def _from_segment(point: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Vector from the nearest point of a straight line, and its derivative.

    Args:
        point: The point, shape (3,).
        start: One end of the line, shape (3,).
        end: The other end, shape (3,); may be equal to the start.

    Returns:
        Vector, shape (3,), and its derivative by the point, shape (3, 3).
    """
    point = array(point, "point", (3,), POINT)
    along, out = end - start, point - start
    square, share = float(along @ along), _share_of_segment(point, start, end)
    if not 0.0 < share < 1.0:
        return point - (end if share >= 1.0 else start), np.eye(3)
    return out - share * along, np.eye(3) - np.outer(along, along) / square


def _share_of_segment(point: Array, start: Array, end: Array) -> float:
    """Share of a straight line at its point nearest to a given point, from 0 to 1."""
    point, along = array(point, "point", (3,), POINT), end - start
    square = float(along @ along)
    share = float((point - start) @ along) / square if square > 0.0 else 0.0
    return min(max(share, 0.0), 1.0)
