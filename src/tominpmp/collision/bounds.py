"""Balls and boxes around bodies, which contain what they stand for for certain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from tominpmp.arrays import Array, IntArray
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
        return _enclose(np.ascontiguousarray(shape.points).tobytes(), shape.radius)


# Enclosures depend on outlines alone, and the same links come again in every problem.
@lru_cache(maxsize=512)
def _enclose(data: bytes, swell: float) -> Enclosure:
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
        swell,
        centre,
        radius + swell,
        np.array([centre for centre, _ in balls]),
        np.array([radius for _, radius in balls]) + swell,
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
