"""Motions of obstacles that are given by numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from tominpmp.arrays import Array, IntArray, frozen_array
from tominpmp.checks import RotationLike, VectorLike, number, plain_rotation, wrong
from tominpmp.exceptions import SceneError
from tominpmp.scene.motion import (
    Motion,
    Placement,
    Twist,
    about_motion,
    agreed_start,
    checked_placement,
    checked_stretches,
    checked_times,
    numbers,
)
from tominpmp.scene.rotations import rotation_matrix

# Between two waypoints an obstacle turns by less than this: half a turn could go either
# way [rad].
MOST_TURN = 0.999 * np.pi
# So many waypoints are no corners any more, but samples of a smooth motion.
MOST_KINKS = 40


@dataclass(frozen=True, eq=False)
class ConstantVelocity(Motion):
    """Move and turn steadily, from a time on and up to another.

    Attributes:
        velocity: Velocity in the world [m/s], shape (3,).
        angular: Angular velocity in the world [rad/s], shape (3,).
        pivot: Point that it turns about, where that is at the start, in the world [m],
            shape (3,): a point of a hinge; None for the position of the obstacle. It
            moves with the velocity.
        begin: When the motion begins [s]; before that the obstacle rests.
        end: When it ends [s]; the obstacle stays where it is then.

    Raises:
        SceneError: If a value is wrong.
    """

    velocity: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    angular: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    pivot: Array | None = None
    begin: float = 0.0
    end: float = np.inf

    if TYPE_CHECKING:

        def __init__(
            self,
            velocity: VectorLike = ...,
            angular: VectorLike = ...,
            pivot: VectorLike | None = ...,
            begin: float = ...,
            end: float = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        """Check the values."""
        for name, unit in (("velocity", "m/s"), ("angular", "rad/s"), ("pivot", "m")):
            value = getattr(self, name)
            if name != "pivot" or value is not None:
                object.__setattr__(self, name, _triple(name, value, unit))
        expected, error = "a time >= 0 [s]", about_motion
        begin = number(self.begin, "begin", expected, least=0.0, error=error)
        end = number(self.end, "end", "a number [s]", infinite=True, error=error)
        if not end > begin:
            expected = f"a time after the beginning at {begin:g} s"
            raise wrong(self.end, "end", expected, about_motion)
        object.__setattr__(self, "begin", begin)
        object.__setattr__(self, "end", end)

    @property
    def kinks(self) -> Array:
        """When the motion begins and ends, if it does [s]."""
        return np.array([t for t in (self.begin, self.end) if 0.0 < t < np.inf])

    def _turned(self, times: Array, start: Placement) -> tuple[Array, Array, Array]:
        """Time under way (m,), rotations since the start (m, 3, 3), and levers (m, 3).

        A lever leads from the pivot to the origin of the obstacle.
        """
        times = checked_times(times)
        under_way = np.clip(times, self.begin, self.end) - self.begin
        turned = Rotation.from_rotvec(under_way[:, None] * self.angular).as_matrix()
        return under_way, turned, turned @ self._lever(start)

    def _lever(self, start: Placement) -> Array:
        p = checked_placement(start).p
        return np.zeros(3) if self.pivot is None else p - self.pivot

    def poses(self, times: Array, start: Placement) -> Placement:
        """Placements at times."""
        under_way, turned, lever = self._turned(times, start)
        p = start.p - self._lever(start) + lever + under_way[:, None] * self.velocity
        return Placement(turned @ start.R, p)

    def twists(self, times: Array, start: Placement) -> Twist:
        """Velocities at times."""
        times = checked_times(times)
        _, _, lever = self._turned(times, start)
        moving = ((times >= self.begin) & (times < self.end))[:, None]
        linear = self.velocity + np.cross(self.angular, lever)
        angular = np.broadcast_to(self.angular, linear.shape)
        return Twist(moving * linear, moving * angular)

    def speed_bounds(
        self, begin: Array, end: Array, start: Placement
    ) -> tuple[Array, Array]:
        """Largest speeds between two times."""
        turn = float(np.linalg.norm(self.angular))
        lever = float(np.linalg.norm(self._lever(start)))
        begin, end = checked_stretches(begin, end)
        moving = (end > self.begin) & (begin < self.end)
        speed = float(np.linalg.norm(self.velocity)) + turn * lever
        return np.where(moving, speed, 0.0), np.where(moving, turn, 0.0)


@dataclass(frozen=True, eq=False)
class Waypoints(Motion):
    """Pass placements at given times, steadily from one to the next.

    After the last of them the obstacle stays where it is.

    Attributes:
        times: Times [s], increasing from 0, shape (k,).
        positions: Positions in the world at these times [m], shape (k, 3), linear in
            between; None to stay at the position of the obstacle.
        rotations: Rotations obstacle_to_world, as matrices, shape (k, 3, 3), or as
            quaternions x, y, z, w, shape (k, 4), and kept as matrices; in between it
            turns about a fixed axis the shorter way. None to keep the rotation of the
            obstacle.

    Raises:
        SceneError: If times are not in order or do not begin at 0, or a shape or a
            value is wrong.
    """

    times: Array
    positions: Array | None = None
    rotations: Array | None = None

    if TYPE_CHECKING:

        def __init__(
            self,
            times: ArrayLike,
            positions: ArrayLike | None = ...,
            rotations: RotationLike | None = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        """Check times, positions and rotations."""
        times = numbers("times", self.times)
        if times.ndim != 1 or not times.size:
            raise SceneError(
                f"motion: times has shape {times.shape}, expected one time or more"
            )
        if times[0] != 0.0:
            raise SceneError(
                f"motion: times begins at {times[0]:g} s, expected 0: where the "
                "obstacle is before is not known"
            )
        back = np.flatnonzero(np.diff(times) <= 0.0)
        if back.size:
            k = int(back[0])
            raise SceneError(
                f"motion: times is not increasing: {times[k]:g} s is followed by "
                f"{times[k + 1]:g} s (waypoints {k} and {k + 1}, counted from 0)"
            )
        object.__setattr__(self, "times", times)
        if self.positions is None and self.rotations is None:
            raise SceneError("motion: Waypoints needs positions, rotations, or both")
        if self.positions is not None:
            positions = numbers("positions", self.positions)
            self._check_shape("positions", positions, ((times.size, 3),))
            object.__setattr__(self, "positions", positions)
        if self.rotations is not None:
            object.__setattr__(self, "rotations", self._matrices())

    def _check_shape(
        self, name: str, value: Array, shapes: tuple[tuple[int, ...], ...]
    ) -> None:
        if value.shape not in shapes:
            expected = " or ".join(str(shape) for shape in shapes)
            raise SceneError(
                f"motion: {name} has shape {value.shape}, expected {expected}, as "
                f"there are {self.times.size} times"
            )

    def _matrices(self) -> Array:
        given = numbers("rotations", plain_rotation(self.rotations))
        count = self.times.size
        self._check_shape("rotations", given, ((count, 4), (count, 3, 3)))
        found = []
        for k, value in enumerate(given):
            try:
                found.append(rotation_matrix(value))
            except SceneError as error:
                raise SceneError(
                    f"motion: rotations: waypoint {k} (counted from 0) is "
                    f"{value.tolist()}, expected a rotation matrix or a quaternion "
                    "(x, y, z, w) whose length is not zero"
                ) from error
        matrices = frozen_array(found)
        turns = np.linalg.norm(_turns(matrices), axis=1)
        if np.any(turns > MOST_TURN):
            k = int(np.argmax(turns))
            raise SceneError(
                f"motion: rotations: half a turn from waypoint {k} to {k + 1} (counted "
                "from 0) could go either way; put another one between them"
            )
        return matrices

    def start(self, given: Placement) -> Placement:
        """Placement at the first waypoint."""
        given = checked_placement(given, "given")
        R = given.R if self.rotations is None else self.rotations[0]
        p = given.p if self.positions is None else self.positions[0]
        return agreed_start(given, Placement(R, p))

    @property
    def kinks(self) -> Array:
        """Times of the waypoints, as far as they are few [s]."""
        times = self.times[1:]
        return times if times.size <= MOST_KINKS else np.zeros(0)

    @cached_property
    def _rates(self) -> Twist:
        """Velocities from each waypoint to the next, shape (k, 3), and none at last.

        Angular ones are in the axes of the obstacle, about which it turns.
        """
        lengths = np.append(np.diff(self.times), np.inf)[:, None]
        moved = turned = np.zeros((self.times.size, 3))
        if self.positions is not None:
            moved = np.diff(self.positions, axis=0, append=self.positions[-1:])
        if self.rotations is not None:
            turned = np.append(_turns(self.rotations), np.zeros((1, 3)), axis=0)
        return Twist(moved / lengths, turned / lengths)

    def _passed(self, times: Array) -> IntArray:
        """The last waypoint before each time."""
        k = np.searchsorted(self.times, times, side="right") - 1
        return np.maximum(k, 0)

    def poses(self, times: Array, start: Placement) -> Placement:
        """Placements at times."""
        times, start = checked_times(times), checked_placement(start)
        k = self._passed(times)
        since = np.maximum(times - self.times[k], 0.0)[:, None]
        R = start.R if self.rotations is None else self.rotations[k]
        p = start.p if self.positions is None else self.positions[k]
        turn = Rotation.from_rotvec(since * self._rates.angular[k]).as_matrix()
        return Placement(R @ turn, p + since * self._rates.linear[k])

    def twists(self, times: Array, start: Placement) -> Twist:
        """Velocities at times."""
        k = self._passed(checked_times(times))
        linear, angular = self._rates.linear[k], self._rates.angular[k]
        if self.rotations is not None:
            # The axis of a turn is the same before and after it.
            angular = np.einsum("mij,mj->mi", self.rotations[k], angular)
        return Twist(linear, angular)

    def speed_bounds(
        self, begin: Array, end: Array, start: Placement
    ) -> tuple[Array, Array]:
        """Largest speeds between two times."""
        begin, end = checked_stretches(begin, end)
        first = self._passed(begin)
        last = np.maximum(np.searchsorted(self.times, end, side="left"), first + 1)
        linear, angular = (np.linalg.norm(rate, axis=1) for rate in self._rates)
        return _largest(linear, first, last), _largest(angular, first, last)


def _turns(rotations: Array) -> Array:
    """Rotation vectors from each rotation to the next, in its axes, (k - 1, 3)."""
    if len(rotations) < 2:
        return np.zeros((0, 3))
    between = np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]
    return np.asarray(Rotation.from_matrix(between).as_rotvec())


def _largest(values: Array, first: IntArray, last: IntArray) -> Array:
    """Largest of values[first:last] for many ranges, none of them empty."""
    if not first.size:
        return np.zeros(0)
    padded = np.append(values, 0.0)  # so that the end is a place too
    ranges = np.stack([first, last], axis=1).ravel()
    return np.asarray(np.maximum.reduceat(padded, ranges)[::2])


def _triple(name: str, value: object, unit: str) -> Array:
    found = numbers(name, value)
    if found.shape != (3,):
        raise wrong(value, name, f"three numbers [{unit}]", about_motion)
    return found
