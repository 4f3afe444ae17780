"""Motions of obstacles that are functions of the caller's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tominpmp.arrays import Array, real_array
from tominpmp.checks import number, split_pose, wrong
from tominpmp.exceptions import SceneError, brief
from tominpmp.scene.motion import (
    Motion,
    Placement,
    Twist,
    about_motion,
    agreed_start,
    checked_placement,
    checked_stretches,
    checked_times,
)
from tominpmp.scene.rotations import is_rotation, rotation_matrix

# Step of the differences that give the velocity of a function [s].
STEP = 1e-4
# A function that says nothing of its speed is looked at this often in a stretch of
# time, and taken to be faster than it was seen to be by this factor.
LOOKS = 5
CAUTION = 1.5
# What differences may be off by when they are compared with a bound on the speed.
FASTER = 1e-5


def as_motion(value: object) -> Motion:
    """Take a motion, or a function from time to a placement, as a motion.

    Raises:
        SceneError: If it is neither.
    """
    if isinstance(value, Motion):
        return value
    if callable(value) and not isinstance(value, type):
        return PoseFunction(value)
    raise SceneError(
        f"motion is {brief(value)}, expected a ConstantVelocity, Waypoints, a function "
        "from time [s] to a placement, or None"
    )


def _homogeneous(position: object, rotation: object) -> Array:
    """A placement of shape (4, 4) of a position and a rotation."""
    matrix = np.eye(4)
    turn = real_array(rotation)
    matrix[:3, :3] = turn if turn.ndim == 2 else rotation_matrix(turn)
    matrix[:3, 3] = real_array(position)
    return matrix


@dataclass(frozen=True, eq=False)
class PoseFunction(Motion):
    """Be where a function says.

    The function is called with times from 0 to a little beyond the end of a motion, in
    any order, and must give the same placement for the same time. Its velocity is taken
    from differences, so that it should be smooth at the scale of a millisecond. To plan
    in several processes, it has to be picklable.

    Attributes:
        function: Placement obstacle_to_world at a time [s]: a matrix of shape (4, 4),
            a ``pinocchio.SE3``, or a pair of a position and a rotation.
        speed: Bound on the speed of the origin [m/s], which a proof of clearance rests
            on; None where it is not known: it is then estimated from samples.
        angular_speed: Bound on the angular speed [rad/s] likewise.

    Raises:
        SceneError: If the function fails or gives no placement, or is seen to be faster
            than it is said to be.
    """

    function: Callable[[float], Any]
    speed: float | None = None
    angular_speed: float | None = None

    def __post_init__(self) -> None:
        """Check the function and the bounds."""
        if not callable(self.function):
            raise wrong(self.function, "function", "one", about_motion)
        for name in ("speed", "angular_speed"):
            value, error = getattr(self, name), about_motion
            if value is not None:
                value = number(value, name, "0 or more", least=0.0, error=error)
                object.__setattr__(self, name, value)

    def start(self, given: Placement) -> Placement:
        """Placement at time 0."""
        given = checked_placement(given, "given")
        return agreed_start(given, self._pose(0.0))

    def _pose(self, time: float) -> Placement:
        try:
            value = self.function(time)
            pose = split_pose(value)
            matrix = real_array(value) if pose is None else _homogeneous(*pose)
        except Exception as error:  # whatever a user's function may raise
            raise SceneError(
                f"motion: the function fails at {time:g} s: "
                f"{type(error).__name__}: {error}"
            ) from error
        if matrix.shape != (4, 4):
            raise SceneError(
                f"motion: the function gives shape {matrix.shape} at {time:g} s, "
                "expected a placement of shape (4, 4)"
            )
        R, p = matrix[:3, :3], matrix[:3, 3]
        if not (np.all(np.isfinite(p)) and is_rotation(R)):
            raise SceneError(
                f"motion: the function gives no placement at {time:g} s: expected a "
                "rotation matrix and finite coordinates"
            )
        return Placement(R, p)

    def poses(self, times: Array, start: Placement) -> Placement:
        """Placements at times."""
        found = [self._pose(time) for time in checked_times(times).tolist()]
        return Placement(
            np.array([item.R for item in found]).reshape(-1, 3, 3),
            np.array([item.p for item in found]).reshape(-1, 3),
        )

    def twists(self, times: Array, start: Placement) -> Twist:
        """Velocities at times, from differences of second order."""
        # At the very start there is nothing before it.
        times = checked_times(times)
        base = np.maximum(times - STEP, 0.0)
        R, p = self.poses(base, start)
        parts = []
        for steps in (1.0, 2.0):
            there = self.poses(base + steps * STEP, start)
            turn = Rotation.from_matrix(there.R @ np.swapaxes(R, 1, 2)).as_rotvec()
            parts.append(np.concatenate([there.p - p, turn], axis=1) / STEP)
        one, two = parts
        centre = ((times - base) / STEP)[:, None]
        # The slope of the parabola through no, one and two steps.
        rate = one * (2.0 - 2.0 * centre) + two * (centre - 0.5)
        twist = Twist(rate[:, :3], rate[:, 3:])
        self._check_speed(times, "speed", self.speed, twist.linear)
        self._check_speed(times, "angular_speed", self.angular_speed, twist.angular)
        return twist

    @staticmethod
    def _check_speed(
        times: Array, name: str, bound: float | None, velocity: Array
    ) -> None:
        if bound is None or not times.size:
            return
        seen = np.linalg.norm(velocity, axis=1)
        k = int(np.argmax(seen))
        if seen[k] > bound * (1.0 + FASTER) + FASTER:
            raise SceneError(
                f"motion: {name} is {bound:g}, and at {times[k]:g} s the function has "
                f"{seen[k]:.6g}: expected a bound that holds"
            )

    def speed_bounds(
        self, begin: Array, end: Array, start: Placement
    ) -> tuple[Array, Array]:
        """Largest speeds between two times; estimates where none were given."""
        begin, end = checked_stretches(begin, end)
        linear, angular = self.speed, self.angular_speed
        if linear is not None and angular is not None:
            return np.full(begin.shape, linear), np.full(begin.shape, angular)
        shares = np.linspace(0.0, 1.0, LOOKS)
        times = begin[:, None] + (end - begin)[:, None] * shares
        twist = self.twists(times.ravel(), start)
        seen = [
            CAUTION * np.linalg.norm(part, axis=1).reshape(times.shape).max(axis=1)
            for part in twist
        ]
        return (
            seen[0] if linear is None else np.full(begin.shape, linear),
            seen[1] if angular is None else np.full(begin.shape, angular),
        )
