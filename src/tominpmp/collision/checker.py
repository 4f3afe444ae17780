"""Distances of the links of a robot to obstacles and to each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, fields, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import coal
import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.checks import JOINTS, vector
from tominpmp.collision.bodies import Geometry, scene_bodies
from tominpmp.collision.broad import Pairs
from tominpmp.collision.narrow import Guard
from tominpmp.collision.placements import MovingObstacles
from tominpmp.collision.query import PairDistances
from tominpmp.collision.selection import link_bodies, own_pairs, scene_pairs, without
from tominpmp.collision.shapes import Body, is_convex
from tominpmp.exceptions import SceneError
from tominpmp.robot.robot import Robot
from tominpmp.scene.scene import Scene
from tominpmp.stopping import check

# Radius of the ball that represents a point [m].
POINT = 1e-6
# Tolerated overlap, as by default in the verification [m].
TOUCHING = 1e-5


class Contact(NamedTuple):
    """A collision pair and its distance, for example the closest pair.

    Attributes:
        link: Name of the link.
        obstacle: Name of the other body.
        distance: Signed distance [m].
        own: Whether the other body is a link of the robot, or of a combined robot.
        margin: Distance to keep [m].
    """

    link: str
    obstacle: str
    distance: float
    own: bool = False
    margin: float = 0.0

    @property
    def lack(self) -> float:
        """Missing clearance [m]; negative if the margin is kept."""
        return self.margin - self.distance

    @property
    def pair(self) -> str:
        """Description of the pair for messages."""
        if self.own:
            return f"links {self.link!r} and {self.obstacle!r}"
        return f"link {self.link!r} and obstacle {self.obstacle!r}"

    def __str__(self) -> str:
        """The pair with its overlap, or with its distance and margin."""
        if self.distance < 0.0:
            return f"{self.pair} overlap by {-self.distance:.4g} m"
        apart = f"{self.pair} are {self.distance:.4g} m apart"
        return f"{apart}, less than the margin {self.margin:.4g} m"


@dataclass(eq=False)
class CollisionChecker(PairDistances):
    """Distances of the links of a robot to the obstacles of a scene and to each other.

    Without obstacles the collision pairs are set up when they are first used, as the
    decomposition of meshes may take long.

    Attributes:
        robot: The robot.
        scene: The obstacles.
        self_collision: Whether pairs of links, and pairs of links and bodies fixed to
            the base, are checked.
        geometry: Representation of the meshes of the links: "convex" for convex pieces,
            "hull" for one convex hull each, "mesh" for their triangles, which is slow
            and gives no depth of overlaps.
        cut: Names of the links whose meshes have this representation; None for all
            links. The meshes of other links are represented by one convex hull each,
            with which distances are never larger, and are not decomposed.
        may_touch: Pairs of names of bodies that are not checked.

    Raises:
        SceneError: If there are obstacles, but no collision geometry on moving links.
    """

    robot: Robot
    scene: Scene
    _: KW_ONLY
    self_collision: bool = False
    geometry: Geometry = "convex"
    cut: frozenset[str] | None = None
    may_touch: frozenset[frozenset[str]] = frozenset()

    def __post_init__(self) -> None:
        """Check that moving links have geometry; with obstacles, set up the pairs."""
        robot, scene = self.robot, self.scene
        shapes = robot.collision_model.geometryObjects
        if len(scene) and not any(item.parentJoint for item in shapes):
            raise SceneError(
                f"the robot {robot.name!r} has no collision geometry on its moving "
                "links, so that its clearance from the scene is unknown"
            )
        self.obstacles = MovingObstacles(scene.moving, robot.model.njoints)
        self._guard: tuple[bytes, Guard] | None = None
        self._variants: dict[frozenset[str], CollisionChecker] = {}
        if len(scene):
            _ = self.broad, self.narrow  # set up now, as every plan uses them

    @cached_property
    def links(self) -> tuple[Body, ...]:
        """Bodies of the links; empty if no pairs are checked."""
        if not (self.self_collision or len(self.scene)):
            return ()
        return link_bodies(self.robot, self.geometry, self.cut)

    @cached_property
    def watched(self) -> tuple[Sequence[Body], Pairs]:
        """Bodies of links and obstacles, and their collision pairs."""
        bodies = [*self.links, *scene_bodies(self.scene, self.robot.model.njoints)]
        pairs = scene_pairs(bodies, len(self.links))
        if self.self_collision:
            own = own_pairs(self.robot, self.geometry, self.cut)
            pairs = np.concatenate([pairs, own])
        return bodies, without(self.may_touch, bodies, pairs)

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        """Pickle without the geometry, which is rebuilt when it is used."""
        arguments = {item.name: getattr(self, item.name) for item in fields(self)}
        return partial(CollisionChecker, **arguments), ()

    @property
    def single_arm(self) -> bool:
        """Whether it checks only the links of a single robot, as convex pieces."""
        single = not len(self.scene) and len(self.robot.parts) <= 1
        pieces = self.geometry == "convex" and self.cut is None
        return single and pieces and self.self_collision

    def with_cut(self, cut: frozenset[str]) -> CollisionChecker:
        """The checker with some links decomposed into pieces, and hulls of others."""
        if cut not in self._variants:
            self._variants[cut] = replace(self, cut=cut)
        return self._variants[cut]

    def hulls_clear(self, q: Array, margin: float = 0.0) -> bool:
        """Whether the links of a single robot are clear even as one hull each.

        In this case they are clear as convex pieces, too, and need no decomposition.
        False does not imply a collision.

        Args:
            q: Configuration, shape (n,) [rad or m].
            margin: Distance to exceed [m].
        """
        return self.single_arm and self.with_cut(frozenset()).is_free(q, margin)

    @cached_property
    def obstacle_pairs(self) -> int:
        """Number of pairs with obstacles."""
        return int(np.count_nonzero(self.broad.second >= len(self.links)))

    @property
    def moving(self) -> bool:
        """Whether obstacles move, so that distances depend on time."""
        return self.obstacles.count > 0

    @cached_property
    def single_joints(self) -> IntArray:
        """The only joint on which the distance of each pair depends, shape (pairs,).

        An example is the first link of an arm with an obstacle at rest. The entry is -1
        if the distance depends on no joint, on several joints, or on time.
        """
        moves = self._moves
        if self.robot.expansion_matrix is not None:
            moves = moves @ (self.robot.expansion_matrix != 0.0)
        single = (moves.sum(axis=1) == 1) & ~self.moving_pairs
        return np.where(single, np.argmax(moves, axis=1), -1)

    def is_free(self, q: Array, margin: float | Array = 0.0, time: float = 0.0) -> bool:
        """Whether all pairs are farther apart than a margin at one configuration.

        The result agrees with the distances, and is ten times faster: the query ends at
        the first pair that violates its margin.

        Args:
            q: Configuration, shape (n,) [rad or m].
            margin: Distance to keep [m], a number for all pairs or an array by pair.
            time: Time [s], for moving obstacles.
        """
        q = vector(q, "q", JOINTS, self.robot.n)
        return next(self.each_free(q[None], margin, time))

    def each_free(
        self, q: Array, margin: float | Array = 0.0, time: float = 0.0
    ) -> Iterator[bool]:
        """Results of :meth:`is_free` for several configurations, evaluated lazily.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            margin: Distance to keep [m], a number for all pairs or an array by pair.
            time: Time [s], for moving obstacles.

        Yields:
            Whether each configuration is free.
        """
        check()
        rows = self.robot.expand(q)
        # A sampler calls this tens of thousands of times with the same margin.
        limit = self._by_pair(margin, "margin")
        guard = self._guard
        if guard is None or guard[0] != limit.tobytes():
            guard = self._guard = limit.tobytes(), Guard(self.narrow, limit)
        R, p = self.obstacles.placements(np.array([time]))
        for row in rows:
            yield guard[1].is_free(row, R[0], p[0])

    def margins(self, margin: float) -> Array:
        """Margin of each pair, shape (pairs,) [m].

        The given margin is for pairs with obstacles and pairs of links of different
        combined robots; the margin between links of the same robot is zero.
        """
        out = np.zeros(len(self.pairs))
        out[: self.obstacle_pairs] = margin
        parts = self.robot.parts
        for index in range(self.obstacle_pairs, len(out) if parts else 0):
            one, other = (name.partition("/")[0] for name in self.pairs[index])
            if one != other and one in parts and other in parts:
                out[index] = margin
        return out

    def contacts(
        self, q: Array, margin: float | Array = 0.0, time: float | None = 0.0
    ) -> Iterator[Contact]:
        """The pairs at one configuration, those with the least clearance first.

        Args:
            q: Configuration, shape (n,) [rad or m].
            margin: Distance to keep [m], which is subtracted from the distances; a
                number for all pairs or an array by pair.
            time: Time [s], for moving obstacles; None gives their pairs an infinite
                distance.
        """
        if not self.pairs:
            return
        q = vector(q, "q", JOINTS, self.robot.n)
        row = self.distances(q[None], times=np.array([time or 0.0]))[0]
        if time is None:
            row = np.where(self.moving_pairs, np.inf, row)
        limit = self._by_pair(margin, "margin")
        for index in np.argsort(row - limit, kind="stable").tolist():
            yield self.contact(index, float(row[index]), float(limit[index]))

    def closest(
        self, q: Array, margin: float | Array = 0.0, time: float | None = 0.0
    ) -> Contact | None:
        """The first of :meth:`contacts`; None without pairs."""
        return next(self.contacts(q, margin, time), None)

    def contact(self, index: int, distance: float, margin: float) -> Contact:
        """The contact of a pair, from its distance and the distance to keep [m]."""
        own = index >= self.obstacle_pairs
        return Contact(*self.pairs[index], distance, own=own, margin=margin)


def enclosure(
    checker: CollisionChecker, frame: str, point: Array, tolerance: float
) -> Contact | None:
    """Obstacle that a link certainly overlaps when a frame is at a point.

    The nearest point of the link is at a known distance from the frame. If a ball of
    this radius around the point is inside an obstacle, the link overlaps the obstacle
    in every orientation. Moving obstacles, and pairs that are not checked, are ignored.

    Args:
        checker: Collision checker with the robot, the obstacles and the pairs.
        frame: Name of the frame.
        point: The point in the world, shape (3,) [m].
        tolerance: Largest distance of the frame from the point [m].

    Returns:
        Link and obstacle, with the depth of the point in the obstacle as a negative
        distance; None if no overlap is certain.
    """
    item = checker.robot.model.frames[checker.robot.frame_id(frame)]
    origin = np.asarray(item.placement.translation)
    away = {
        i: max(_distance(body, origin), 0.0)
        for i, body in enumerate(checker.links)
        if body.joint == item.parentJoint and is_convex(body.shape)
    }
    nearest: dict[int, int] = {}
    bodies, pairs = checker.watched
    for link, other in pairs[: checker.obstacle_pairs].tolist():
        if link in away and away[link] < away.get(nearest.get(other, -1), np.inf):
            nearest[other] = link
    for other, link in nearest.items():
        body = bodies[other]
        if body.joint or not is_convex(body.shape):
            continue
        depth = -_distance(body, point)
        if depth > away[link] + tolerance + TOUCHING:
            return Contact(bodies[link].name, body.name, -depth)
    return None


def _distance(body: Body, point: Array) -> float:
    """Signed distance of a point from a body [m]."""
    ball, at = coal.Sphere(POINT), coal.Transform3s(np.eye(3), np.asarray(point))
    place = coal.Transform3s(body.placement.rotation, body.placement.translation)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    distance = coal.distance(ball, at, body.shape, place, request, result)
    return float(distance) + POINT
