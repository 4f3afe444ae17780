"""What a user may ask for along a motion, beyond the limits of the robot.

A subclass in one file is a new constraint: it is known to scenario files and the
command line by its name, held by every transcription, replayed, and certified.
"""

from __future__ import annotations

import copy
from abc import abstractmethod
from typing import TypeVar

import numpy as np

from tominpmp.arrays import Array, IntArray, Record, real_number
from tominpmp.constraints.base import Constraint, Partials, States
from tominpmp.exceptions import ProblemError, brief
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot

# Share of its bound that a value may be beyond it between the instants of the rows.
USABLE = 2e-3

Own = TypeVar("Own", bound="PathConstraint")


class PathConstraint(Record, Constraint):
    """A quantity that is to stay below a limit at all times of a motion.

    Subclasses are frozen dataclasses, declared with ``eq=False``. They give the
    quantity at a state as a *smooth* number of the same sign of excess: see
    :func:`rounded_length`.
    """

    @property
    @abstractmethod
    def subject(self) -> str:
        """What it is about: "frame tip"."""

    @property
    @abstractmethod
    def largest(self) -> float:
        """Largest value of the quantity that is allowed."""

    @property
    @abstractmethod
    def unit(self) -> str:
        """Unit of the quantity."""

    @property
    def scale(self) -> float:
        """What an excess of the quantity is measured by."""
        return self.largest

    @abstractmethod
    def validate(self, robot: Robot) -> None:
        """Check the constraint against a robot.

        Raises:
            FrameNotFound: If a frame is not part of it.
            JointNotFound: If a joint is not part of it.
        """

    @abstractmethod
    def measure(self, q: Array, v: Array, a: Array) -> float:
        """The quantity at one state, shapes (n,); what is not asked for is empty."""

    @abstractmethod
    def value(self, q: Array, v: Array, a: Array) -> tuple[float, Array, Array, Array]:
        """Smooth value, <= 0 where the limit is kept, and its derivatives.

        Returns:
            The value in units of the scale, and its derivatives by q, v and a, shape
            (n,) each; empty for those that it does not depend on.
        """

    # -- what follows from these -------------------------------------------------------

    def on(self: Own, robot: Robot) -> Own:
        """The constraint for a robot, ready to be evaluated."""
        self.validate(robot)
        ready = copy.copy(self)
        object.__setattr__(ready, "_kinematics", RobotKinematics(robot))
        return ready

    @property
    def kinematics(self) -> RobotKinematics:
        """Placement of the robot's frames."""
        found = self.__dict__.get("_kinematics")
        assert isinstance(found, RobotKinematics), "not on a robot"  # noqa: S101
        return found

    @property
    def count(self) -> int:
        """One value."""
        return 1

    @property
    def usable(self) -> Array:
        """A little, between the instants of the rows."""
        return np.full(1, USABLE)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Smooth values at states, shape (m, 1)."""
        return np.array([[self.value(*state)[0]] for state in self._each(states)])

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Their derivatives."""
        every = list(self._each(states))
        values = [self.value(*every[k]) for k in at.tolist()]
        parts: list[Array | None] = []
        for order in (1, 2, 3):
            rows = np.array([value[order] for value in values])
            parts.append(rows if rows.size else None)
        return Partials(at, parts[0], parts[1], parts[2])

    def measures(self, states: States) -> Array:
        """The quantity itself at states, shape (m,)."""
        return np.array([self.measure(*state) for state in self._each(states)])

    def _each(self, states: States) -> list[tuple[Array, Array, Array]]:
        none = np.zeros(0)
        v = states.v if self.order >= 1 else [none] * len(states.q)
        a = states.a if self.order >= 2 else [none] * len(states.q)
        return list(zip(states.q, v, a, strict=True))


def rounded_length(vector: Array, by: Array, limit: float) -> tuple[float, Array]:
    """A vector's length beyond a limit, rounded off about zero where it has a kink.

    Args:
        vector: Shape (k,).
        by: Its derivative, shape (k, n).
        limit: Largest length.

    Returns:
        sqrt(2 |x|^2 + 2 L^2) - 2 L, which has the sign of |x| - L and its slope at the
        limit, and its derivative, shape (n,).
    """
    size = float(np.sqrt(2.0 * (vector @ vector + limit**2)))
    return size - 2.0 * limit, np.asarray(2.0 * vector @ by / max(size, 1e-300))


def positive(value: object, name: str, unit: str, most: float = np.inf) -> float:
    """Check a caller's positive number.

    Args:
        value: What the caller gave.
        name: What it is, for the message.
        unit: Its unit.
        most: Largest value.

    Raises:
        ProblemError: If it is none.
    """
    try:
        number = real_number(value)
    except ValueError:
        number = np.nan
    if not 0.0 < number <= most or np.isinf(number):
        top = "" if np.isinf(most) else f", {most:.4g} at most"
        raise ProblemError(
            f"{name} is {brief(value)}, expected a positive number [{unit}]{top}", name
        )
    return number


def frame_name(value: object, name: str = "frame") -> str:
    """Check a caller's name of a frame.

    Raises:
        ProblemError: If it is no text.
    """
    if not isinstance(value, str) or not value:
        raise ProblemError(
            f"{name} is {brief(value)}, expected the name of a frame", name
        )
    return value
