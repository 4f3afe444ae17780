"""Obstacles of simple shape.

Poses are given in the world frame [m]; rotations as a 3x3 matrix or a quaternion in the
order x, y, z, w. Cylinders and capsules stand along their z axis.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, TypedDict

import numpy as np

from tominpmp.arrays import Array, Record, array_or_nan, frozen_array
from tominpmp.checks import (
    PoseLike,
    RotationLike,
    VectorLike,
    number,
    plain_rotation,
    plain_vector,
    split_pose,
    wrong,
)
from tominpmp.exceptions import SceneError, brief
from tominpmp.scene.motion import (
    Motion,
    Placement,
    Twist,
    checked_stretches,
    checked_times,
)
from tominpmp.scene.paths import ConstantVelocity
from tominpmp.scene.pose_function import as_motion
from tominpmp.scene.rotations import rotation_matrix

if TYPE_CHECKING:
    from typing_extensions import Unpack

# Names appear in messages [characters].
LONGEST_NAME = 255
# The motion of an obstacle that has none.
REST = ConstantVelocity()


class Placed(TypedDict, total=False):
    """What every obstacle may be given, for type checkers; see :class:`Obstacle`."""

    position: VectorLike | PoseLike
    rotation: RotationLike | None
    motion: Motion | Callable[[float], Any] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Obstacle(Record):
    """A body in the world, at rest or moving.

    Attributes:
        name: Name, unique in its scene.
        position: Position of its centre in the world [m], shape (3,); of an obstacle
            that moves, at the start of the robot's motion. A whole pose (a
            ``pinocchio.SE3``, a 4x4 matrix) gives the rotation too.
        rotation: Rotation obstacle_to_world, shape (3, 3), at the start likewise; may
            be given as a quaternion (x, y, z, w) or a ``Rotation`` of SciPy.
        motion: How it moves; None for an obstacle at rest. A function from time [s] to
            a placement is taken as a :class:`PoseFunction`. Where the motion gives
            positions or rotations itself, those above need not be given.
    """

    name: str = field(kw_only=False)
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    motion: Motion | None = None

    # Fields of a kind of obstacle that hold lengths [m].
    _lengths: ClassVar[tuple[str, ...]] = ()

    if TYPE_CHECKING:

        def __init__(self, name: str, **given: Unpack[Placed]) -> None: ...

    def __post_init__(self) -> None:
        """Check name, position, rotation and motion."""
        name = self.name
        if not isinstance(name, str) or not name or len(name) > LONGEST_NAME:
            raise SceneError(
                f"an obstacle needs a name of at most {LONGEST_NAME} characters, not "
                f"{brief(name)}"
            )
        self._take_pose()
        object.__setattr__(self, "position", self._triple("position", "coordinates"))
        object.__setattr__(self, "rotation", rotation_matrix(self.rotation, self.name))
        if self.motion is not None:
            self._set_motion()
        for key in self._lengths:
            object.__setattr__(self, key, self._length(key, getattr(self, key)))

    def _take_pose(self) -> None:
        """Take the position from what has x, y and z, or both from a pose."""
        object.__setattr__(self, "position", plain_vector(self.position))
        pose = None if _is_point(self.position) else split_pose(self.position)
        if pose is None:
            return
        turned = self.rotation is not None and not np.array_equal(
            array_or_nan(plain_rotation(self.rotation)), np.eye(3)
        )
        if turned:
            raise self._error(
                "position is a whole pose, and rotation is given too, expected one or "
                "the other"
            )
        object.__setattr__(self, "position", pose[0])
        object.__setattr__(self, "rotation", pose[1])

    def _set_motion(self) -> None:
        with self._named():
            motion = as_motion(self.motion)
            start = motion.start(self._start)
        object.__setattr__(self, "motion", motion)
        object.__setattr__(self, "rotation", frozen_array(start.R))
        object.__setattr__(self, "position", frozen_array(start.p))

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Add the name of the obstacle to what is wrong with its motion."""
        try:
            yield
        except SceneError as error:
            raise self._error(str(error)) from error

    def _error(self, message: str, _: str = "") -> SceneError:
        return SceneError(f"obstacle {self.name!r}: {message}", self.name)

    @property
    def _start(self) -> Placement:
        return Placement(self.rotation, self.position)

    def poses(self, times: Array) -> Placement:
        """Placements obstacle_to_world at times [s], shape (m,), from 0 on.

        Returns:
            Rotations, shape (m, 3, 3), and positions [m], shape (m, 3).

        Raises:
            SceneError: If a function that moves it gives no placement.
        """
        times = checked_times(times)
        with self._named():
            return (self.motion or REST).poses(times, self._start)

    def twists(self, times: Array) -> Twist:
        """Velocities at times [s], shape (m,), in the axes of the world."""
        times = checked_times(times)
        with self._named():
            return (self.motion or REST).twists(times, self._start)

    def speed_bounds(self, begin: Array, end: Array) -> tuple[Array, Array]:
        """Largest speeds between times [s], shape (m,) each.

        Returns:
            Of the origin [m/s] and of the rotation [rad/s], shape (m,) each.
        """
        begin, end = checked_stretches(begin, end)
        with self._named():
            return (self.motion or REST).speed_bounds(begin, end, self._start)

    def frozen(self, time: float) -> Obstacle:
        """The same obstacle at rest where it is at a time [s]."""
        R, p = self.poses(np.array([number(time, "time", "a time [s]")]))
        return replace(self, motion=None, rotation=R[0], position=p[0])

    def _triple(self, key: str, content: str) -> Array:
        value = getattr(self, key)
        array = array_or_nan(value)
        if array.shape != (3,) or not np.all(np.isfinite(array)):
            raise wrong(value, key, f"three finite {content} [m]", self._error)
        return array

    def _length(self, key: str, value: object) -> float:
        expected = "a positive length [m]"
        return number(value, key, expected, above=0.0, error=self._error)


def _is_point(value: object) -> bool:
    return array_or_nan(value).shape == (3,)


@dataclass(frozen=True, kw_only=True, eq=False)
class Sphere(Obstacle):
    """A ball.

    Attributes:
        radius: Radius [m].
    """

    radius: float

    _lengths = ("radius",)

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            *,
            radius: float,
            **given: Unpack[Placed],
        ) -> None: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Box(Obstacle):
    """A cuboid.

    Attributes:
        size: Full edge lengths along x, y and z [m], shape (3,).
    """

    size: Array

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            *,
            size: VectorLike,
            **given: Unpack[Placed],
        ) -> None: ...

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

    _lengths = ("radius", "length")

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            *,
            radius: float,
            length: float,
            **given: Unpack[Placed],
        ) -> None: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Capsule(Obstacle):
    """A cylinder along its z axis with a half ball at either end.

    Attributes:
        radius: Radius [m].
        length: Length of the straight part, without the half balls [m].
    """

    radius: float
    length: float

    _lengths = ("radius", "length")

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            *,
            radius: float,
            length: float,
            **given: Unpack[Placed],
        ) -> None: ...
