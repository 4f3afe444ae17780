"""Rotations and poses in the forms that users give: checked, and converted.

Whether a matrix is a rotation is checked here, because SciPy's ``Rotation.from_matrix``
silently replaces a stretched matrix by the nearest rotation.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from tominpmp.arrays import Array, array_or_nan, frozen_array
from tominpmp.checks import POSE, RotationLike, plain_rotation, split_pose, wrong
from tominpmp.exceptions import ProblemError


def is_rotation(matrix: Array) -> bool:
    """Whether a matrix of shape (3, 3) is orthonormal with determinant 1."""
    if not np.all(np.abs(matrix) < 2.0):  # also rejects NaN
        return False
    orthonormal = np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-6)
    return bool(orthonormal and np.linalg.det(matrix) > 0.0)


def rotation_matrix(rotation: RotationLike | None, name: str = "rotation") -> Array:
    """Check a rotation from a caller, and convert it to a matrix.

    Args:
        rotation: None for the identity, a 3x3 matrix, a quaternion (x, y, z, w), which
            is normalised, or a ``Rotation`` of SciPy.
        name: Name of the argument that holds it.

    Returns:
        Rotation matrix, shape (3, 3).

    Raises:
        ProblemError: If the rotation is neither a rotation matrix nor a quaternion.
    """
    if rotation is None:
        return frozen_array(np.eye(3))
    value = array_or_nan(plain_rotation(rotation))
    if value.shape == (3, 3) and is_rotation(value):
        return value
    largest = float(np.max(np.abs(value), initial=0.0))
    if value.shape != (4,) or not 1e-9 <= largest < np.inf:
        expected = (
            "a rotation matrix (3x3, orthonormal columns, determinant 1) or a "
            "quaternion (x, y, z, w) of finite numbers other than zero"
        )
        raise wrong(value.tolist() if value.ndim else rotation, name, expected)
    # Division by the largest component, so that no square overflows.
    return frozen_array(Rotation.from_quat(value / largest).as_matrix())


def checked_pose(pose: object, name: str) -> pin.SE3:
    """Check a caller's pose, and copy it into a ``pinocchio.SE3``.

    Args:
        pose: The pose.
        name: Name of the pose in messages.

    Raises:
        ProblemError: If the pose is invalid.
    """
    position, turn = map(array_or_nan, split_pose(pose) or (None, None))
    if position.shape != (3,) or turn.shape not in ((3, 3), (4,)):
        raise wrong(pose, name, POSE)
    if not (np.all(np.isfinite(position)) and np.all(np.isfinite(turn))):
        raise ProblemError(f"{name} is not finite", field=name)
    return pin.SE3(np.array(rotation_matrix(turn, name)), np.array(position))
