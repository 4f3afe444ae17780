"""Placements of joints and moving obstacles, which carry the bodies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.scene.obstacles import Obstacle


class JointPlacements:
    """Vectorised forward kinematics of joints with one coordinate each.

    In Pinocchio's order, joint i + 1 has coordinate i; joint 0 is the world.

    Attributes:
        slide: Sliding axis of each joint, zero if it turns, shape (joints, 3).
        turn: Rotation axis of each joint, zero if it slides, shape (joints, 3).
        moves: Whether each coordinate moves each joint, shape (joints, nv).
    """

    def __init__(self, model: pin.Model) -> None:
        self._parents = [int(parent) for parent in model.parents]
        count = len(self._parents)
        self.turn, self.slide = np.zeros((count, 3)), np.zeros((count, 3))
        # For each joint, relative to its parent: its position, its sliding direction,
        # and three matrices whose sum, weighted by 1, the sine and the versed sine of
        # the angle, is its rotation (Rodrigues).
        self._offset = np.array([place.translation for place in model.jointPlacements])
        self._way, self._basis = np.zeros((count, 3)), np.zeros((count, 3, 9))
        self.moves: BoolArray = np.zeros((count, model.nv), dtype=bool)
        for joint in range(count):
            rotation = np.array(model.jointPlacements[joint].rotation)
            if joint:
                item = model.joints[joint]
                data = item.createData()
                item.calc(data, np.zeros(1))
                motion = np.asarray(data.S, dtype=np.float64).ravel()
                self.slide[joint], self.turn[joint] = motion[:3], motion[3:]
                self.moves[joint] = self.moves[self._parents[joint]]
                self.moves[joint, joint - 1] = True
            cross = pin.skew(self.turn[joint])
            parts = [rotation, rotation @ cross, rotation @ cross @ cross]
            self._basis[joint] = np.array(parts).reshape(3, 9)
            self._way[joint] = rotation @ self.slide[joint]

    def joints(self, q: Array) -> tuple[Array, Array]:
        """Placements joint_to_world.

        Args:
            q: Configurations of the model, shape (m, nv) [rad or m].

        Returns:
            Rotations, shape (m, joints, 3, 3), and positions, shape (m, joints, 3) [m].
        """
        m, count = q.shape[0], len(self._parents)
        angle = np.concatenate([np.zeros((1, m)), q.T])
        parts = np.ones((count, m, 3))
        parts[:, :, 1], parts[:, :, 2] = np.sin(angle), 1.0 - np.cos(angle)
        # Joints come first, so that all configurations of a joint are contiguous.
        place = np.empty((count, m, 3, 4))
        place[..., :3] = (parts @ self._basis).reshape(count, m, 3, 3)
        place[..., 3] = self._offset[:, None]
        if np.any(self._way):
            place[..., 3] += angle[..., None] * self._way[:, None]
        place[0] = np.eye(3, 4)
        for joint in range(1, count):
            up = place[self._parents[joint]]
            if self._parents[joint]:
                place[joint] = up[..., :3] @ place[joint]
                place[joint, ..., 3] += up[..., 3]
        return np.moveaxis(place[..., :3], 0, 1), np.moveaxis(place[..., 3], 0, 1)

    def jacobian_rows(
        self,
        placed: tuple[Array, Array],
        instants: IntArray,
        joint: IntArray,
        point: Array,
        normal: Array,
    ) -> Array:
        """Jacobian rows: speeds of points along directions per unit coordinate speed.

        Args:
            placed: Placements of all joints, see :meth:`joints`.
            instants: Index of the configuration of each point, shape (k,).
            joint: Joint that carries each point, shape (k,).
            point: Points in the world [m], shape (k, 3).
            normal: Directions in the world, shape (k, 3).

        Returns:
            One row for each point, shape (k, nv).
        """
        R, t = (part[:, 1:] for part in placed)
        # Twists of the joints in the world, and lines along the directions.
        turn = (R @ self.turn[1:, :, None])[..., 0]
        slide = (R @ self.slide[1:, :, None])[..., 0] + np.cross(t, turn)
        twists = np.concatenate([slide, turn], axis=2)
        lines = np.concatenate([normal, np.cross(point, normal)], axis=1)
        speeds = (twists[instants] @ lines[..., None])[..., 0]
        return np.where(self.moves[joint], speeds, 0.0)

    def displacements(
        self, q: Array, half: Array, joint: IntArray, centre: Array, radius: Array
    ) -> Array:
        r"""Bounds on displacements of points of balls while coordinates are in a box.

        At the middle of the box, the distance :math:`r_i^0` of a point of a ball from
        the axis of joint i is at most the distance of the far side of the ball. Within
        the box, this distance grows by at most the displacements due to the joints
        between i and the ball. Starting at the tip,
        :math:`r_i = r_i^0 + \sum_{k > i} r_k |\Delta q_k|`.

        Args:
            q: Middles of boxes of coordinates, shape (m, nv) [rad or m].
            half: Half the edge lengths of the boxes, shape (m, nv).
            joint: Joint that carries each ball, 0 for the world, shape (k,).
            centre: Centres of the balls in the axes of their joints [m], shape (k, 3).
            radius: Radii of the balls [m], shape (k,).

        Returns:
            Displacements due to each coordinate, shape (m, k, nv) [m].
        """
        R, t = self.joints(q)
        place = t[:, joint] + np.einsum("mbij,bj->mbi", R[:, joint], centre)
        out = np.zeros((q.shape[0], joint.size, q.shape[1]))
        drift = np.zeros((q.shape[0], joint.size))
        for column in reversed(range(q.shape[1])):
            i = column + 1
            moved = np.flatnonzero(self.moves[joint, column])
            if not moved.size:
                continue
            rate = np.full((q.shape[0], moved.size), np.linalg.norm(self.slide[i]))
            if np.any(self.turn[i]):
                axis = (R[:, i] @ self.turn[i])[:, None]
                lever = np.cross(place[:, moved] - t[:, i, None], axis)
                rate += np.linalg.norm(lever, axis=2) + radius[moved] + drift[:, moved]
            out[:, moved, column] = rate * half[:, column, None]
            drift[:, moved] += out[:, moved, column]
        return out


class MovingObstacles:
    """Placements and velocities of moving obstacles, in addition to joints.

    Moving obstacles count as additional joints that carry bodies, with placements that
    depend on time instead of the configuration.

    Attributes:
        first: Joint index of the first moving obstacle: the number of joints of the
            model.
        count: Number of moving obstacles.
        kinks: Times at which the velocity of an obstacle jumps [s], ascending.
    """

    def __init__(self, obstacles: Sequence[Obstacle], first: int) -> None:
        self.first, self.count = first, len(obstacles)
        self._obstacles = tuple(obstacles)
        kinks = [item.motion.kinks for item in obstacles if item.motion is not None]
        self.kinks: Array = np.unique(np.concatenate([np.zeros(0), *kinks]))

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
        """Speeds of points on moving obstacles along directions; zero for other points.

        Args:
            joint: Joint or obstacle that carries each point, shape (k,).
            times: Times [s], shape (k,).
            point: Points in the world [m], shape (k, 3).
            normal: Directions in the world, shape (k, 3).

        Returns:
            Speeds, shape (k,) [m/s].
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

    def speeds(
        self, joint: IntArray, farthest: Array, begin: Array, end: Array
    ) -> Array:
        """Bounds on speeds of points on moving obstacles; zero for other bodies.

        Args:
            joint: Joint or obstacle that carries each point, shape (k,).
            farthest: Distances of the points from its origin, shape (k,) [m].
            begin: Beginnings of spans of time [s], shape (m,).
            end: Ends of the spans [s], shape (m,).

        Returns:
            Bounds, shape (m, k) [m/s].
        """
        out = np.zeros((begin.size, joint.size))
        for number, item in enumerate(self._obstacles):
            some = np.flatnonzero(joint == self.first + number)
            linear, angular = item.speed_bounds(begin, end)
            out[:, some] = linear[:, None] + angular[:, None] * farthest[some]
        return out
