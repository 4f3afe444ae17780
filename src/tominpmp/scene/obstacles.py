"""Obstacles of simple shape.

Poses are given in the world frame [m]; rotations as a 3x3 matrix or a quaternion in the
order x, y, z, w. Cylinders and capsules stand along their z axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Record, frozen_array, real_array, real_number
from tominpmp.exceptions import SceneError


def is_rotation(matrix: Array) -> bool:
    """Whether a matrix of shape (3, 3) turns without stretching or mirroring."""
    if not np.all(np.abs(matrix) < 2.0):  # nor NaN
        return False
    orthonormal = np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-6)
    return bool(orthonormal and np.linalg.det(matrix) > 0.0)


def rotation_matrix(rotation: ArrayLike | None, obstacle: str) -> Array:
    """Turn a rotation as users give it into a matrix.

    Args:
        rotation: None (no rotation), a 3x3 matrix or a quaternion (x, y, z, w), which
            is normalised.
        obstacle: Name of the obstacle, for the message.

    Returns:
        Rotation matrix, shape (3, 3).

    Raises:
        SceneError: If it is neither a rotation matrix nor a quaternion.
    """
    if rotation is None:
        return frozen_array(np.eye(3))
    try:
        value = real_array(rotation)
    except ValueError:
        value = np.empty(0)
    if value.shape not in ((3, 3), (4,)) or not np.all(np.isfinite(value)):
        raise SceneError(
            f"obstacle {obstacle!r}: rotation is {rotation!r}, expected a 3x3 matrix "
            "or a quaternion (x, y, z, w) of finite numbers",
            obstacle,
        )
    if value.size == 4:
        return _from_quaternion(value, obstacle)
    if not is_rotation(value):
        raise SceneError(
            f"obstacle {obstacle!r}: the 3x3 rotation is not a rotation matrix "
            "(orthonormal columns, determinant 1)",
            obstacle,
        )
    return value


def _from_quaternion(value: Array, obstacle: str) -> Array:
    largest = float(np.max(np.abs(value)))
    if largest < 1e-9:
        raise SceneError(
            f"obstacle {obstacle!r}: rotation {value.tolist()} is no quaternion "
            "(x, y, z, w): its length must not be zero",
            obstacle,
        )
    value = value / largest  # so that no square overflows
    x, y, z, w = value / np.linalg.norm(value)
    return frozen_array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Obstacle(Record):
    """A body fixed in the world.

    Attributes:
        name: Name, unique in its scene.
        position: Position of its centre in the world [m], shape (3,).
        rotation: Rotation obstacle_to_world, shape (3, 3).
    """

    name: str = field(kw_only=False)
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        """Check name, position and rotation."""
        if not isinstance(self.name, str) or not self.name:
            raise SceneError(f"an obstacle needs a name, not {self.name!r}")
        object.__setattr__(self, "position", self._triple("position", "coordinates"))
        object.__setattr__(self, "rotation", rotation_matrix(self.rotation, self.name))

    def _triple(self, key: str, content: str) -> Array:
        value = getattr(self, key)
        try:
            array = real_array(value)
        except ValueError:
            array = np.empty(0)
        if array.shape != (3,) or not np.all(np.isfinite(array)):
            raise SceneError(
                f"obstacle {self.name!r}: {key} is {value!r}, expected three finite "
                f"{content} [m]",
                self.name,
            )
        return array

    def _length(self, key: str, value: object) -> float:
        try:
            number = real_number(value)
        except ValueError:
            number = np.nan
        if not (np.isfinite(number) and number > 0.0):
            raise SceneError(
                f"obstacle {self.name!r}: {key} is {value!r}, expected a positive "
                "length [m]",
                self.name,
            )
        return number

    def _set_lengths(self, *keys: str) -> None:
        for key in keys:
            object.__setattr__(self, key, self._length(key, getattr(self, key)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Sphere(Obstacle):
    """A ball.

    Attributes:
        radius: Radius [m].
    """

    radius: float

    def __post_init__(self) -> None:
        """Check the radius."""
        super().__post_init__()
        self._set_lengths("radius")


@dataclass(frozen=True, kw_only=True, eq=False)
class Box(Obstacle):
    """A cuboid.

    Attributes:
        size: Full edge lengths along x, y and z [m], shape (3,).
    """

    size: Array

    def __post_init__(self) -> None:
        """Check the edges."""
        super().__post_init__()
        size = self._triple("size", "edge lengths")
        for axis, value in zip("xyz", size.tolist(), strict=True):
            self._length(f"size along {axis}", value)
        object.__setattr__(self, "size", size)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cylinder(Obstacle):
    """A cylinder along its z axis.

    Attributes:
        radius: Radius [m].
        length: Length from end to end [m].
    """

    radius: float
    length: float

    def __post_init__(self) -> None:
        """Check the sizes."""
        super().__post_init__()
        self._set_lengths("radius", "length")


@dataclass(frozen=True, kw_only=True, eq=False)
class Capsule(Obstacle):
    """A cylinder along its z axis with a half ball at either end.

    Attributes:
        radius: Radius [m].
        length: Length of the straight part, without the half balls [m].
    """

    radius: float
    length: float

    def __post_init__(self) -> None:
        """Check the sizes."""
        super().__post_init__()
        self._set_lengths("radius", "length")
