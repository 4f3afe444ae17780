"""Shapes of Coal: rigid bodies, convex hulls of meshes, and outlines."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from tominpmp.arrays import Array, IntArray

# Thickness that flat meshes get [m], and that all hulls get as a share of their largest
# extent, as Coal crashes on hulls without volume, as flat as 1e-7 of their extent.
THINNEST, THIN_SHARE = 1e-4, 1e-6
# Number of corners of the polygon that encloses a round edge.
CORNERS = 16
# Coal supports at most 254 neighbours of a corner of a hull. If a corner has more, all
# corners with more than CROWDED neighbours are split into corners with about SHARE
# neighbours each.
CROWDED, SHARE = 128, 64
# Largest outward displacement of a hull by this splitting, as a share of its diagonal.
# For a cone of 13 cm distances change by 1e-7 m, which is less than the error of EPA.
BLUNT = 1e-6
# Largest number of rounds of splitting; one round suffices for a few thousand
# neighbours.
ROUNDS = 8


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid shape.

    Attributes:
        name: Name of the link or of the obstacle.
        joint: Index in the model of the joint that carries the body; 0 for the world.
            Indices beyond the joints of the model are moving obstacles, see
            ``MovingObstacles``.
        placement: Placement body_to_joint.
        shape: Shape for Coal.
    """

    name: str
    joint: int
    placement: pin.SE3
    shape: Any


def is_mesh(shape: Any) -> bool:
    """Whether a shape is a triangle mesh, which need not be convex or closed."""
    return isinstance(shape, coal.BVHModelBase)


def is_convex(shape: Any) -> bool:
    """Whether a shape is convex, so that a plane separates it from convex shapes."""
    return isinstance(shape, coal.ShapeBase)


def convex_hull(mesh: Any) -> Any:
    """Convex hull of a mesh, cached with the mesh if possible."""
    if mesh.convex is None:  # not built for an earlier checker
        vertices = np.array(mesh.vertices(), dtype=np.float64)
        points = _thickened(vertices, THINNEST)
        if len(points) > len(vertices):
            return hull_of(points)
        # buildConvexRepresentation would treat a mesh with dents as if it were convex,
        # with distances that are too large.
        try:
            mesh.buildConvexHull(False, "")
        except RuntimeError:
            return hull_of(points)
    return mesh.convex


def hull_of(points: Array) -> Any:
    """Convex hull of points, shape (k, 3).

    It contains all points, and protrudes from their exact hull by no more than a
    millionth of its diagonal (``BLUNT``). Faces stay polygons: in the triangulation of
    a disc, a corner may have more neighbours than Coal supports.
    """
    points = _thickened(points)
    try:
        return _hull(points)
    except RuntimeError:  # too many neighbours
        return _hull(_blunted(points))


def _hull(points: Array) -> Any:
    vector = coal.StdVec_Vec3s()
    vector.extend(list(points))
    return coal.Convex.convexHull(vector, False, "")


def _blunted(points: Array) -> Array:
    """Points, (k, 3) [m], whose hull contains those given, without crowded corners.

    A corner with too many neighbours, such as the tip of a cone, is replaced by a ring
    of points around it.
    """
    reach = BLUNT * float(np.linalg.norm(np.ptp(points, axis=0)))
    for _ in range(ROUNDS):
        hull = ConvexHull(points)
        tips = np.flatnonzero(_neighbours(hull) > CROWDED)
        if not tips.size:
            break
        reach *= 0.5  # so that the sum over all rounds stays below its first value
        rings = [_ring(hull, tip, reach) for tip in tips.tolist()]
        points = np.concatenate([points[hull.vertices], *rings])
    return points


def _neighbours(hull: ConvexHull) -> IntArray:
    """Number of edges at each point of a hull, without edges inside a flat face."""
    ends = [
        hull.simplices[np.any(hull.equations != beyond, axis=1)][:, [k - 1, k - 2]]
        for k, beyond in enumerate(hull.equations[hull.neighbors.T])
    ]
    twice = np.bincount(np.concatenate(ends).ravel(), minlength=len(hull.points))
    return np.asarray(twice // 2)


def _ring(hull: ConvexHull, tip: int, radius: float) -> Array:
    """Points around a corner of a hull, perpendicular to the mean normal of its faces.

    Their shape is (k, 3) [m]. They lie in the directions of normals of faces, so that
    each is a corner of a face.
    """
    faces = hull.equations[np.any(hull.simplices == tip, axis=1), :3]
    normals = np.unique(faces, axis=0)
    across = np.linalg.svd(normals.mean(axis=0)[None])[2][1:]
    angle = np.sort(np.arctan2(*(normals @ across.T).T))[::SHARE]
    ring = np.column_stack([np.sin(angle), np.cos(angle)]) @ across
    return np.asarray(hull.points[tip] + radius * ring)


def _thickened(points: Array, least: float = 0.0) -> Array:
    """Points, (k, 3) [m], copied to both sides of their plane if they are flat."""
    centred = points - points.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1].T
    extents = np.ptp(points @ axes.T, axis=0)
    thinnest = max(least, THIN_SHARE * float(extents.max()))
    for axis in axes[extents < thinnest]:
        shift = 0.5 * thinnest * axis
        points = np.concatenate([points - shift, points + shift])
    return points


def outline(shape: Any) -> tuple[Array, float]:
    """Outline of a shape: an inflated hull of points, tight except at cylinders.

    Returns:
        Points, shape (k, 3) [m], and the radius by which their hull is inflated [m].
    """
    if isinstance(shape, coal.Sphere):
        return np.zeros((1, 3)), float(shape.radius)
    if isinstance(shape, coal.Capsule):
        half = float(shape.halfLength)
        return np.array([[0, 0, -half], [0, 0, half]]), float(shape.radius)
    if isinstance(shape, coal.Cylinder):
        return _drum(float(shape.radius), float(shape.halfLength)), 0.0
    if isinstance(shape, coal.ConvexBase):
        return np.array(shape.points(), dtype=np.float64), 0.0
    if isinstance(shape, coal.BVHModelBase):
        return np.array(shape.vertices(), dtype=np.float64), 0.0
    corners = np.array([*product((-1.0, 1.0), repeat=3)])  # of a box
    return corners * np.asarray(shape.halfSide).ravel(), 0.0


def _drum(radius: float, half: float) -> Array:
    """Corners of a prism that encloses a cylinder, shape (2 CORNERS, 3) [m]."""
    angle = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    ring = radius / np.cos(np.pi / CORNERS) * np.array([np.cos(angle), np.sin(angle)])
    ends = [np.column_stack([ring.T, np.full(CORNERS, z)]) for z in (-half, half)]
    return np.concatenate(ends)
