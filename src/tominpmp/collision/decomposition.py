"""Convex decomposition of meshes that are not convex.

A mesh is cut by planes, one after the other. Each plane cuts the piece whose hull
protrudes farthest from the mesh, such that the hulls of both halves have the least
volume. The hulls of all pieces cover the whole interior of a closed mesh, so that
pieces are never too small: V-HACD left up to 7 mm of a UR5's links uncovered. CoACD
(1.0.14) covers them as well, but took 15 s for the forearm of a UR5 and 160 s for its
shoulder, where this module takes less than a second each, and returned 3 to 24 times as
many corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from tominpmp.arrays import Array
from tominpmp.description.model import mesh_arrays
from tominpmp.stopping import check

# A mesh is cut until its pieces protrude from it by no more than this [m].
CLOSE_PIECES = 5e-3
# Largest number of pieces. The fewest pieces are chosen whose largest protrusion is
# within CLOSE_PIECES, or within the factor NEARLY of the smallest one.
MOST_PIECES = 8
NEARLY = 1.2
# Positions of the cuts that are tried across up to six axes, in shares of the extent.
CUTS = (0.12, 0.25, 0.38, 0.5, 0.62, 0.75, 0.88)
# Axes of inertia whose cosine with an axis of the mesh is larger are not tried.
ALIGNED = 0.99
# Number of sample points on each surface.
SAMPLES = 400
# Points closer than this count as points on the surface [m].
TOUCHING = 2e-4


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of a mesh: triangles (k, 3, 3), their hull, and its protrusion [m]."""

    triangles: Array
    hull: Any
    excess: float


def decompose(mesh: Any) -> list[Array]:
    """Cut a mesh of Coal into convex pieces.

    Returns:
        Corners of each piece [m], shapes (k, 3); empty if the mesh is flat.
    """
    vertices, corners = mesh_arrays(mesh)
    measure = Measure(mesh, vertices[corners])
    whole = measure.part(vertices[corners])
    if whole is None:
        return []
    found = [whole]
    steps = [found]
    while len(found) < MOST_PIECES and _worst(found) > CLOSE_PIECES:
        found = _cut_worst(found, measure)
        if len(found) == len(steps[-1]):
            break
        steps.append(found)
    enough = max(CLOSE_PIECES, NEARLY * min(map(_worst, steps)))
    best = next(parts for parts in steps if _worst(parts) <= enough)
    return [item.hull.points[item.hull.vertices] for item in best]


def _worst(parts: list[_Part]) -> float:
    """Largest protrusion of the hulls of parts [m]."""
    return max(part.excess for part in parts)


def _cut_worst(parts: list[_Part], measure: Measure) -> list[_Part]:
    """Cut the part with the largest protrusion, if it can be cut."""
    index = max(range(len(parts)), key=lambda i: parts[i].excess)
    triangles, hull = parts[index].triangles, parts[index].hull
    points = np.unique(triangles.reshape(-1, 3), axis=0)
    # An edge of two triangles occurs twice, which changes no hull.
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 3)
    cuts = []
    main = np.linalg.eigh(np.cov(points.T))[1].T
    for axis in (*np.eye(3), *main[np.abs(main).max(axis=1) < ALIGNED]):
        level = hull.points[hull.vertices] @ axis
        for share in CUTS:
            height = float(level.min() + share * np.ptp(level))
            cuts.append((_cut_volume(points, edges, axis, height), axis, height))
    _, axis, height = min(cuts, key=lambda cut: cut[0])
    cut = _clip(triangles, -axis, -height), _clip(triangles, axis, height)
    halves = [measure.part(half) for half in cut]
    good = [half for half in halves if half is not None]
    if len(good) < 2:
        return parts
    return [*parts[:index], *good, *parts[index + 1 :]]


def _hull(points: Array) -> Any:
    """Convex hull of points; None if they have no volume, or are a nanometre apart."""
    check()
    try:
        return ConvexHull(points) if np.ptp(points, axis=0).max() > 1e-9 else None
    except (QhullError, ValueError):  # points in a plane, or too few points
        return None


def _cut_volume(points: Array, edges: Array, axis: Array, height: float) -> float:
    """Volume of the hulls of both sides of a cut; infinite if one is flat."""
    level, ends = points @ axis - height, edges @ axis - height
    crossing = ends[:, 0] * ends[:, 1] < 0.0
    one, other = edges[crossing, 0], edges[crossing, 1]
    share = ends[crossing, 0] / (ends[crossing, 0] - ends[crossing, 1])
    seam = one + share[:, None] * (other - one)
    volume = 0.0
    for side in (level >= 0.0, level <= 0.0):
        hull = _hull(np.concatenate([points[side], seam]))
        volume += np.inf if hull is None else float(hull.volume)
    return volume


def _clip(triangles: Array, normal: Array, height: float) -> Array:
    """The parts of triangles beyond a plane, as triangles, shape (l, 3, 3)."""
    above = triangles @ normal - height
    inside = np.sum(above >= 0.0, axis=1)
    parts = [triangles[inside == 3]]
    for count in (1, 2):
        chosen = np.flatnonzero(inside == count)
        # Rotate the corner that is alone on its side of the plane to the front.
        alone = (above[chosen] >= 0.0) == (count == 1)
        order = (np.argmax(alone, axis=1)[:, None] + np.arange(3)) % 3
        rows = np.arange(chosen.size)[:, None]
        corner = triangles[chosen][rows, order]
        value = above[chosen][rows, order]
        first, second, third = np.swapaxes(corner, 0, 1)
        share = value[:, :1] / (value[:, :1] - value[:, 1:])
        seam = first[:, None] + share[..., None] * (corner[:, 1:] - first[:, None])
        p, q = np.swapaxes(seam, 0, 1)
        if count == 1:
            parts.append(np.stack([first, p, q], axis=1))
        else:
            parts.append(np.stack([p, second, third], axis=1))
            parts.append(np.stack([p, third, q], axis=1))
    return np.concatenate(parts)


class Measure:
    """Distances between convex hulls and a mesh, on sample points.

    Args:
        mesh: The mesh, for Coal.
        triangles: Triangles of the mesh, shape (k, 3, 3) [m].
    """

    def __init__(self, mesh: Any, triangles: Array) -> None:
        # Keep references, as Coal does not keep its arguments alive.
        self._shapes = mesh, coal.Sphere(1e-9)
        self._distance = coal.ComputeDistance(*self._shapes)
        # Corners by corner, axis and triangle, shape (3, 3, k); normals, shape (3, k).
        self._corners = np.ascontiguousarray(triangles.transpose(1, 2, 0))
        first, second, third = self._corners
        self._normals = np.cross(second - first, third - first, axis=0)
        self._rng = np.random.default_rng(0)

    def part(self, triangles: Array) -> _Part | None:
        """Part of a mesh from its triangles; None if the triangles are flat."""
        hull = _hull(triangles.reshape(-1, 3))
        if hull is None:
            return None
        return _Part(triangles, hull, self._outward(hull))

    def _outward(self, hull: Any) -> float:
        """Largest distance to the mesh of sample points on a hull, outside the mesh."""
        points = self._sample(hull.points[hull.simplices])
        away = self._to_mesh(points)
        for index in np.argsort(-away).tolist():
            check()
            if away[index] <= TOUCHING or not self._inside(points[index]):
                return float(away[index])
        return 0.0

    def _sample(self, triangles: Array) -> Array:
        """Points uniformly distributed on triangles, shape (SAMPLES, 3) [m]."""
        a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        chosen = self._rng.choice(len(area), SAMPLES, p=area / area.sum())
        share = self._rng.uniform(size=(SAMPLES, 2, 1))
        share = np.where(share.sum(axis=1, keepdims=True) > 1.0, 1.0 - share, share)
        along = share[:, 0] * (b - a)[chosen] + share[:, 1] * (c - a)[chosen]
        return np.asarray(a[chosen] + along)

    def _to_mesh(self, points: Array) -> Array:
        """Distances of points from the surface of the mesh, shape (k,) [m]."""
        request, origin = coal.DistanceRequest(), coal.Transform3s.Identity()
        place = coal.Transform3s.Identity()
        out = np.empty(len(points))
        for i, point in enumerate(points):
            check()
            place.setTranslation(point)
            result = coal.DistanceResult()
            out[i] = self._distance(origin, place, request, result)
        return np.maximum(out, 0.0)

    def _inside(self, point: Array) -> bool:
        """Whether a point is inside the mesh, by the solid angle of the surface.

        Seen from a point inside, the solid angle is nearly 4 pi, even if the mesh has
        small holes (Jacobson, Kavan and Sorkine-Hornung, 2013).
        """
        seen = self._corners - point[:, None]
        la, lb, lc = np.sqrt(np.einsum("cik,cik->ck", seen, seen))
        ab, bc, ca = np.einsum("cik,cik->ck", seen, seen[[1, 2, 0]])
        volume = np.einsum("ik,ik->k", seen[0], self._normals)
        angle = np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
        return bool(abs(np.sum(angle)) > np.pi)
