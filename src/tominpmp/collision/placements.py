"""Placements of joints and bodies at many configurations at once."""

from __future__ import annotations

from collections.abc import Sequence

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
        # Of each joint: where it is on its parent, and the matrices whose sum with the
        # sine and the versed sine of its angle is its rotation (Rodrigues).
        self._offset = [np.array(place.translation) for place in model.jointPlacements]
        self._basis: list[Array] = []
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
            self._basis.append(np.concatenate(parts, axis=1))

    def joints(self, q: Array) -> tuple[Array, Array]:
        """Placements joint_to_world.

        Args:
            q: Configurations of the model, shape (m, nv) [rad or m].

        Returns:
            Rotations, shape (m, joints, 3, 3), and positions, shape (m, joints, 3) [m].
        """
        m, count = q.shape[0], len(self._parents)
        R, t = np.empty((m, count, 3, 3)), np.empty((m, count, 3))
        R[:, 0], t[:, 0] = np.eye(3), 0.0
        sine, versine = np.sin(q)[:, :, None, None], 1.0 - np.cos(q)[:, :, None, None]
        for joint in range(1, count):
            parent, column = R[:, self._parents[joint]], self._column[joint]
            parts = (parent.reshape(-1, 3) @ self._basis[joint]).reshape(m, 3, 9)
            base = parts[:, :, :3]
            t[:, joint] = t[:, self._parents[joint]] + parent @ self._offset[joint]
            if np.any(self._slide[joint]):
                t[:, joint] += q[:, column, None] * (base @ self._slide[joint])
            turned = base + sine[:, column] * parts[:, :, 3:6]
            R[:, joint] = turned + versine[:, column] * parts[:, :, 6:]
        return R, t

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


class BodyPlacements:
    """Where bodies are that are on joints or fixed in the world.

    Args:
        joint: Joint of each body, shape (bodies,).
        placements: Placements body_to_joint.
    """

    def __init__(self, joint: IntArray, placements: Sequence[pin.SE3]) -> None:
        R = np.array([item.rotation for item in placements]).reshape(-1, 3, 3)
        t = np.array([item.translation for item in placements]).reshape(-1, 3)
        self._fixed, self._carried = np.flatnonzero(joint == 0), np.flatnonzero(joint)
        self._joint = joint[self._carried]
        self._R, self._t = R[self._carried], t[self._carried]
        self._fixed_R, self._fixed_t = R[self._fixed], t[self._fixed]

    def place(self, joints: tuple[Array, Array]) -> tuple[Array, Array]:
        """Placements body_to_world, shapes (m, bodies, 3, 3) and (m, bodies, 3).

        From the placements of the joints, shapes (m, joints, 3, 3) and (m, joints, 3).
        """
        count = self._fixed.size + self._carried.size
        placed_R = np.empty((len(joints[0]), count, 3, 3))
        placed_t = np.empty((len(joints[0]), count, 3))
        placed_R[:, self._fixed], placed_t[:, self._fixed] = (
            self._fixed_R,
            self._fixed_t,
        )
        R, t = joints[0][:, self._joint], joints[1][:, self._joint]
        placed_R[:, self._carried] = R @ self._R
        turned = (R @ self._t[:, :, None])[..., 0]
        placed_t[:, self._carried] = t + turned
        return placed_R, placed_t
