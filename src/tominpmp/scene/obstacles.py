"""Obstacles with primitive shapes.

Poses are given in the world frame [m]; rotations as a 3x3 matrix or a quaternion in the
order x, y, z, w. The axis of cylinders and capsules is their z axis.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar

import numpy as np

from tominpmp.arrays import (
    Array,
    Converted,
    Record,
    array_or_nan,
    default,
    frozen_array,
)
from tominpmp.checks import (
    FARTHEST,
    PoseLike,
    RotationLike,
    VectorLike,
    number,
    plain_rotation,
    raised_as,
    split_pose,
    vector,
)
from tominpmp.exceptions import ProblemError, SceneError, brief
from tominpmp.scene.motion import (
    ConstantVelocity,
    Motion,
    Placement,
    SpeedBounds,
    Twist,
    as_motion,
)
from tominpmp.scene.rotations import rotation_matrix

_T = TypeVar("_T")

# Longest name, as names appear in messages [characters].
LONGEST_NAME = 255
# Motion of an obstacle at rest.
REST = ConstantVelocity()


if TYPE_CHECKING:
    from typing_extensions import dataclass_transform

    # Without "frozen", for which mypy would give inherited fields the types that the
    # constructor accepts instead of the types that are stored.
    @dataclass_transform(
        kw_only_default=True, eq_default=False, field_specifiers=(field,)
    )
    def obstacle(kind: type[_T], /) -> type[_T]:
        """A :func:`record` that is constructed with keywords."""
else:
    obstacle = dataclass(frozen=True, kw_only=True, eq=False)


def _edges(value: Any, name: str) -> Array:
    """Check a caller's edge lengths, shape (3,) [m]."""
    size = vector(value, name, "three edge lengths [m]", 3)
    for axis, edge in zip("xyz", size.tolist(), strict=True):
        _length(edge, f"{name} along {axis}")
    return size


_length = partial(number, expected="a positive length [m]", above=0.0)
Position: TypeAlias = Annotated[
    Converted[VectorLike | PoseLike, Array],
    partial(vector, expected="three coordinates [m]", size=3, most=FARTHEST),
]
Turn: TypeAlias = Annotated[Converted[RotationLike | None, Array], rotation_matrix]
MotionOrNone: TypeAlias = Annotated[
    Converted[Motion | Callable[[float], Any] | None, Motion | None],
    lambda value, _: as_motion(value),
]
Length: TypeAlias = Annotated[float, _length]
Edges: TypeAlias = Annotated[Converted[VectorLike, Array], _edges]


@obstacle
class Obstacle(Record):
    """A body in the world, at rest or moving.

    Attributes:
        name: Name, unique in the scene.
        position: Position of the obstacle's centre in the world [m], shape (3,); for a
            moving obstacle at the start of the robot's motion. A pose (a
            ``pinocchio.SE3``, a 4x4 matrix) also gives the rotation.
        rotation: Rotation obstacle_to_world, shape (3, 3), for a moving obstacle at the
            start of the robot's motion; may be given as a quaternion (x, y, z, w) or a
            ``Rotation`` of SciPy.
        motion: Motion of the obstacle; None for an obstacle at rest. A function from
            time [s] to a placement is converted to a :class:`PoseFunction`. If the
            motion gives positions or rotations, ``position`` or ``rotation`` may be
            omitted.
    """

    name: str = field(kw_only=False)
    position: Position = field(default_factory=lambda: default(np.zeros(3)))
    rotation: Turn = field(default_factory=lambda: default(np.eye(3)))
    motion: MotionOrNone = default(None)

    def __post_init__(self) -> None:
        """Check name, position, rotation and motion."""
        name = self.name
        if not isinstance(name, str) or not name or len(name) > LONGEST_NAME:
            raise SceneError(
                f"an obstacle needs a name of at most {LONGEST_NAME} characters, not "
                f"{brief(name)}"
            )
        with self._named():
            self._take_pose()
            super().__post_init__()
            if self.motion is not None:
                R, p = self.motion.start(self._start)
                self._keep(rotation=frozen_array(R), position=frozen_array(p))
            self._check_shape()

    def _check_shape(self) -> None:
        """Check the shape of a subclass; errors get the name of the obstacle."""

    def _take_pose(self) -> None:
        """Convert a pose to both fields."""
        pose = split_pose(self.position)
        if pose is None:
            return
        turn = array_or_nan(plain_rotation(self.rotation))
        if self.rotation is not None and not np.array_equal(turn, np.eye(3)):
            raise ProblemError(
                "position is a pose with a rotation, and rotation is given, too: "
                "expected a pose, or a position and a rotation"
            )
        self._keep(position=pose[0], rotation=pose[1])

    def _named(self) -> AbstractContextManager[None]:
        """Context manager that adds the name of the obstacle to error messages."""
        whose = f"obstacle {self.name!r}: "
        return raised_as(lambda text, _: SceneError(whose + text, self.name))

    @property
    def _start(self) -> Placement:
        """Placement at the start of the robot's motion."""
        return Placement(self.rotation, self.position)

    def poses(self, times: Array) -> Placement:
        """Placements obstacle_to_world at times [s], shape (m,), from 0 on.

        Returns:
            Rotations, shape (m, 3, 3), and positions [m], shape (m, 3).

        Raises:
            SceneError: If the function that moves the obstacle gives no placement.
        """
        with self._named():
            return (self.motion or REST).poses(times, self._start)

    def twists(self, times: Array) -> Twist:
        """Velocities at times [s], shape (m,), in the axes of the world."""
        with self._named():
            return (self.motion or REST).twists(times, self._start)

    def speed_bounds(self, begin: Array, end: Array) -> SpeedBounds:
        """Upper bounds on the speeds between times [s], shape (m,) each.

        Returns:
            Bounds on the speed of the origin [m/s] and on the angular speed [rad/s],
            shape (m,) each.
        """
        with self._named():
            return (self.motion or REST).speed_bounds(begin, end, self._start)

    def frozen(self, time: float) -> Obstacle:
        """The obstacle at rest at its placement at a time [s]."""
        R, p = self.poses(np.array([number(time, "time", "a time [s]")]))
        # Unchecked: in a long time it may go farther than obstacles may be placed.
        place = {"rotation": frozen_array(R[0]), "position": frozen_array(p[0])}
        return self._altered(motion=None, **place)


@obstacle
class Sphere(Obstacle):
    """A ball.

    Attributes:
        radius: Radius [m].
    """

    radius: Length


@obstacle
class Box(Obstacle):
    """A cuboid.

    Attributes:
        size: Full edge lengths along x, y and z [m], shape (3,).
    """

    size: Edges


@obstacle
class Cylinder(Obstacle):
    """A cylinder along its z axis.

    Attributes:
        radius: Radius [m].
        length: Length from end to end [m].
    """

    radius: Length
    length: Length


@obstacle
class Capsule(Obstacle):
    """A cylinder along its z axis with a hemisphere at each end.

    Attributes:
        radius: Radius [m].
        length: Length of the straight part, without the hemispheres [m].
    """

    radius: Length
    length: Length
