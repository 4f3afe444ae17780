"""Link displacement: how far points of links move when joints move by so much."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.collision import CollisionChecker
from tominpmp.collision.bodies import Body
from tominpmp.collision.placements import Placements
from tominpmp.robot import Robot

_NONE: IntArray = np.zeros(0, dtype=np.int64)


class Ball(NamedTuple):
    """A ball around a part of a link.

    Attributes:
        link: Name of the link.
        joint: Index in the model of the joint that carries it; 0 for the world.
        centre: Centre in the axes of that joint [m], shape (3,).
        radius: Radius [m].
    """

    link: str
    joint: int
    centre: Array
    radius: float


class LinkDisplacement:
    r"""Bounds on how far points within balls move while joints stay within a box.

    At a configuration in the middle of the box, a point of a ball is no farther from
    the axis of joint i than the far side of the ball. Within the box that changes by
    what the joints between i and the link can move the point: from the tip on,
    :math:`r_i = r_i^0 + \sum_{k > i} r_k |\Delta q_k|`.
    """

    def __init__(self, robot: Robot, balls: Sequence[Ball]) -> None:
        self._robot = robot
        index: dict[str, list[int]] = {}
        for i, ball in enumerate(balls):
            index.setdefault(ball.link, []).append(i)
        self._index = {k: np.array(v, dtype=np.int64) for k, v in index.items()}
        model = robot.model
        self._placements = Placements(model)
        # Which coordinates of the model move a joint, shape (joints, nv).
        self.moves: BoolArray = self._placements.moves
        self._joint = np.array([ball.joint for ball in balls], dtype=np.int64)
        self._centre = np.array([ball.centre for ball in balls]).reshape(-1, 3)
        self._radius = np.array([ball.radius for ball in balls])
        self._turn, self._slide = np.zeros((model.njoints, 3)), np.zeros(model.njoints)
        self._column = np.zeros(model.njoints, dtype=np.int64)
        for joint in range(1, model.njoints):
            item = model.joints[joint]
            data = item.createData()
            item.calc(data, np.zeros(1))
            motion = np.asarray(data.S, dtype=np.float64).ravel()
            self._slide[joint] = np.linalg.norm(motion[:3])
            self._turn[joint] = motion[3:]
            self._column[joint] = item.idx_v

    @classmethod
    def of_links(cls, checker: CollisionChecker) -> LinkDisplacement:
        """Of balls around the links of a checker, about the middles of their bodies."""
        return cls(checker.robot, [_ball(body) for body in checker.links])

    def balls_of(self, link: str) -> IntArray:
        """Indices of the balls around a link."""
        return self._index.get(link, _NONE)

    def joint_of(self, link: str) -> int:
        """Joint that carries a link, 0 for none."""
        balls = self.balls_of(link)
        return int(self._joint[balls[0]]) if balls.size else 0

    def centres(self, q: Array) -> Array:
        """Centres of the balls in the world [m], shape (m, n) to (m, balls, 3)."""
        return self._place(q, np.arange(self._joint.size))[2]

    def _place(self, q: Array, balls: IntArray) -> tuple[Array, Array, Array]:
        R, t = self._placements.joints(self._robot.expand(q))
        joint = self._joint[balls]
        turned = np.einsum("mbij,bj->mbi", R[:, joint], self._centre[balls])
        return R, t, t[:, joint] + turned

    def shifts(self, q: Array, swing: Array, balls: IntArray | None = None) -> Array:
        """How far points of balls are moved by each coordinate.

        Args:
            q: Middles of boxes of configurations, shape (m, n) [rad or m].
            swing: Half of their edges, shape (m, n).
            balls: Indices of the balls, shape (k,); None for all.

        Returns:
            Shape (m, k, nv) [m].
        """
        balls = np.arange(self._joint.size) if balls is None else balls
        robot = self._robot
        matrix = robot.expansion_matrix
        half = swing if matrix is None else swing @ np.abs(matrix).T
        R, t, centre = self._place(q, balls)
        joint, radius = self._joint[balls], self._radius[balls]
        out = np.zeros((q.shape[0], joint.size, half.shape[1]))
        drift = np.zeros((q.shape[0], joint.size))
        for i in range(self._column.size - 1, 0, -1):
            column = int(self._column[i])
            hang = np.flatnonzero(self.moves[joint, column])
            if not hang.size:
                continue
            rate = np.full((q.shape[0], hang.size), self._slide[i])
            if np.any(self._turn[i]):
                axis = R[:, i] @ self._turn[i]
                rate += _lever(centre[:, hang] - t[:, i, None], axis) + radius[hang]
                rate += drift[:, hang]
            shift = rate * half[:, column, None]
            out[:, hang, column] = shift
            drift[:, hang] += shift
        return out


class RelativeMotion:
    """Bounds on how far pairs can come closer.

    Args:
        reach: The bounds on single links.
        pairs: Names (link, other).
        own: Whether the other is a link too, else it does not move.
    """

    def __init__(
        self, reach: LinkDisplacement, pairs: Sequence[tuple[str, str]], own: BoolArray
    ) -> None:
        self._reach = reach
        # For each link by the joint it is seen from: its balls, and the coordinates
        # that move the one and not the other.
        self._parts: list[tuple[IntArray, BoolArray]] = []
        # Indices of the two parts of each pair, -1 for what does not move.
        self._sides = np.full((len(pairs), 2), -1, dtype=np.int64)
        index: dict[tuple[str, int], int] = {}
        for k, names in enumerate(pairs):
            moving = names if own[k] else names[:1]
            joints = [*map(reach.joint_of, moving), 0]
            for side, name in enumerate(moving):
                mine, against = joints[side], joints[1 - side]
                if (name, against) not in index:
                    index[name, against] = len(self._parts)
                    # What moves both alike does not bring them closer.
                    alone = reach.moves[mine] & ~reach.moves[against]
                    self._parts.append((reach.balls_of(name), alone))
                self._sides[k, side] = index[name, against]

    def bound(self, q: Array, swing: Array, pairs: IntArray | None = None) -> Array:
        """How far pairs can come closer within boxes of configurations.

        Args:
            q: Middles of the boxes, shape (m, n) [rad or m].
            swing: Half of their edges, shape (m, n).
            pairs: Indices of the pairs, shape (k,); None for all.

        Returns:
            Shape (m, k) [m].
        """
        sides = self._sides if pairs is None else self._sides[pairs]
        used = np.unique(sides[sides >= 0])
        parts = [self._parts[k] for k in used]
        balls = np.unique(np.concatenate([part[0] for part in parts] or [_NONE]))
        shifts = self._reach.shifts(q, swing, balls)
        # The last column is for what does not move.
        moved = np.zeros((q.shape[0], len(self._parts) + 1))
        for k, (mine, alone) in zip(used, parts, strict=True):
            total = shifts[:, np.searchsorted(balls, mine)] @ alone.astype(np.float64)
            moved[:, k] = np.max(total, axis=1, initial=0.0)
        return np.asarray(moved[:, sides[:, 0]] + moved[:, sides[:, 1]])


def _lever(arm: Array, axis: Array) -> Array:
    """Distances of points from axes, from arms, shape (m, k, 3), and axes, (m, 3)."""
    x, y, z = (arm[..., i] for i in range(3))
    u, v, w = (axis[:, None, i] for i in range(3))
    squared = (y * w - z * v) ** 2
    squared += (z * u - x * w) ** 2
    squared += (x * v - y * u) ** 2
    return np.asarray(np.sqrt(squared))


# The bodies of a robot are the same ones in every problem.
@lru_cache(maxsize=512)
def _ball(body: Body) -> Ball:
    shape = body.outline
    middle = 0.5 * (np.min(shape.points, axis=0) + np.max(shape.points, axis=0))
    radius = float(np.max(np.linalg.norm(shape.points - middle, axis=1)))
    place = body.placement
    centre = place.rotation @ middle + place.translation
    return Ball(body.name, body.joint, np.asarray(centre), radius + shape.radius)
