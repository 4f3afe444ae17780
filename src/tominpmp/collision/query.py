"""Distances of pairs at many configurations: bounds where they will do, else exact."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.collision.bodies import Body
from tominpmp.collision.broad import BroadPhase, Joints
from tominpmp.collision.narrow import NarrowPhase
from tominpmp.collision.placements import MovingObstacles, Placements


@dataclass
class Count:
    """How pairs were settled.

    Attributes:
        pairs: Pairs asked for.
        queries: Pairs that needed an exact query.
    """

    pairs: int = 0
    queries: int = 0


class DistanceQuery:
    """Pairs of bodies, and the steps from coarse bounds to their exact distances.

    Attributes:
        bodies: The bodies.
        first: First body of each pair, shape (pairs,).
        second: Second body of each pair, shape (pairs,).
        pairs: Names of both bodies of each pair.
        obstacles: Obstacles that move.
        placements: Forward kinematics.
        broad: Bounds from balls and boxes.
        narrow: Exact distances.
        count: How many queries there were.
    """

    def __init__(
        self,
        model: pin.Model,
        bodies: Sequence[Body],
        pairs: tuple[IntArray, IntArray],
        obstacles: MovingObstacles | None = None,
    ) -> None:
        """Make the queries for pairs (first bodies, second bodies)."""
        self.bodies, (self.first, self.second) = bodies, pairs
        self.pairs = tuple(
            (bodies[i].name, bodies[k].name)
            for i, k in zip(self.first.tolist(), self.second.tolist(), strict=True)
        )
        self.obstacles = obstacles or MovingObstacles((), model.njoints)
        self.placements = Placements(model)
        self.broad = BroadPhase(bodies, *pairs)
        self.narrow = NarrowPhase(model, bodies, *pairs, self.obstacles)
        self.count = Count()
        self._joint = np.array([body.joint for body in bodies], dtype=np.int64)

    @cached_property
    def moving_pairs(self) -> BoolArray:
        """Which pairs are with an obstacle that moves, shape (pairs,)."""
        return np.asarray(self._joint[self.second] >= self.obstacles.first)

    @property
    def moves(self) -> BoolArray:
        """Which coordinates of the model change the distance of each pair.

        Those that move one of its bodies and not the other, shape (pairs, nv).
        """
        one, other = (
            self.placements.moves[self._model_joint(bodies)]
            for bodies in (self.first, self.second)
        )
        return np.asarray(one != other)

    def _model_joint(self, bodies: IntArray) -> IntArray:
        """Joints of the model that carry bodies; 0, the world, for obstacles."""
        joint = self._joint[bodies]
        return np.where(joint < self.obstacles.first, joint, 0)

    def place(self, q_model: Array, times: Array | None = None) -> Joints:
        """Placements joint_to_world at configurations of the model, and times [s].

        Those of obstacles that move are beside them.
        """
        return self.obstacles.beside(self.placements.joints(q_model), times)

    def distances(
        self, q_model: Array, cutoff: float | Array, times: Array | None = None
    ) -> Array:
        """As the checker's, at configurations of the model, shape (m, nv)."""
        placed = self.place(q_model, times)
        limit = np.broadcast_to(np.asarray(cutoff, np.float64), self.first.shape)
        limit = np.maximum(limit, 0.0)  # bounds say nothing about depths
        lower, instant, pair = self.broad.near(placed, limit)
        self.count.pairs += lower.size - instant.size
        if not instant.size:
            return lower
        bound = lower[instant, pair]
        found = self.measured(q_model, placed, instant, pair, limit[pair], times)
        near = found < limit[pair]
        lower[instant, pair] = np.where(near, found, np.maximum(found, bound))
        return lower

    def measured(
        self,
        q_model: Array,
        placed: Joints,
        instant: IntArray,
        pair: IntArray,
        enough: Array,
        times: Array | None = None,
    ) -> Array:
        """As the checker's, at configurations of the model, shape (m, nv).

        With the placements there.
        """
        self.count.pairs += instant.size
        out = self.broad.by_covers(placed, instant, pair)
        # Bounds say nothing about depths.
        near = np.flatnonzero(out < np.maximum(enough, 0.0))
        self.count.queries += near.size
        exact = np.empty(near.size)
        for chosen, pairs in self._placed(q_model, instant[near], pair[near], times):
            exact[chosen] = self.narrow.distances(pairs)
        out[near] = exact
        return out

    def _placed(
        self, q_model: Array, instant: IntArray, pair: IntArray, times: Array | None
    ) -> Iterator[tuple[IntArray, list[int]]]:
        """Place the bodies at one configuration after the other.

        Yields:
            Which of the instants are the configuration, and the pairs at these.
        """
        order = np.argsort(instant, kind="stable")
        starts = np.flatnonzero(np.diff(instant[order], prepend=-1))
        groups = instant[order[starts]]
        when = np.zeros(groups.size) if times is None else times[groups]
        R, p = self.obstacles.placements(when)
        ends = [*starts[1:].tolist(), order.size]
        for k, (begin, end) in enumerate(zip(starts.tolist(), ends, strict=False)):
            self.narrow.place(q_model[groups[k]], float(when[k]), (R[k], p[k]))
            chosen = order[begin:end]
            yield chosen, pair[chosen].tolist()

    def witnesses(
        self, q_model: Array, instants: IntArray, pairs: IntArray, times: Array
    ) -> tuple[Array, Array]:
        """Normals and witness points of pairs at instants of configurations.

        Returns:
            Unit normals from the first body to the second, shape (k, 3), and the
            points on both [m], shape (2, k, 3), in the world.
        """
        normal, points = np.empty((len(pairs), 3)), np.empty((2, len(pairs), 3))
        for chosen, some in self._placed(q_model, instants, pairs, times):
            found = self.narrow.witnesses(some)
            normal[chosen] = found.normal
            points[0, chosen], points[1, chosen] = found.first, found.second
        return normal, points

    def derivatives(
        self, q_model: Array, instants: IntArray, pairs: IntArray, times: Array
    ) -> tuple[Array, Array]:
        """As the checker's, by the coordinates of the model, shape (k, nv)."""
        normal, points = self.witnesses(q_model, instants, pairs, times)
        R, t = self.placements.joints(q_model)
        placed = R[instants], t[instants]
        out = np.zeros((len(pairs), q_model.shape[1]))
        for bodies, point, sign in (
            (self.first, points[0], -1.0),
            (self.second, points[1], 1.0),
        ):
            joint = self._model_joint(bodies[pairs])
            out += sign * self.placements.jacobian_rows(placed, joint, point, normal)
        other = self._joint[self.second[pairs]]
        rates = self.obstacles.approach(other, times[instants], points[1], normal)
        return out, rates

    def obstacle_speeds(self, begin: Array, end: Array) -> Array:
        """As the checker's."""
        out = np.zeros((begin.size, self.first.size))
        moving = np.flatnonzero(self.moving_pairs)
        if moving.size:
            linear, angular = self.obstacles.speeds(begin, end)
            body = self.second[moving]
            number = self._joint[body] - self.obstacles.first
            farthest = self.broad.farthest[body]
            out[:, moving] = linear[:, number] + angular[:, number] * farthest
        return out
