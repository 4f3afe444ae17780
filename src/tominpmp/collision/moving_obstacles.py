"""Obstacles that move: joints of the world beyond those of the robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.scene import Obstacle


class MovingObstacles:
    """Placements and velocities of obstacles that move, beside those of joints.

    To everything that places bodies they are further joints, whose placements depend on
    time instead of the configuration.

    Attributes:
        first: Number of the first of them: how many joints the model has.
        count: How many there are.
        kinks: Times at which one of them changes its velocity at once [s], ascending.
    """

    def __init__(self, obstacles: Sequence[Obstacle], first: int) -> None:
        self.first, self.count = first, len(obstacles)
        self._obstacles = tuple(obstacles)
        kinks = [item.motion.kinks for item in obstacles if item.motion is not None]
        self.kinks: Array = np.unique(np.concatenate([np.zeros(0), *kinks]))

    def beside(
        self, joints: tuple[Array, Array], times: Array | None
    ) -> tuple[Array, Array]:
        """Placements of the joints and of what moves.

        Args:
            joints: Placements of the joints, shapes (m, joints, 3, 3), (m, joints, 3).
            times: Times [s], shape (m,); None for the start.

        Returns:
            Shapes (m, joints + count, 3, 3) and (m, joints + count, 3).
        """
        if not self.count:
            return joints
        R, t = joints
        if times is None:
            times = np.zeros(R.shape[0])
        placed_R, placed_t = self.placements(times)
        return (
            np.concatenate([R, placed_R], axis=1),
            np.concatenate([t, placed_t], axis=1),
        )

    def placements(self, times: Array) -> tuple[Array, Array]:
        """Placements at times [s], shape (m,).

        Returns:
            Rotations, shape (m, count, 3, 3), and positions [m], shape (m, count, 3).
        """
        R = np.empty((times.size, self.count, 3, 3))
        p = np.empty((times.size, self.count, 3))
        for number, item in enumerate(self._obstacles):
            R[:, number], p[:, number] = item.poses(times)
        return R, p

    def approach(
        self, joint: IntArray, times: Array, point: Array, normal: Array
    ) -> Array:
        """Speeds along directions of points on what moves; zero on all else.

        Args:
            joint: What carries each point, shape (k,).
            times: Times [s], shape (k,).
            point: Points in the world [m], shape (k, 3).
            normal: Directions in the world, shape (k, 3).

        Returns:
            Shape (k,) [m/s].
        """
        out = np.zeros(joint.size)
        for number, item in enumerate(self._obstacles):
            rows = np.flatnonzero(joint == self.first + number)
            if not rows.size:
                continue
            twist, place = item.twists(times[rows]), item.poses(times[rows])
            turning = np.cross(twist.angular, point[rows] - place.p)
            out[rows] = np.sum(normal[rows] * (twist.linear + turning), axis=1)
        return out

    def speeds(self, begin: Array, end: Array) -> tuple[Array, Array]:
        """Largest speeds between times [s], shape (m,) each.

        Returns:
            Of the origins [m/s] and of the rotations [rad/s], shapes (m, count).
        """
        found = [item.speed_bounds(begin, end) for item in self._obstacles]
        shape = (begin.size, self.count)
        linear = np.array([item[0] for item in found]).reshape(shape[::-1]).T
        return linear, np.array([item[1] for item in found]).reshape(shape[::-1]).T
