"""Broad phase: lower bounds of distances from balls and boxes around bodies.

Every bound is rigorous: the balls and boxes contain their bodies. Most pairs stay far
apart throughout a motion. Bounds at a few configurations, and on the displacements
between these and the other configurations, prove this; only for the remaining pairs,
bounds are computed at each configuration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray
from tominpmp.collision.shapes import Body, outline
from tominpmp.stopping import check

# Successive configurations between which no ball moves farther than this [m] form a
# group. Grouping does not pay for fewer configurations than the second number.
TOGETHER, FEWEST = 0.06, 24
# Number of pairs whose bounds are computed at once, which limits the memory.
SOME_PAIRS = 1_000
# Rounding of a bound for grouped configurations [m], and of radii, as a factor.
ROUNDING, ROUNDED = 1e-9, 1.0 + 1e-12

# Placements joint_to_world of joints and moving obstacles: rotations, shape
# (m, joints, 3, 3), and positions, shape (m, joints, 3) [m].
Joints = tuple[Array, Array]
# First and second body of each pair, shape (pairs, 2).
Pairs = IntArray
# Number of balls that cover a body, side by side along its longest axis. With four, the
# bounds for links of a Panda are 1 to 6 cm below the distances.
BALLS = 4


@dataclass(frozen=True, eq=False)
class BoundingVolumes:
    """A box and balls around a body, in the axes of the box.

    Attributes:
        R: Rotation box_to_body, shape (3, 3).
        t: Centre of the box in the axes of the body [m], shape (3,).
        half: Half the edge lengths of the box [m], shape (3,).
        swell: Radius by which the box is inflated [m].
        radius: Radius of a ball around the body, with the centre of the box [m].
        centres: Centres of BALLS balls that together cover the body [m], shape
            (BALLS, 3).
        cover: Radius of each of these balls [m].
    """

    R: Array
    t: Array
    half: Array
    swell: float
    radius: float
    centres: Array
    cover: float

    @classmethod
    def of(cls, points: Array, radius: float) -> BoundingVolumes:
        """Enclosure of points, shape (k, 3), whose hull is inflated by a radius [m]."""
        return _enclose(np.ascontiguousarray(points).tobytes(), radius)


# Cached, as enclosures depend on outlines alone and the same links recur in problems.
@lru_cache(maxsize=512)
def _enclose(data: bytes, swell: float) -> BoundingVolumes:
    check()
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
    # The balls cover the slices of a cylinder around the body, along its longest axis.
    along, step = np.eye(3)[int(np.argmax(half))], half.max() / BALLS
    places = step * (2.0 * np.arange(BALLS) + 1.0 - BALLS)
    both = (inside, inside * (1.0 - along))
    radius, across = (np.max(np.linalg.norm(x, axis=1)) * ROUNDED for x in both)
    balls = radius + swell, places[:, None] * along, np.hypot(across, step) + swell
    return BoundingVolumes(R, R @ middle, half, swell, *balls)


class BroadPhase:
    """Lower bounds of the distances of pairs at many configurations at once.

    Attributes:
        first: First body of each pair, shape (pairs,).
        second: Second body of each pair, shape (pairs,).
        joint: Joint that carries each body, shape (bodies,).
        centre: Centre of a ball around each body in the axes of its joint [m], shape
            (bodies, 3).
        radius: Radius of this ball [m], shape (bodies,).
        farthest: Upper bound on the distance of the points of each body from the origin
            of its joint [m], shape (bodies,).
    """

    def __init__(self, bodies: Sequence[Body], pairs: Pairs) -> None:
        self.first, self.second = pairs.T.copy()
        found = [BoundingVolumes.of(*outline(body.shape)) for body in bodies]
        boxes = [
            body.placement * pin.SE3(item.R, item.t)
            for body, item in zip(bodies, found, strict=True)
        ]
        self.joint = np.array([body.joint for body in bodies], dtype=np.int64)
        self._half = np.array([item.half for item in found]).reshape(-1, 3)
        self._swell = np.array([item.swell for item in found])
        # Boxes and balls in the axes of their joints.
        self._R = np.array([box.rotation for box in boxes]).reshape(-1, 3, 3)
        self.centre = np.array([box.translation for box in boxes]).reshape(-1, 3)
        self.radius = np.array([item.radius for item in found])
        self._cover_radius = np.array([item.cover for item in found])
        centres = np.array([item.centres for item in found]).reshape(-1, BALLS, 3)
        self._cover = self.centre[:, None] + centres @ np.swapaxes(self._R, 1, 2)
        self._origin = np.einsum("bij,bi->bj", self._R, self.centre)
        self.farthest = self.radius + np.linalg.norm(self.centre, axis=1)
        fixed = self.joint[self.second] == 0
        self._fixed, self._moving = np.flatnonzero(fixed), np.flatnonzero(~fixed)
        self._carried = [
            (int(joint), np.flatnonzero(self.joint == joint))
            for joint in np.unique(self.joint[self.joint > 0])
        ]

    def by_balls(self, joints: Joints) -> Array:
        """Bounds from a ball around the first body and a box around the second.

        Returns:
            Shape (m, pairs) [m].
        """
        every = np.arange(self.first.size)
        return self._bounds(joints, self._centres(joints), every)

    def below(self, joints: Joints, limit: Array) -> tuple[Array, IntArray, IntArray]:
        """Bounds, and the configurations and pairs at which they are below a limit.

        Args:
            joints: Placements of the joints.
            limit: Limit of each pair, shape (pairs,) [m].

        Returns:
            Bounds, shape (m, pairs) [m], and the configuration and the pair of each
            bound below its limit, in this order. Bounds below their limits are the
            bounds of ``by_balls``; other bounds may be lower than these, but not below
            the limits.
        """
        centre = self._centres(joints)
        least = self._grouped(joints, centre)
        out, some = np.tile(least, (centre.shape[1], 1)), np.flatnonzero(least < limit)
        bounds = self._bounds(joints, centre, some)
        out[:, some] = bounds
        instant, place = np.nonzero(bounds < limit[some])
        return out, instant, some[place]

    def _centres(self, joints: Joints) -> Array:
        """Centres of balls around moving bodies in the world, (bodies, m, 3) [m]."""
        R, t = joints
        out = np.zeros((self.joint.size, t.shape[0], 3))
        for joint, bodies in self._carried:
            turned = R[:, joint] @ self.centre[bodies].T
            turned += t[:, joint, :, None]
            out[bodies] = turned.transpose(2, 0, 1)
        return out

    def _grouped(self, joints: Joints, centre: Array) -> Array:
        """Bounds that hold at all configurations, from groups of them, (pairs,) [m].

        They are infinitely low if the configurations are too few, or too far apart.

        Args:
            joints: Placements of the joints.
            centre: Centres of the balls around the bodies, shape (bodies, m, 3) [m].
        """
        m, useless = centre.shape[1], np.full(self.first.size, -np.inf)
        if m < FEWEST or not useless.size:
            return useless
        step = np.diff(centre, axis=1)
        way = np.zeros(m)
        squared = np.einsum("bmi,bmi->bm", step, step)
        np.cumsum(np.sqrt(np.max(squared, axis=0)), out=way[1:])
        begin = np.flatnonzero(np.diff(np.floor(way / TOGETHER), prepend=-1.0))
        if 2 * begin.size > m:
            return useless
        last = np.append(begin[1:], m) - 1
        middle = (begin + last) // 2
        centres = centre[:, middle]
        out = np.empty((middle.size, self.first.size))
        R, t = joints
        placed = R[middle], t[middle]
        out[:, self._fixed] = self._bounds(placed, centres, self._fixed)
        a, b = self.first[self._moving], self.second[self._moving]
        apart = np.linalg.norm(centres[a] - centres[b], axis=2) - self.radius[a, None]
        out[:, self._moving] = (apart - self.radius[b, None]).T
        moved = np.maximum(way[middle] - way[begin], way[last] - way[middle])
        out[:, self._fixed] -= moved[:, None] + ROUNDING
        out[:, self._moving] -= 2.0 * moved[:, None] + ROUNDING
        return np.asarray(np.min(out, axis=0))

    def _bounds(self, joints: Joints, centre: Array, pair: IntArray) -> Array:
        """Bounds of some pairs from balls and boxes, shape (m, k) [m]."""
        R, t = joints
        out = np.empty((centre.shape[1], pair.size))
        for begin in range(0, pair.size, SOME_PAIRS):
            check()
            some = slice(begin, begin + SOME_PAIRS)
            a, b = self.first[pair[some]], self.second[pair[some]]
            away, carrier = centre[a], self.joint[b]
            for joint in np.unique(carrier[carrier > 0]).tolist():
                mine = np.flatnonzero(carrier == joint)
                offset = away[mine] - t[:, joint]
                away[mine] = np.einsum("kmi,mij->kmj", offset, R[:, joint])
            length = self._from_boxes(away, b)
            out[:, some] = (length - (self.radius[a] + self._swell[b])[:, None]).T
        return out

    def _from_boxes(self, points: Array, body: IntArray) -> Array:
        """Distances of points from boxes around bodies, shape (k, s) [m].

        Args:
            points: Points in the axes of the joints of the bodies [m], (k, s, 3).
            body: Indices of the bodies, shape (k,).
        """
        away = points @ self._R[body]
        away -= self._origin[body][:, None]
        np.abs(away, out=away)
        away -= self._half[body][:, None]
        np.maximum(away, 0.0, out=away)
        return np.asarray(np.sqrt(np.einsum("ksi,ksi->ks", away, away)))

    def by_covers(self, joints: Joints, instant: IntArray, pair: IntArray) -> Array:
        """Bounds from the balls that cover the first body, shape (k,) [m].

        Args:
            joints: Placements of the joints.
            instant: Index of the configuration of each bound, shape (k,).
            pair: Index of the pair of each bound, shape (k,).
        """
        a, b = self.first[pair], self.second[pair]
        R, t = joints
        one, other = (instant, self.joint[a]), (instant, self.joint[b])
        centres = self._cover[a] @ np.swapaxes(R[one], 1, 2) + t[one][:, None]
        centres = (centres - t[other][:, None]) @ R[other]
        nearest = np.min(self._from_boxes(centres, b), axis=1)
        return np.asarray(nearest - self._cover_radius[a] - self._swell[b])
