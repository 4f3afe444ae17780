"""Assembly of a collision checker: bodies, pairs and the queries for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.collision.bodies import Body, Geometry, scene_bodies
from tominpmp.collision.broad import BroadPhase
from tominpmp.collision.moving_obstacles import MovingObstacles
from tominpmp.collision.narrow import NarrowPhase
from tominpmp.collision.placements import Placements
from tominpmp.collision.query import DistanceQuery
from tominpmp.collision.selection import links_of, own_pairs, scene_pairs
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
        obstacles: MovingObstacles,
        self_collision: bool,
        geometry: Geometry,
        cut: frozenset[str] | None,
        may_touch: frozenset[frozenset[str]] = frozenset(),
    ) -> Assembly:
        """Put it together; see :class:`~tominpmp.collision.CollisionChecker`."""
        watching = self_collision or len(scene)
        links = links_of(robot, geometry, cut) if watching else ()
        bodies = [*links, *scene_bodies(scene, obstacles.first)]
        first, second = _parted(*scene_pairs(bodies, len(links)), bodies, may_touch)
        obstacle_pairs = int(first.size)
        if self_collision:
            own = _parted(*own_pairs(robot, geometry, cut), bodies, may_touch)
            first = np.concatenate([first, own[0]])
            second = np.concatenate([second, own[1]])
        pairs = tuple(
            (bodies[i].name, bodies[k].name)
            for i, k in zip(first.tolist(), second.tolist(), strict=True)
        )
        narrow = NarrowPhase(robot.model, bodies, first, second, obstacles)
        query = DistanceQuery(
            Placements(robot.model),
            BroadPhase(bodies, first, second),
            narrow,
            obstacles,
        )
        joint = np.array([body.joint for body in bodies], dtype=np.int64)
        return cls(links, pairs, obstacle_pairs, first, second, joint, narrow, query)

    @property
    def moves(self) -> BoolArray:
        """Which coordinates of the model change the distance of each pair.

        Those that move one of its bodies and not the other, shape (pairs, nv).
        """
        by_joint = self.query.placements.moves
        joint = np.where(self.joint < self.query.obstacles.first, self.joint, 0)
        by_body = by_joint[joint]
        return np.asarray(by_body[self.first] != by_body[self.second])

    def witnesses(
        self, rows: Array, instants: IntArray, pairs: IntArray, times: Array
    ) -> tuple[Array, Array]:
        """Normals and witness points of pairs at instants of configurations.

        Returns:
            Unit normals from the first body to the second, shape (k, 3), and the
            points on both [m], shape (2, k, 3), in the world.
        """
        k = len(pairs)
        normal, points = np.empty((k, 3)), np.empty((2, k, 3))
        order = np.argsort(instants, kind="stable")
        starts = np.flatnonzero(np.diff(instants[order], prepend=-1))
        for chosen in np.split(order, starts[1:]) if k else []:
            instant = instants[chosen[0]]
            self.narrow.place(rows[instant], float(times[instant]))
            found = self.narrow.witnesses(pairs[chosen].tolist())
            normal[chosen] = found.normal
            points[0, chosen], points[1, chosen] = found.first, found.second
        return normal, points

    def derivatives(
        self, rows: Array, instants: IntArray, pairs: IntArray, times: Array
    ) -> tuple[Array, Array]:
        """As the checker's, by the coordinates of the model, shape (k, nv)."""
        obstacles = self.query.obstacles
        normal, points = self.witnesses(rows, instants, pairs, times)
        placements = self.query.placements
        R, t = placements.joints(rows)
        placed = R[instants], t[instants]
        out = np.zeros((len(pairs), rows.shape[1]))
        for bodies, point, sign in (
            (self.first, points[0], -1.0),
            (self.second, points[1], 1.0),
        ):
            joint = self.joint[bodies[pairs]]
            joint = np.where(joint < obstacles.first, joint, 0)
            out += sign * placements.jacobian_rows(placed, joint, point, normal)
        other = self.joint[self.second[pairs]]
        return out, obstacles.approach(other, times[instants], points[1], normal)

    def obstacle_speeds(self, begin: Array, end: Array) -> Array:
        """As the checker's."""
        obstacles = self.query.obstacles
        out = np.zeros((begin.size, len(self.pairs)))
        moving = np.flatnonzero(self.joint[self.second] >= obstacles.first)
        if moving.size:
            linear, angular = obstacles.speeds(begin, end)
            body = self.second[moving]
            number = self.joint[body] - obstacles.first
            farthest = self.query.broad.farthest[body]
            out[:, moving] = linear[:, number] + angular[:, number] * farthest
        return out


def _parted(
    first: IntArray,
    second: IntArray,
    bodies: Sequence[Body],
    may_touch: frozenset[frozenset[str]],
) -> tuple[IntArray, IntArray]:
    """Pairs without those that may touch."""
    if not may_touch:
        return first, second
    kept = np.array(
        [
            frozenset((bodies[i].name, bodies[k].name)) not in may_touch
            for i, k in zip(first.tolist(), second.tolist(), strict=True)
        ],
        dtype=bool,
    )
    return first[kept], second[kept]
