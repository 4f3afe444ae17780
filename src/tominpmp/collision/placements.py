"""Placements of joints at many configurations at once."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, BoolArray, IntArray


class Placements:
    """Forward kinematics of joints with one coordinate each, vectorised.

    Attributes:
        moves: Which coordinates move a joint, shape (joints, nv); joint 0 is the world.
    """

    def __init__(self, model: pin.Model) -> None:
        self._parents = [int(parent) for parent in model.parents]
        count = len(self._parents)
        self._turn, self._slide = np.zeros((count, 3)), np.zeros((count, 3))
        self._column = np.full(count, -1, dtype=np.int64)
        # Of each joint: where it is on its parent, the way it slides there, and the
        # matrices whose sum with the sine and the versed sine of its angle is its
        # rotation (Rodrigues).
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
                self._slide[joint], self._turn[joint] = motion[:3], motion[3:]
                self._column[joint] = item.idx_v
                self.moves[joint] = self.moves[self._parents[joint]]
                self.moves[joint, item.idx_v] = True
            cross = _cross(self._turn[joint])
            parts = [rotation, rotation @ cross, rotation @ cross @ cross]
            self._basis[joint] = np.array(parts).reshape(3, 9)
            self._way[joint] = rotation @ self._slide[joint]

    def joints(self, q: Array) -> tuple[Array, Array]:
        """Placements joint_to_world.

        Args:
            q: Configurations of the model, shape (m, nv) [rad or m].

        Returns:
            Rotations, shape (m, joints, 3, 3), and positions, shape (m, joints, 3) [m].
        """
        m, count = q.shape[0], len(self._parents)
        angle = q[:, self._column].T
        parts = np.ones((count, m, 3))
        parts[:, :, 1], parts[:, :, 2] = np.sin(angle), 1.0 - np.cos(angle)
        # All configurations of a joint are side by side: they are worked on together.
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

    def axes(self, joint: int) -> tuple[Array, Array, int]:
        """How a joint moves: directions it slides and turns in, and its coordinate."""
        return self._slide[joint], self._turn[joint], int(self._column[joint])

    def jacobian_rows(
        self,
        placed: tuple[Array, Array],
        joint: IntArray,
        point: Array,
        normal: Array,
    ) -> Array:
        """Speeds of points along directions, per unit speed of each coordinate.

        Args:
            placed: Placements of all joints, shapes (k, joints, 3, 3) and (k, joints,
                3).
            joint: Joint that carries each point, shape (k,).
            point: Points in the world [m], shape (k, 3).
            normal: Directions in the world, shape (k, 3).

        Returns:
            Shape (k, nv).
        """
        R, t = placed
        out = np.zeros((point.shape[0], self.moves.shape[1]))
        for j in range(1, len(self._parents)):
            column = self._column[j]
            chosen = np.flatnonzero(self.moves[joint, column])
            if not chosen.size:
                continue
            n, turned = normal[chosen], R[chosen, j]
            speed = np.zeros(chosen.size)
            if np.any(self._slide[j]):
                speed += np.sum(n * (turned @ self._slide[j]), axis=1)
            if np.any(self._turn[j]):
                lever = np.cross(point[chosen] - t[chosen, j], n)
                speed += np.sum(lever * (turned @ self._turn[j]), axis=1)
            out[chosen, column] = speed
        return out


def _cross(axis: Array) -> Array:
    """Matrix of the cross product with an axis."""
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
