"""What a checker of distances is made of: bodies, pairs and the queries for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import IntArray
from tominpmp.collision.bodies import Body, Geometry, scene_bodies
from tominpmp.collision.bounds import BroadPhase
from tominpmp.collision.movers import Movers
from tominpmp.collision.narrow import NarrowPhase
from tominpmp.collision.placements import Placements
from tominpmp.collision.query import DistanceQuery
from tominpmp.collision.selection import links_of, own_pairs, scene_pairs
from tominpmp.collision.shapes import is_convex
from tominpmp.robot import Robot
from tominpmp.scene import Scene


@dataclass(frozen=True, eq=False)
class Assembly:
    """Bodies and pairs of a checker, with their queries.

    Attributes:
        links: Shapes of the links.
        pairs: Names (link, other) of the pairs, first those with obstacles.
        obstacle_pairs: How many of them are with obstacles.
        first: First body of each pair, shape (pairs,).
        second: Second body of each pair, shape (pairs,).
        joint: What carries each body, shape (bodies,).
        narrow: Exact distances.
        query: Bounds where they will do, else exact distances.
    """

    links: tuple[Body, ...]
    pairs: tuple[tuple[str, str], ...]
    obstacle_pairs: int
    first: IntArray
    second: IntArray
    joint: IntArray
    narrow: NarrowPhase
    query: DistanceQuery

    @classmethod
    def of(
        cls,
        robot: Robot,
        scene: Scene,
        movers: Movers,
        self_collision: bool,
        geometry: Geometry,
        cut: frozenset[str] | None,
    ) -> Assembly:
        """Put it together; see :class:`~tominpmp.collision.CollisionChecker`."""
        watching = self_collision or len(scene)
        links = links_of(robot, geometry, cut) if watching else ()
        bodies = [*links, *scene_bodies(scene, movers.first)]
        first, second = scene_pairs(bodies, len(links))
        obstacle_pairs = int(first.size)
        if self_collision:
            own = own_pairs(robot, geometry, cut)
            first = np.concatenate([first, own[0]])
            second = np.concatenate([second, own[1]])
        pairs = tuple(
            (bodies[i].name, bodies[k].name)
            for i, k in zip(first.tolist(), second.tolist(), strict=True)
        )
        narrow = NarrowPhase(robot.model, bodies, first, second, movers)
        query = DistanceQuery(
            robot,
            Placements(robot.model),
            BroadPhase(bodies, first, second),
            narrow,
            np.array([is_convex(body.shape) for body in bodies], dtype=bool),
            movers,
        )
        joint = np.array([body.joint for body in bodies], dtype=np.int64)
        return cls(links, pairs, obstacle_pairs, first, second, joint, narrow, query)
