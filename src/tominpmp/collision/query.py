"""Distance queries at many configurations: bounds where they will do, else exact."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.collision.broad import BroadPhase, Joints
from tominpmp.collision.moving_obstacles import MovingObstacles
from tominpmp.collision.narrow import NarrowPhase
from tominpmp.collision.placements import Placements
from tominpmp.stopping import check


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
        placements: Forward kinematics.
        broad: Bounds from balls and boxes.
        narrow: Exact distances.
        obstacles: Obstacles that move.
        count: How many queries there were.
    """

    placements: Placements
    broad: BroadPhase
    narrow: NarrowPhase
    obstacles: MovingObstacles
    count: Count = field(default_factory=Count)

    @property
    def pairs(self) -> int:
        """Number of pairs."""
        return int(self.broad.first.size)

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
        limit = np.broadcast_to(np.asarray(cutoff, dtype=np.float64), (self.pairs,))
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
        near = near[np.argsort(instant[near], kind="stable")]
        if near.size:
            self.count.queries += near.size
            out[near] = self._exact(q_model, instant[near], pair[near], times)
        return out

    def _exact(
        self, q_model: Array, instant: IntArray, pair: IntArray, times: Array | None
    ) -> Array:
        distances: list[float] = []
        starts = np.flatnonzero(np.diff(instant, prepend=-1))
        groups = instant[starts]
        when = np.zeros(groups.size) if times is None else times[groups]
        R, p = self.obstacles.placements(when)
        for k, chosen in enumerate(np.split(pair, starts[1:])):
            check()
            self.narrow.place(q_model[groups[k]], float(when[k]), (R[k], p[k]))
            distances += self.narrow.distances(chosen.tolist())
        return np.array(distances)
