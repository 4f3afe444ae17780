"""Motions of obstacles: placements as functions of real time.

Time counts from the start of the robot's motion. A motion gives placements, velocities
for the time derivatives of distances, and bounds on speeds, which bound the
displacements of points of an obstacle between two instants.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property, partial
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from tominpmp.arrays import (
    Array,
    Converted,
    IntArray,
    Record,
    default,
    frozen_array,
    record,
)
from tominpmp.checks import (
    HUGE,
    Amount,
    PointOrNone,
    RotationLike,
    Seconds,
    VectorLike,
    array,
    instance,
    number,
    of_type,
    plain_rotation,
    raised_as,
    vector,
)
from tominpmp.exceptions import ProblemError, SceneError, brief
from tominpmp.scene.rotations import checked_pose, rotation_matrix

# Difference up to which placements at the start are equal [m, rad].
SAME = 1e-6
# Largest rotation between two waypoints: half a turn has no unique direction [rad].
MOST_TURN = 0.999 * np.pi
# Number of waypoints above which they are samples of a smooth motion, not corners.
MOST_KINKS = 40
# Step of the finite differences for the velocity of a function [s].
STEP = 1e-4
# Number of samples in a time interval that estimate the speed of a function without
# bounds, and the safety factor on the sampled speed.
SPEED_SAMPLES = 5
SAFETY = 1.5
# Tolerance of finite differences that are compared with a bound on the speed.
FASTER = 1e-5


class Placement(NamedTuple):
    """One placement obstacle_to_world, or many.

    Attributes:
        R: Rotations, shape (..., 3, 3).
        p: Positions [m], shape (..., 3).
    """

    R: Array
    p: Array


class Twist(NamedTuple):
    """Velocities of an obstacle, in the axes of the world.

    Attributes:
        linear: Velocities of the origin [m/s], shape (m, 3).
        angular: Angular velocities [rad/s], shape (m, 3).
    """

    linear: Array
    angular: Array


class SpeedBounds(NamedTuple):
    """Upper bounds on the speeds of an obstacle.

    Attributes:
        linear: Speeds of the origin [m/s], shape (m,).
        angular: Angular speeds [rad/s], shape (m,).
    """

    linear: Array
    angular: Array


class Motion(Record, ABC):
    """Motion of an obstacle: its placement at each time from 0 on [s]."""

    def __post_init__(self) -> None:
        """Check the values."""
        with raised_as(lambda message, _: SceneError(f"motion: {message}")):
            super().__post_init__()
            self._check()

    def _check(self) -> None:
        """Check what the values of a subclass have in common, and convert them."""

    def start(self, given: Placement) -> Placement:
        """Placement at time 0.

        Args:
            given: Placement of the obstacle from the caller, which may be the identity.

        Raises:
            SceneError: If the motion begins at another placement, or at no placement.
        """
        begins = self._begins(instance(given, Placement, "given"))
        for name, value, first, usual in (
            ("position", given.p, begins.p, np.zeros(3)),
            ("rotation", given.R, begins.R, np.eye(3)),
        ):
            free = np.array_equal(value, usual)
            if not free and not np.allclose(value, first, rtol=0.0, atol=SAME):
                raise SceneError(
                    f"{name} is {value.tolist()}, and its motion begins with "
                    f"{first.tolist()}: expected the same, or no {name}"
                )
        # A motion that adds an offset to its start would add it a second time.
        for name, first, again in zip(
            ("rotation", "position"), begins, self._begins(begins), strict=True
        ):
            if not np.allclose(again, first, rtol=0.0, atol=SAME):
                raise SceneError(
                    f"motion: from the {name} {first.tolist()} it begins with "
                    f"{again.tolist()}: expected the same"
                )
        return begins

    def _begins(self, start: Placement) -> Placement:
        """Placement at time 0 of the motion from a start, checked."""
        R, p = self.poses(np.zeros(1), start)
        # The motion of a caller may have one rotation, or one position, for all times.
        return _checked_placement((np.squeeze(p), np.squeeze(R)), 0.0)

    @property
    def kinks(self) -> Array:
        """Known times after the start at which the velocity jumps [s], shape (k,)."""
        return np.zeros(0)

    @abstractmethod
    def poses(self, times: Array, start: Placement) -> Placement:
        """Placements at times [s], shape (m,), from the placement at the start."""

    @abstractmethod
    def twists(self, times: Array, start: Placement) -> Twist:
        """Velocities at times [s], shape (m,); at a jump the velocity after it."""

    @abstractmethod
    def speed_bounds(self, begin: Array, end: Array, start: Placement) -> SpeedBounds:
        """Upper bounds on the speeds within time intervals.

        Args:
            begin: Beginnings of the intervals [s], shape (m,).
            end: Ends of the intervals [s], shape (m,).
            start: Placement at time 0.
        """


def _checked_placement(pose: object, time: float) -> Placement:
    """Check a caller's placement at a time [s]."""
    with raised_as(lambda message, _: SceneError(message)):
        checked = checked_pose(pose, f"motion: the placement at {time:g} s")
    return Placement(np.array(checked.rotation), np.array(checked.translation))


def _checked_times(value: Array, name: str = "times") -> Array:
    """Check a caller's times, shape (m,) [s]."""
    return array(value, name, (None,), "times [s]")


def _checked_intervals(begin: Array, end: Array) -> tuple[Array, Array]:
    """Check a caller's time intervals: an end for each beginning [s], shape (k,)."""
    begin = _checked_times(begin, "begin")
    return begin, array(end, "end", begin.shape, "times [s], one for each beginning")


# -- motions that are given by numbers -------------------------------------------------


def finite_numbers(value: Any, name: str) -> Array:
    """Check a caller's array of finite numbers, of any shape.

    Raises:
        ProblemError: If it is not made of finite numbers.
    """
    numbers = frozen_array(array(value, name, (...,), "numbers"))
    if not np.all(np.isfinite(numbers)):
        where = np.argwhere(~np.isfinite(numbers))[0].tolist()
        raise ProblemError(f"{name} has a value that is not finite, at index {where}")
    return numbers


Velocity: TypeAlias = Annotated[
    Converted[VectorLike, Array],
    partial(vector, expected="three numbers [m/s]", size=3),
]
AngularVelocity: TypeAlias = Annotated[
    Converted[VectorLike, Array],
    partial(vector, expected="three numbers [rad/s]", size=3),
]
End: TypeAlias = Annotated[
    float, partial(number, expected="a number [s]", infinite=True)
]


@record
class ConstantVelocity(Motion):
    """Move and rotate at constant velocities, from one time to another.

    Attributes:
        velocity: Velocity in the world [m/s], shape (3,).
        angular: Angular velocity in the world [rad/s], shape (3,).
        pivot: Point of the axis of rotation at the start, in the world [m], shape (3,),
            for example a point of a hinge; None for the position of the obstacle. The
            pivot moves with the velocity.
        begin: Start of the motion [s], before which the obstacle rests.
        end: End of the motion [s], after which the obstacle rests.

    Raises:
        SceneError: If a value is wrong.
    """

    velocity: Velocity = default((0.0, 0.0, 0.0))
    angular: AngularVelocity = default((0.0, 0.0, 0.0))
    pivot: PointOrNone = default(None)
    begin: Seconds = 0.0
    end: End = np.inf

    def _check(self) -> None:
        """Check that the end is after the beginning."""
        if not self.end > self.begin:
            expected = f"a time after the beginning at {self.begin:g} s"
            raise ProblemError(f"end is {self.end:g}, expected {expected}")

    def start(self, given: Placement) -> Placement:
        """The given placement: the motion may begin anywhere."""
        return instance(given, Placement, "given")

    @property
    def kinks(self) -> Array:
        """Start and end of the motion, where positive and finite [s], shape (k,)."""
        return np.array([t for t in (self.begin, self.end) if 0.0 < t < np.inf])

    def _turned(self, times: Array) -> tuple[Array, Array]:
        """Elapsed times of the motion, (m, 1) [s], and rotations since the start."""
        elapsed = np.clip(times, self.begin, self.end)[:, None] - self.begin
        return elapsed, Rotation.from_rotvec(elapsed * self.angular).as_matrix()

    def _lever(self, start: Placement) -> Array:
        """Vector from the pivot to the obstacle's origin at the start, (3,) [m]."""
        p = instance(start, Placement, "start").p
        return np.zeros(3) if self.pivot is None else p - self.pivot

    def poses(self, times: Array, start: Placement) -> Placement:
        """Placements at times."""
        elapsed, turned = self._turned(_checked_times(times))
        lever = self._lever(start)
        p = start.p - lever + turned @ lever + elapsed * self.velocity
        return Placement(turned @ start.R, p)

    def twists(self, times: Array, start: Placement) -> Twist:
        """Velocities at times."""
        times = _checked_times(times)
        lever = self._turned(times)[1] @ self._lever(start)
        moving = ((times >= self.begin) & (times < self.end))[:, None]
        linear = self.velocity + np.cross(self.angular, lever)
        angular = np.broadcast_to(self.angular, linear.shape)
        return Twist(moving * linear, moving * angular)

    def speed_bounds(self, begin: Array, end: Array, start: Placement) -> SpeedBounds:
        """Largest speeds between two times."""
        turn = float(np.linalg.norm(self.angular))
        lever = float(np.linalg.norm(self._lever(start)))
        begin, end = _checked_intervals(begin, end)
        moving = (end > self.begin) & (begin < self.end)
        speed = float(np.linalg.norm(self.velocity)) + turn * lever
        return SpeedBounds(np.where(moving, speed, 0.0), np.where(moving, turn, 0.0))


def _waypoint_times(value: Any, name: str) -> Array:
    """Check times of waypoints [s], shape (k,)."""
    times = finite_numbers(value, name)
    if times.ndim != 1 or not times.size:
        raise ProblemError(f"{name} has shape {times.shape}, expected one time or more")
    if times[0] != 0.0:
        raise ProblemError(
            f"{name} begins at {times[0]:g} s, expected 0: the placement of the "
            "obstacle before is not known"
        )
    unordered = np.flatnonzero(np.diff(times) <= 0.0)
    if unordered.size:
        k = int(unordered[0])
        raise ProblemError(
            f"{name} is not increasing: {times[k]:g} s is followed by "
            f"{times[k + 1]:g} s (waypoints {k} and {k + 1}, counted from 0)"
        )
    return times


def _matrices(given: Array) -> Array:
    """Rotations of waypoints as matrices, shape (k, 3, 3)."""
    matrices = frozen_array(
        [
            rotation_matrix(value, f"rotations: waypoint {k} (counted from 0)")
            for k, value in enumerate(given)
        ]
    )
    turns = np.linalg.norm(_turns(matrices), axis=1)
    if np.any(turns > MOST_TURN):
        k = int(np.argmax(turns))
        raise ProblemError(
            f"rotations: half a turn from waypoint {k} to {k + 1} (counted from 0) has "
            "no unique direction; put another waypoint between them"
        )
    return matrices


Times: TypeAlias = Annotated[Converted[ArrayLike, Array], _waypoint_times]
NumbersOrNone: TypeAlias = Annotated[
    Converted[ArrayLike | None, Array | None], finite_numbers
]
RotationsOrNone: TypeAlias = Annotated[
    Converted[RotationLike | None, Array | None],
    lambda value, name: finite_numbers(plain_rotation(value), name),
]


@record
class Waypoints(Motion):
    """Pass waypoints at given times, with constant velocities between them.

    The obstacle rests after the last waypoint.

    Attributes:
        times: Times of the waypoints [s], increasing from 0, shape (k,).
        positions: Positions of the waypoints in the world [m], shape (k, 3), with
            linear interpolation between them; None for the position of the obstacle.
        rotations: Rotations obstacle_to_world of the waypoints, as matrices, shape
            (k, 3, 3), or as quaternions x, y, z, w, shape (k, 4), which are stored as
            matrices; between two waypoints the obstacle turns about a fixed axis by the
            smaller angle. None for the rotation of the obstacle.

    Raises:
        SceneError: If times are not in order or do not begin at 0, or a shape or a
            value is wrong.
    """

    times: Times
    positions: NumbersOrNone = default(None)
    rotations: RotationsOrNone = default(None)

    def _check(self) -> None:
        """Check that each time has a position, or a rotation."""
        if self.positions is None and self.rotations is None:
            raise ProblemError("Waypoints needs positions, rotations, or both")
        count = self.times.size
        for name, shapes in (
            ("positions", [(count, 3)]),
            ("rotations", [(count, 4), (count, 3, 3)]),
        ):
            value = getattr(self, name)
            if value is not None and value.shape not in shapes:
                raise ProblemError(
                    f"{name} has shape {value.shape}, expected "
                    f"{' or '.join(map(str, shapes))}, as there are {count} times"
                )
        far = 0.0 if self.positions is None else float(np.abs(self.positions).max())
        if far > HUGE:
            raise ProblemError(
                f"positions are {far:.3g} m away, expected at most {HUGE:g} m"
            )
        if self.rotations is not None:
            self._keep(rotations=_matrices(self.rotations))

    @property
    def kinks(self) -> Array:
        """Times of the waypoints after the first, if they are few [s], shape (k,)."""
        times = self.times[1:]
        return times if times.size <= MOST_KINKS else np.zeros(0)

    @cached_property
    def _rates(self) -> Twist:
        """Velocities from each waypoint to the next, shape (k, 3); zero at the last.

        Angular velocities are in the axes of the obstacle.
        """
        durations = np.append(np.diff(self.times), np.inf)[:, None]
        moved = turned = np.zeros((self.times.size, 3))
        if self.positions is not None:
            moved = np.diff(self.positions, axis=0, append=self.positions[-1:])
        if self.rotations is not None:
            turned = np.append(_turns(self.rotations), np.zeros((1, 3)), axis=0)
        return Twist(moved / durations, turned / durations)

    def _passed(self, times: Array) -> IntArray:
        """Index of the last waypoint before each time, shape (m,)."""
        k = np.searchsorted(self.times, times, side="right") - 1
        return np.maximum(k, 0)

    def poses(self, times: Array, start: Placement) -> Placement:
        """Placements at times."""
        times, start = _checked_times(times), instance(start, Placement, "start")
        k = self._passed(times)
        since = np.maximum(times - self.times[k], 0.0)[:, None]
        R = start.R if self.rotations is None else self.rotations[k]
        p = start.p if self.positions is None else self.positions[k]
        turn = Rotation.from_rotvec(since * self._rates.angular[k]).as_matrix()
        return Placement(R @ turn, p + since * self._rates.linear[k])

    def twists(self, times: Array, start: Placement) -> Twist:
        """Velocities at times."""
        k = self._passed(_checked_times(times))
        linear, angular = self._rates.linear[k], self._rates.angular[k]
        if self.rotations is not None:
            # A rotation leaves its own axis unchanged: either rotation transforms it.
            angular = np.einsum("mij,mj->mi", self.rotations[k], angular)
        return Twist(linear, angular)

    def speed_bounds(self, begin: Array, end: Array, start: Placement) -> SpeedBounds:
        """Largest speeds between two times."""
        begin, end = _checked_intervals(begin, end)
        first = self._passed(begin)
        last = np.maximum(np.searchsorted(self.times, end, side="left"), first + 1)
        ranges = np.stack([first, last], axis=1).ravel()
        # Padded, as the end of a range has to be an index of the array.
        speeds = [np.append(np.linalg.norm(x, axis=1), 0.0) for x in self._rates]
        return SpeedBounds(*(np.maximum.reduceat(x, ranges)[::2] for x in speeds))


def _turns(rotations: Array) -> Array:
    """Rotation vectors from each rotation to the next, (k - 1, 3) [rad].

    They are in the axes of the earlier rotation.
    """
    if len(rotations) < 2:
        return np.zeros((0, 3))
    between = np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]
    return np.asarray(Rotation.from_matrix(between).as_rotvec())


# -- motions that are given by functions -----------------------------------------------


Function: TypeAlias = Annotated[Callable[[float], Any], of_type(Callable, "one")]


@record
class PoseFunction(Motion):
    """Placements by a function of time.

    The function is called with times from 0 to slightly beyond the end of a motion, in
    any order, and must give equal placements for equal times. Velocities are finite
    differences, so that the function should be smooth at the scale of a millisecond.
    For planning in several processes, the function has to be picklable.

    Attributes:
        function: Placement obstacle_to_world at a time [s]: a matrix of shape (4, 4),
            a ``pinocchio.SE3``, or a pair of a position and a rotation.
        speed: Upper bound on the speed of the origin [m/s], for proofs of clearance;
            None for an estimate from samples.
        angular_speed: Upper bound on the angular speed [rad/s], for proofs of
            clearance; None for an estimate from samples.

    Raises:
        SceneError: If the function fails or gives no placement, or a sample is faster
            than its bound.
    """

    function: Function
    speed: Amount | None = None
    angular_speed: Amount | None = None

    def _pose(self, time: float) -> Placement:
        """Placement at a time [s], checked."""
        try:
            value = self.function(time)
        except Exception as error:  # whatever a user's function may raise
            raise SceneError(
                f"motion: the function fails at {time:g} s: "
                f"{type(error).__name__}: {error}"
            ) from error
        return _checked_placement(value, time)

    def poses(self, times: Array, start: Placement) -> Placement:
        """Placements at times."""
        poses = [self._pose(time) for time in _checked_times(times).tolist()]
        return Placement(
            np.array([item.R for item in poses]).reshape(-1, 3, 3),
            np.array([item.p for item in poses]).reshape(-1, 3),
        )

    def twists(self, times: Array, start: Placement) -> Twist:
        """Velocities at times, by finite differences of second order."""
        times = _checked_times(times)
        # The differences are central, except at the start, before which there is no
        # time.
        base = np.maximum(times - STEP, 0.0)
        R, p = self.poses(base, start)
        changes = []
        for steps in (1.0, 2.0):
            later = self.poses(base + steps * STEP, start)
            turn = Rotation.from_matrix(later.R @ np.swapaxes(R, 1, 2)).as_rotvec()
            changes.append(np.concatenate([later.p - p, turn], axis=1) / STEP)
        first, second = changes
        centre = ((times - base) / STEP)[:, None]
        # Slope of the parabola through the values after zero, one and two steps.
        rate = first * (2.0 - 2.0 * centre) + second * (centre - 0.5)
        twist = Twist(rate[:, :3], rate[:, 3:])
        for name, velocity in zip(("speed", "angular_speed"), twist, strict=True):
            bound, speeds = getattr(self, name), np.linalg.norm(velocity, axis=1)
            if bound is not None and np.any(speeds > bound * (1.0 + FASTER) + FASTER):
                k = int(np.argmax(speeds))
                raise SceneError(
                    f"motion: {name} is {bound:g}, and at {times[k]:g} s the function "
                    f"has the speed {speeds[k]:.6g}: expected an upper bound"
                )
        return twist

    def speed_bounds(self, begin: Array, end: Array, start: Placement) -> SpeedBounds:
        """Bounds on the speeds within time intervals; estimates without bounds."""
        begin, end = _checked_intervals(begin, end)
        stated = self.speed, self.angular_speed
        bounds = [np.full(begin.shape, np.nan if x is None else x) for x in stated]
        if None in stated:
            shares = np.linspace(0.0, 1.0, SPEED_SAMPLES)
            times = begin[:, None] + (end - begin)[:, None] * shares
            rates = self.twists(times.ravel(), start)
            sampled = [np.linalg.norm(x, axis=1).reshape(times.shape) for x in rates]
            for bound, speeds in zip(bounds, sampled, strict=True):
                estimate = SAFETY * speeds.max(axis=1)
                bound[:] = np.where(np.isnan(bound), estimate, bound)
        return SpeedBounds(*bounds)


def as_motion(value: object) -> Motion:
    """Convert a caller's motion, or function from time to a placement, to a motion.

    Raises:
        SceneError: If the value is neither a motion nor a function.
    """
    if isinstance(value, Motion):
        return value
    if callable(value) and not isinstance(value, type):
        return PoseFunction(value)
    raise SceneError(
        f"motion is {brief(value)}, expected a ConstantVelocity, Waypoints, a function "
        "from time [s] to a placement, or None"
    )
