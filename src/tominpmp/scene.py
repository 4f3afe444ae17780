"""Obstacles: plain data, no geometry library.

Poses are given in the world frame [m]; rotations as a 3x3 matrix or a quaternion in the
order x, y, z, w. Cylinders and capsules stand along their z axis.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, frozen_array
from tominpmp.exceptions import SceneError


def rotation_matrix(rotation: ArrayLike | None, obstacle: str) -> Array:
    """Turn a rotation as users give it into a matrix.

    Args:
        rotation: None (no rotation), a 3x3 matrix or a quaternion (x, y, z, w), which is
            normalised.
        obstacle: Name of the obstacle, for the message.

    Returns:
        Rotation matrix, shape (3, 3).

    Raises:
        SceneError: If it is neither a rotation matrix nor a quaternion.
    """
    if rotation is None:
        return frozen_array(np.eye(3))
    value = np.asarray(rotation, dtype=np.float64)
    if value.shape == (4,):
        norm = float(np.linalg.norm(value))
        if not np.isfinite(norm) or norm < 1e-9:
            raise SceneError(
                f"obstacle {obstacle!r}: rotation {value.tolist()} is no quaternion "
                "(x, y, z, w): its length must not be zero",
                obstacle,
            )
        x, y, z, w = value / norm
        return frozen_array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
    if value.shape == (3, 3):
        if (
            not np.allclose(value @ value.T, np.eye(3), atol=1e-6)
            or np.linalg.det(value) < 0
        ):
            raise SceneError(
                f"obstacle {obstacle!r}: the 3x3 rotation is not a rotation matrix "
                "(orthonormal columns, determinant 1)",
                obstacle,
            )
        return frozen_array(value)
    raise SceneError(
        f"obstacle {obstacle!r}: rotation has shape {value.shape}, expected (3, 3) or a "
        "quaternion (x, y, z, w)",
        obstacle,
    )


@dataclass(frozen=True, kw_only=True)
class Obstacle:
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
        position = np.asarray(self.position, dtype=np.float64)
        if position.shape != (3,) or not np.all(np.isfinite(position)):
            raise SceneError(
                f"obstacle {self.name!r}: position is {self.position!r}, expected three "
                "finite numbers [m]",
                self.name,
            )
        object.__setattr__(self, "position", frozen_array(position))
        object.__setattr__(self, "rotation", rotation_matrix(self.rotation, self.name))

    def _check_positive(self, **sizes: float) -> None:
        for key, value in sizes.items():
            if not np.isfinite(value) or value <= 0.0:
                raise SceneError(
                    f"obstacle {self.name!r}: {key} is {value}, expected a positive "
                    "length [m]",
                    self.name,
                )


@dataclass(frozen=True, kw_only=True)
class Sphere(Obstacle):
    """A ball.

    Attributes:
        radius: Radius [m].
    """

    radius: float

    def __post_init__(self) -> None:
        """Check the radius."""
        super().__post_init__()
        self._check_positive(radius=self.radius)


@dataclass(frozen=True, kw_only=True)
class Box(Obstacle):
    """A cuboid.

    Attributes:
        size: Full edge lengths along x, y and z [m], shape (3,).
    """

    size: Array

    def __post_init__(self) -> None:
        """Check the edges."""
        super().__post_init__()
        size = np.asarray(self.size, dtype=np.float64)
        if size.shape != (3,):
            raise SceneError(
                f"obstacle {self.name!r}: size is {self.size!r}, expected three edge "
                "lengths [m]",
                self.name,
            )
        for axis, value in zip("xyz", size, strict=True):
            self._check_positive(**{f"size along {axis}": float(value)})
        object.__setattr__(self, "size", frozen_array(size))


@dataclass(frozen=True, kw_only=True)
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
        self._check_positive(radius=self.radius, length=self.length)


@dataclass(frozen=True, kw_only=True)
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
        self._check_positive(radius=self.radius, length=self.length)


@dataclass(frozen=True)
class Scene:
    """The obstacles of a workspace.

    Attributes:
        obstacles: The obstacles, each with a name of its own.
    """

    obstacles: tuple[Obstacle, ...] = ()

    def __init__(self, obstacles: Iterable[Obstacle] = ()) -> None:
        found = tuple(obstacles)
        for item in found:
            if not isinstance(item, Obstacle):
                raise SceneError(
                    f"a scene holds obstacles (Sphere, Box, Cylinder, Capsule), not "
                    f"{type(item).__name__}"
                )
        names = [item.name for item in found]
        for name in names:
            if names.count(name) > 1:
                raise SceneError(f"two obstacles are named {name!r}", name)
        object.__setattr__(self, "obstacles", found)

    def __iter__(self) -> Iterator[Obstacle]:
        """Iterate over the obstacles."""
        return iter(self.obstacles)

    def __len__(self) -> int:
        """Return how many obstacles there are."""
        return len(self.obstacles)

    def __getitem__(self, name: str) -> Obstacle:
        """Return an obstacle by its name.

        Raises:
            SceneError: If there is none of that name.
        """
        for item in self.obstacles:
            if item.name == name:
                return item
        known = ", ".join(item.name for item in self.obstacles) or "none"
        raise SceneError(f"there is no obstacle {name!r}; there are: {known}", name)
