"""Distance queries at many configurations: bounds where they will do, else exact."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.collision.bounds import BroadPhase
from tominpmp.collision.moving_obstacles import MovingObstacles
from tominpmp.collision.narrow import NarrowPhase
from tominpmp.collision.placements import Placements
from tominpmp.robot import Robot
from tominpmp.stopping import check

# Taken off the bounds, for the tolerances of distances and normals [m].
SLACK = 2e-6


class References:
    """What exact queries have found: distances, and planes that part the bodies.

    All is in the axes of the second body of a pair, so that it does not matter which
    of the two moves. Few of the pairs are ever measured; the others take four bytes.

    Args:
        instants: Number of instants m.
        pairs: Number of pairs P.

    Attributes:
        slot: Where the findings of a pair at an instant stand, -1 for nowhere, shape
            (m, P).
        distance: Signed distances [m], shape (k,).
        normal: Normals of the planes, shape (k, 3); zero where there is none.
        centre: Centres of the first bodies [m], shape (k, 3).
        R: Rotations first_to_second, shape (k, 3, 3).
    """

    def __init__(self, instants: int, pairs: int) -> None:
        self.slot = np.full((instants, pairs), -1, dtype=np.int32)
        self.distance = np.empty(0)
        self.normal, self.centre = np.empty((0, 3)), np.empty((0, 3))
        self.R = np.empty((0, 3, 3))
        self._used = 0

    def remember(
        self,
        at: tuple[IntArray, IntArray],
        distance: Array,
        normal: Array,
        centre: Array,
        R: Array,
    ) -> None:
        """Keep what was found of pairs, shape (k,), at instants, shape (k,)."""
        slot = self.slot[at].astype(np.int64)
        fresh = np.flatnonzero(slot < 0)
        slot[fresh] = self._used + np.arange(fresh.size)
        self.slot[at] = slot
        self._used += fresh.size
        self._grow(self._used)
        self.distance[slot], self.normal[slot] = distance, normal
        self.centre[slot], self.R[slot] = centre, R

    def _grow(self, size: int) -> None:
        if size <= self.distance.size:
            return
        size = max(size, 2 * self.distance.size)
        for name in ("distance", "normal", "centre", "R"):
            old = getattr(self, name)
            new = np.empty((size, *old.shape[1:]))
            new[: len(old)] = old
            setattr(self, name, new)


@dataclass
class Count:
    """How pairs were settled.

    Attributes:
        pairs: Pairs asked for.
        queries: Pairs that needed an exact query.
    """

    pairs: int = 0
    queries: int = 0


@dataclass(frozen=True, eq=False)
class DistanceQuery:
    """The steps from coarse bounds to exact distances.

    Attributes:
        robot: The robot.
        placements: Its forward kinematics.
        broad: Bounds from balls and boxes.
        narrow: Exact distances.
        convex: Which bodies are convex, shape (bodies,).
        obstacles: Obstacles that move.
        count: How many queries there were.
    """

    robot: Robot
    placements: Placements
    broad: BroadPhase
    narrow: NarrowPhase
    convex: BoolArray
    obstacles: MovingObstacles
    count: Count = field(default_factory=Count)

    @property
    def pairs(self) -> int:
        """Number of pairs."""
        return int(self.broad.first.size)

    def place(self, q_model: Array, times: Array | None = None) -> tuple[Array, Array]:
        """Placements body_to_world at configurations of the model, and times [s]."""
        joints = self.placements.joints(q_model)
        return self.broad.place(self.obstacles.beside(joints, times))

    def distances(
        self,
        q_model: Array,
        placed: tuple[Array, Array],
        cutoff: Array,
        known: References,
        rows: IntArray,
        sources: IntArray,
        times: Array | None = None,
    ) -> Array:
        """Distances where they are below the cutoff, else lower bounds at least.

        Args:
            q_model: Configurations of the model, shape (m, nv).
            placed: Placements body_to_world there.
            cutoff: Distances beyond which a bound is enough [m], shape (pairs,).
            known: What former queries found; new findings are added.
            rows: Rows of ``known`` that belong to the configurations, shape (m,).
            sources: Rows of ``known`` to look at where there is nothing, shape (m,).
            times: Times [s], shape (m,), for obstacles that move; None for the start.

        Returns:
            Shape (m, pairs) [m].
        """
        cutoff = np.maximum(cutoff, 0.0)  # bounds say nothing about depths
        lower = self.broad.by_balls(placed)
        self.count.pairs += lower.size
        instant, pair = np.nonzero(lower < cutoff)
        if not instant.size:
            return lower
        R, t, centre = self._relative(placed, instant, pair)
        row = rows[instant]
        row = np.where(known.slot[row, pair] >= 0, row, sources[instant])
        bound = np.maximum(
            self.broad.by_covers(R, t, pair),
            self._by_planes(
                known, known.slot[row, pair].astype(np.int64), pair, R, centre
            ),
        )
        lower[instant, pair] = np.maximum(lower[instant, pair], bound)
        near = np.flatnonzero(bound < cutoff[pair])
        if not near.size:
            return lower
        instant, pair = instant[near], pair[near]
        self.count.queries += near.size
        distance, normal = self._exact(q_model, instant, pair, times)
        lower[instant, pair] = distance
        known.remember(
            (rows[instant], pair),
            distance,
            np.einsum(
                "kij,ki->kj", placed[0][instant, self.broad.second[pair]], normal
            ),
            centre[near],
            R[near],
        )
        return lower

    def measured(
        self,
        q_model: Array,
        placed: tuple[Array, Array],
        instant: IntArray,
        pair: IntArray,
        enough: Array,
        times: Array | None = None,
    ) -> Array:
        """Distances of single pairs at single instants.

        Args:
            q_model: Configurations of the model, shape (m, nv).
            placed: Placements body_to_world there.
            instant: Index of the configuration, shape (k,).
            pair: Index of the pair, shape (k,).
            enough: Distances from which on a lower bound will do, shape (k,) [m].
            times: Times [s], shape (m,), for obstacles that move; None for the start.

        Returns:
            Shape (k,) [m]; exact where below ``enough``.
        """
        self.count.pairs += instant.size
        R, t, _ = self._relative(placed, instant, pair)
        out = self.broad.by_covers(R, t, pair)
        # Bounds say nothing about depths.
        near = np.flatnonzero(out < np.maximum(enough, 0.0))
        near = near[np.argsort(instant[near], kind="stable")]
        if near.size:
            self.count.queries += near.size
            out[near] = self._exact(q_model, instant[near], pair[near], times)[0]
        return out

    def _relative(
        self, placed: tuple[Array, Array], instant: IntArray, pair: IntArray
    ) -> tuple[Array, Array, Array]:
        """First bodies in the axes of the second: rotation, position, centre."""
        a, b = self.broad.first[pair], self.broad.second[pair]
        R, t = placed
        second = R[instant, b]
        turned = np.swapaxes(second, 1, 2) @ R[instant, a]
        offset = np.einsum("kij,ki->kj", second, t[instant, a] - t[instant, b])
        middle = self.broad.centre[a]
        return turned, offset, offset + np.einsum("kij,kj->ki", turned, middle)

    def _by_planes(
        self,
        known: References,
        slot: IntArray,
        pair: IntArray,
        R: Array,
        centre: Array,
    ) -> Array:
        """Bounds from former distances and how far the first bodies have moved since.

        A plane that parted two convex bodies still parts them by as much as the first
        has not moved towards it; no point of it moves farther than its centre and the
        turning of a ball around it allow. Without a plane, any motion counts.
        """
        out = np.full(slot.size, -np.inf)
        old = np.flatnonzero(slot >= 0)
        slot, pair, R, centre = slot[old], pair[old], R[old], centre[old]
        normal, turn = known.normal[slot], R - known.R[slot]
        shift = centre - known.centre[slot]
        radius = self.broad.radius[self.broad.first[pair]]
        turned = np.einsum("kij,ki->kj", turn, normal)
        along = np.einsum("ki,ki->k", normal, shift)
        along += radius * np.sqrt(np.einsum("ki,ki->k", turned, turned))
        other = np.flatnonzero(np.einsum("ki,ki->k", normal, normal) < 0.5)
        chord = np.sqrt(0.5 * np.sum(turn[other] ** 2, axis=(1, 2)))
        along[other] = np.linalg.norm(shift[other], axis=1) + radius[other] * chord
        out[old] = known.distance[slot] - along - SLACK
        return out

    def _exact(
        self, q_model: Array, instant: IntArray, pair: IntArray, times: Array | None
    ) -> tuple[Array, Array]:
        distances: list[float] = []
        normals: list[Array] = []
        starts = np.flatnonzero(np.diff(instant, prepend=-1))
        groups = instant[starts]
        when = np.zeros(groups.size) if times is None else times[groups]
        R, p = self.obstacles.placements(when)
        for k, chosen in enumerate(np.split(pair, starts[1:])):
            check()
            self.narrow.place(q_model[groups[k]], float(when[k]), (R[k], p[k]))
            found = self.narrow.planes(chosen.tolist())
            distances += found[0]
            normals += found[1]
        normal = np.array(normals).reshape(-1, 3)
        convex = self.convex[self.broad.first] & self.convex[self.broad.second]
        normal[~convex[pair]] = 0.0
        return np.array(distances), normal
