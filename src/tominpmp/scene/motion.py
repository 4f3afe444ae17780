"""How obstacles move: placements as functions of real time.

Time counts from the start of the robot's motion. A motion gives placements, the
velocities that the derivative of a distance by time needs, and bounds on speeds, which
tell how far a point of an obstacle can come between two instants.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, Record, real_array
from tominpmp.checks import array, instance
from tominpmp.exceptions import SceneError

# Two placements at the start that differ by less are one [m, rad].
SAME = 1e-6


class Placement(NamedTuple):
    """Placements obstacle_to_world, one or many.

    Attributes:
        R: Rotations, shape (..., 3, 3).
        p: Positions [m], shape (..., 3).
    """

    R: Array
    p: Array


class Twist(NamedTuple):
    """Velocities of obstacles, in the axes of the world.

    Attributes:
        linear: Velocities of their origins [m/s], shape (m, 3).
        angular: Angular velocities [rad/s], shape (m, 3).
    """

    linear: Array
    angular: Array


class Motion(Record, ABC):
    """Where an obstacle is at each time from 0 on [s]."""

    def start(self, given: Placement) -> Placement:
        """Placement at time 0.

        Args:
            given: Placement that the obstacle was given.

        Raises:
            SceneError: If the motion begins elsewhere.
        """
        return given

    @property
    def kinks(self) -> Array:
        """Times after the start at which the velocity jumps [s], as far as known."""
        return np.zeros(0)

    @abstractmethod
    def poses(self, times: Array, start: Placement) -> Placement:
        """Placements at times [s], shape (m,), of an obstacle that starts somewhere."""

    @abstractmethod
    def twists(self, times: Array, start: Placement) -> Twist:
        """Velocities at times [s], shape (m,); after the jump where they jump."""

    @abstractmethod
    def speed_bounds(
        self, begin: Array, end: Array, start: Placement
    ) -> tuple[Array, Array]:
        """Largest speeds between two times.

        Args:
            begin: Beginnings of stretches of time [s], shape (m,).
            end: Their ends, shape (m,).
            start: Placement at time 0.

        Returns:
            Of the origin [m/s] and of the rotation [rad/s], shape (m,) each.
        """


def agreed_start(given: Placement, begins: Placement) -> Placement:
    """Check the placement that was given against the one that a motion begins with.

    Returns:
        The latter; the former may be left at no rotation about the origin.

    Raises:
        SceneError: If they differ.
    """
    if np.any(given.p) and float(np.linalg.norm(given.p - begins.p)) > SAME:
        wrong = "position", given.p, "at", begins.p
    elif not (
        np.array_equal(given.R, np.eye(3)) or np.allclose(given.R, begins.R, atol=SAME)
    ):
        wrong = "rotation", given.R, "with", begins.R
    else:
        return begins
    name, value, how, other = wrong
    raise SceneError(
        f"{name} is {value.tolist()}, and its motion begins {how} "
        f"{other.tolist()}: expected the same, or no {name}"
    )


def about_motion(message: str, _: str = "") -> SceneError:
    """An error about the motion of an obstacle, which is named by who knows it."""
    return SceneError(f"motion: {message}")


def checked_times(value: Array, name: str = "times") -> Array:
    """Check a caller's times, shape (m,) [s]."""
    return array(value, name, (None,), "times [s]")


def checked_stretches(begin: Array, end: Array) -> tuple[Array, Array]:
    """Check a caller's stretches of time, as many ends as beginnings [s]."""
    begin = checked_times(begin, "begin")
    return begin, array(end, "end", begin.shape, "times [s], one for each beginning")


def checked_placement(value: Placement, name: str = "start") -> Placement:
    """Check a caller's placement."""
    return instance(value, Placement, name)


def numbers(name: str, value: object) -> Array:
    """Take finite numbers of any shape."""
    try:
        found = real_array(value)
    except ValueError as error:
        raise about_motion(f"{name} is not made of numbers: {error}") from error
    if not np.all(np.isfinite(found)):
        where = np.argwhere(~np.isfinite(found))[0].tolist()
        raise about_motion(f"{name} holds what is no finite number, at index {where}")
    return found
