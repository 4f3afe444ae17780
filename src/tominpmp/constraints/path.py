"""What a user may ask for along a motion, beyond the limits of the robot.

A subclass in one file is a new constraint: it is known to scenario files and the
command line by its name, held by every transcription, replayed, and certified.
"""

from __future__ import annotations

import copy
from abc import abstractmethod
from typing import ClassVar, TypeVar

import numpy as np

from tominpmp.arrays import Array, IntArray, Record, number_or_nan
from tominpmp.constraints.base import Constraint, Partials, States
from tominpmp.exceptions import ProblemError, brief
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot

# Share of its bound that a value may be beyond it between the instants of the rows.
USABLE = 2e-3

Own = TypeVar("Own", bound="PathConstraint")


class PathConstraint(Record, Constraint):
    """A quantity that is to stay below a limit at all times of a motion.

    Subclasses are frozen dataclasses, declared with ``eq=False``. Most quantities are
    the length of a :meth:`vector` that is a smooth function of the state; rows are made
    of it rounded off about zero, where a length has a kink, see :func:`rounded`. Those
    that are no length give their rows by :meth:`terms` and their number by ``count``.
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

    @property
    def top_speed(self) -> tuple[str, float] | None:
        """A frame, and how fast its origin may move [m/s]; None if that is open."""
        return None

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

    def vector(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array, Array]:
        """A vector whose length is the quantity, and its derivatives.

        Returns:
            Vector, shape (k,), and derivatives by q, v and a, shape (k, n) each; empty
            for those that it does not depend on.
        """
        raise NotImplementedError(f"{type(self).__name__} is no length")

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
        return np.full(self.count, USABLE)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Smooth values at states, shape (m, count)."""
        if self._is_length:
            limit = self.largest / self.scale
            return rounded(self.measures(states) / self.scale, limit)[:, None]
        values = [self.values(*state) for state in self._each(states)]
        return np.array(values).reshape(-1, self.count)

    @property
    def _is_length(self) -> bool:
        return type(self).terms is PathConstraint.terms

    def values(self, q: Array, v: Array, a: Array) -> Array:
        """Those of :meth:`terms` alone, where that is quicker, shape (count,)."""
        return self.terms(q, v, a)[0]

    def terms(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array, Array]:
        """Smooth values at a state, and their derivatives.

        Returns:
            Values in units of the scale, <= 0 where the limit is kept, shape (count,),
            and their derivatives by q, v and a, shape (count, n) each; empty where
            there are none.
        """
        value, (by_q, by_v, by_a) = self.value(q, v, a)
        return np.array([value]), by_q[None], by_v[None], by_a[None]

    def value(self, q: Array, v: Array, a: Array) -> tuple[float, list[Array]]:
        """Smooth value at a state, and its derivatives.

        Returns:
            The value in units of the scale, <= 0 where the limit is kept, and its
            derivatives by q, v and a, shape (n,) each; empty where there are none.
        """
        vector, *parts = self.vector(q, v, a)
        length, limit = float(np.linalg.norm(vector)), self.largest
        value = float(rounded(np.array(length / self.scale), limit / self.scale))
        size = np.sqrt(0.5 * (length**2 + limit**2)) * self.scale
        along = vector / max(size, 1e-300)
        return value, [along @ part if part.size else np.zeros(0) for part in parts]

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Their derivatives."""
        every = list(self._each(states))
        used, place = np.unique(at, return_inverse=True)
        found = [self.terms(*every[k])[1:] for k in used.tolist()]
        parts: list[Array | None] = []
        for order in range(3):
            if not found or not found[0][order].size:
                parts.append(None)
                continue
            table = np.array([one[order] for one in found])
            parts.append(table[place, which])
        return Partials(at, parts[0], parts[1], parts[2])

    def measures(self, states: States) -> Array:
        """The quantity itself at states, shape (m,)."""
        return np.array([self.measure(*state) for state in self._each(states)])

    def lack(self, q: Array, v: Array, slack: float) -> str:
        """What is wrong with a state; nothing if the limit is kept, within a slack."""
        if self.order > 1:
            return ""  # accelerations are not known
        size = self.measure(q, v, np.zeros(0))
        if size <= self.largest + slack * max(self.scale, 1.0):
            return ""
        return (
            f"the {self.name} is {size:.4g} {self.unit}, more than its limit "
            f"{self.largest:.4g} {self.unit}"
        )

    def _each(self, states: States) -> list[tuple[Array, Array, Array]]:
        none = np.zeros(0)
        v = states.v if self.order >= 1 else [none] * len(states.q)
        a = states.a if self.order >= 2 else [none] * len(states.q)
        return list(zip(states.q, v, a, strict=True))


class FrameConstraint(PathConstraint):
    """A constraint on a frame of the robot, which its field ``frame`` names."""

    frame: str
    quantity: ClassVar[str]

    @property
    def name(self) -> str:
        """The quantity, and of what."""
        return f"{self.quantity} of {self.subject}"

    @property
    def subject(self) -> str:
        """The frame."""
        return f"frame {self.frame}"

    def validate(self, robot: Robot) -> None:
        """Check that the robot has the frame."""
        robot.frame_id(self.frame)


class FrameLimit(FrameConstraint):
    """A quantity of a frame below its field ``limit``."""

    limit: float

    def __post_init__(self) -> None:
        """Check the values."""
        frame_name(self.frame)
        object.__setattr__(self, "limit", positive(self.limit, "limit", self.unit))

    @property
    def largest(self) -> float:
        """The limit."""
        return self.limit


def rounded(length: Array, limit: float) -> Array:
    """Lengths beyond a limit, rounded off about zero where they have a kink.

    sqrt(2 x^2 + 2 L^2) - 2 L has the sign of x - L, and its slope there.
    """
    return np.asarray(np.sqrt(2.0 * (length**2 + limit**2)) - 2.0 * limit)


def positive(value: object, name: str, unit: str, most: float = np.inf) -> float:
    """Check a caller's positive number.

    Raises:
        ProblemError: If it is none.
    """
    number = number_or_nan(value)
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


def checked(given: object, robot: Robot) -> tuple[PathConstraint, ...]:
    """Check a caller's constraints against a robot.

    Raises:
        ProblemError: If they are none.
        FrameNotFound: If a frame is not part of the robot.
    """
    items = (given,) if isinstance(given, PathConstraint) else given
    expected = "expected a tuple of constraints as KeepUpright and ToolSpeed"
    if not isinstance(items, list | tuple):
        raise ProblemError(f"constraints is {brief(given)}, {expected}", "constraints")
    for item in items:
        if not isinstance(item, PathConstraint):
            raise ProblemError(
                f"constraints: {brief(item)} is a {type(item).__name__}, {expected}",
                "constraints",
            )
        item.validate(robot)
    return tuple(items)
