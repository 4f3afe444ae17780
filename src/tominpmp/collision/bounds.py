"""Broad phase: lower bounds of distances from balls and boxes around bodies.

Every bound holds for certain: balls contain what they stand for, and so do the boxes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from tominpmp.arrays import Array, IntArray
from tominpmp.collision.bodies import Body
from tominpmp.collision.placements import BodyPlacements
from tominpmp.collision.shapes import Outline

# Balls that cover a body, side by side along its longest axis. Four leave 1 to 3 cm
# between bound and distance on the links of a Panda.
BALLS = 4
# Steps towards the centre of the smallest ball (Badoiu and Clarkson, 2003).
CENTRING = 12
# Points up to this number are connected with each other; of more, the hull is taken.
FEW = 24


@dataclass(frozen=True, eq=False)
class Enclosure:
    """A box and balls around a body, in the axes of the box.

    Attributes:
        R: Rotation box_to_body, shape (3, 3).
        t: Centre of the box in the axes of the body [m], shape (3,).
        half: Half of its edges [m], shape (3,).
        swell: Radius by which the box is swollen [m].
        centre: Centre of a ball around the body [m], shape (3,).
        radius: Its radius [m].
        cover: Centres of balls that cover the body [m], shape (BALLS, 3).
        cover_radius: Their radii [m], shape (BALLS,).
    """

    R: Array
    t: Array
    half: Array
    swell: float
    centre: Array
    radius: float
    cover: Array
    cover_radius: Array

    @classmethod
    def of(cls, shape: Outline) -> Enclosure:
        """Enclose what an outline encloses."""
        tight = _enclose(np.ascontiguousarray(shape.points).tobytes())
        swell = shape.radius
        return replace(
            tight,
            swell=swell,
            radius=tight.radius + swell,
            cover_radius=tight.cover_radius + swell,
        )


# Enclosures depend on the points alone, and the same links come again in every problem.
@lru_cache(maxsize=512)
def _enclose(data: bytes) -> Enclosure:
    points = np.frombuffer(data).reshape(-1, 3)
    centred = points - points.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1]
    plain, turned = np.ptp(points, axis=0), np.ptp(points @ axes, axis=0)
    R = np.eye(3)
    if np.prod(turned + 1e-3) < 0.95 * np.prod(plain + 1e-3):
        R = axes * np.linalg.det(axes)
    inside = points @ R
    middle = 0.5 * (inside.min(axis=0) + inside.max(axis=0))
    inside = inside - middle
    half = inside.max(axis=0)
    centre, radius = _ball(inside)
    longest = int(np.argmax(half))
    cuts = np.linspace(-half[longest], half[longest], BALLS + 1)
    balls = [_ball(part) for part in _slices(inside, longest, cuts)]
    return Enclosure(
        R,
        R @ middle,
        half,
        0.0,
        centre,
        radius,
        np.array([centre for centre, _ in balls]),
        np.array([radius for _, radius in balls]),
    )


def _slices(points: Array, axis: int, cuts: Array) -> list[Array]:
    """Corners of the slices of a convex hull between parallel planes."""
    first, second = _edges(points)
    a, b = points[first], points[second]
    rise = b[:, axis] - a[:, axis]
    parts = []
    for low, high in pairwise(cuts.tolist()):
        tiny = 1e-12 + 1e-9 * (cuts[-1] - cuts[0])
        level = points[:, axis]
        part = [points[(level >= low - tiny) & (level <= high + tiny)]]
        for cut in (low, high):
            crossing = (a[:, axis] - cut) * (b[:, axis] - cut) < 0.0
            share = (cut - a[crossing, axis]) / rise[crossing]
            part.append(a[crossing] + share[:, None] * (b - a)[crossing])
        parts.append(np.concatenate(part))
    return parts


def _edges(points: Array) -> tuple[IntArray, IntArray]:
    """Pairs of points among which are all edges of the convex hull."""
    if len(points) > FEW:
        try:
            simplices = ConvexHull(points).simplices
        except QhullError:  # flat
            simplices = None
        if simplices is not None:
            rolled = np.roll(simplices, 1, axis=1)
            return simplices.ravel(), rolled.ravel()
    first, second = np.triu_indices(len(points), 1)
    return first, second


def _ball(points: Array) -> tuple[Array, float]:
    """A small ball around points."""
    if not len(points):
        return np.zeros(3), 0.0
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    best, radius = centre, np.inf
    for step in range(CENTRING):
        distance = np.linalg.norm(points - centre, axis=1)
        far = int(np.argmax(distance))
        if distance[far] < radius:
            best, radius = centre, float(distance[far])
        centre = centre + (points[far] - centre) / (step + 8)
    return best, radius * (1.0 + 1e-12)


class BroadPhase:
    """Lower bounds of the distances of pairs at many configurations at once.

    Bodies are placed by the axes of the boxes around them.

    Attributes:
        first: First body of each pair, shape (pairs,).
        second: Second body of each pair, shape (pairs,).
        centre: Centre of a ball around each body [m], shape (bodies, 3).
        radius: Its radius [m], shape (bodies,).
        farthest: How far points of each body may be from the origin of what carries it
            [m], shape (bodies,).
    """

    def __init__(
        self, bodies: Sequence[Body], first: IntArray, second: IntArray
    ) -> None:
        self.first, self.second = first, second
        found = [Enclosure.of(body.outline) for body in bodies]
        self.centre = np.array([item.centre for item in found]).reshape(-1, 3)
        self.radius = np.array([item.radius for item in found])
        # No point of a body is farther than this from what carries it.
        self.farthest = self.radius + np.array(
            [
                np.linalg.norm(body.placement.act(item.R @ item.centre + item.t))
                for body, item in zip(bodies, found, strict=True)
            ]
        )
        self._half = np.array([item.half for item in found]).reshape(-1, 3)
        self._swell = np.array([item.swell for item in found])
        self._cover = np.array([item.cover for item in found]).reshape(-1, BALLS, 3)
        self._cover_radius = np.array([item.cover_radius for item in found])
        boxes = [
            body.placement * pin.SE3(item.R, item.t)
            for body, item in zip(bodies, found, strict=True)
        ]
        joint = np.array([body.joint for body in bodies], dtype=np.int64)
        self._bodies = BodyPlacements(joint, boxes)
        # What does not move is looked at from all links in one multiplication.
        fixed = joint[second] == 0
        self._fixed, self._moving = np.flatnonzero(fixed), np.flatnonzero(~fixed)
        self._links, row = np.unique(first[fixed], return_inverse=True)
        self._others, column = np.unique(second[fixed], return_inverse=True)
        self._cell: IntArray = (row * self._others.size + column).astype(np.int64)

    def place(self, joints: tuple[Array, Array]) -> tuple[Array, Array]:
        """Placements box_to_world, shapes (m, bodies, 3, 3) and (m, bodies, 3).

        From the placements of the joints, shapes (m, joints, 3, 3) and (m, joints, 3).
        """
        return self._bodies.place(joints)

    def by_balls(self, placed: tuple[Array, Array]) -> Array:
        """Bounds from a ball around the first body and a box around the second.

        Returns:
            Shape (m, pairs) [m].
        """
        R, t = placed
        out = np.empty((R.shape[0], self.first.size))
        if not out.size:
            return out
        if self._fixed.size:
            out[:, self._fixed] = self._from_fixed(R, t)
        if self._moving.size:
            a, b = self.first[self._moving], self.second[self._moving]
            away = t[:, a] - t[:, b]
            away += np.einsum("mbij,bj->mbi", R[:, a], self.centre[a])
            away = np.abs(np.einsum("mbij,mbi->mbj", R[:, b], away))
            away = np.maximum(away - self._half[b], 0.0)
            length = np.sqrt(np.einsum("mbi,mbi->mb", away, away))
            out[:, self._moving] = length - (self.radius[a] + self._swell[b])
        return out

    def _from_fixed(self, R: Array, t: Array) -> Array:
        """Bounds of the pairs with a body that does not move."""
        links, others = self._links, self._others
        turned = np.einsum("mbij,bj->mbi", R[:, links], self.centre[links])
        centre = (t[:, links] + turned).reshape(-1, 3)
        squared = np.zeros((centre.shape[0], others.size))
        for axis in range(3):
            across = R[0, others, :, axis]
            away = centre @ across.T
            away -= np.sum(across * t[0, others], axis=1)
            np.abs(away, out=away)
            away -= self._half[others, axis]
            np.maximum(away, 0.0, out=away)
            away *= away
            squared += away
        np.sqrt(squared, out=squared)
        squared -= self._swell[others]
        squared = squared.reshape(R.shape[0], links.size, others.size)
        squared -= self.radius[links][:, None]
        return np.take(squared.reshape(R.shape[0], -1), self._cell, axis=1)

    def by_covers(self, R: Array, t: Array, pair: IntArray) -> Array:
        """Bounds from several balls that cover the first body, shape (k,) [m].

        From the placements first_to_second, shapes (k, 3, 3) and (k, 3), of k pairs.
        """
        a, b = self.first[pair], self.second[pair]
        centres = self._cover[a] @ np.swapaxes(R, 1, 2) + t[:, None]
        beyond = np.maximum(np.abs(centres) - self._half[b, None], 0.0)
        away = np.sqrt(np.einsum("ksi,ksi->ks", beyond, beyond))
        nearest = np.min(away - self._cover_radius[a], axis=1)
        return np.asarray(nearest - self._swell[b])
