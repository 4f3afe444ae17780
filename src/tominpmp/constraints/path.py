"""What a user may ask for along a motion, beyond the limits of the robot.

A subclass in one file is a new constraint: it is known to scenario files and the
command line by its name, held by every transcription, replayed, and certified.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import field
from typing import Any, TypeVar

import numpy as np

from tominpmp.arrays import Array, IntArray, Record, record
from tominpmp.checks import JOINTS, array, instance, number, wrong
from tominpmp.constraints.base import NO_TIMES, Partials, States
from tominpmp.constraints.quantity import Quantity
from tominpmp.constraints.window import TimesOrNone, Window, checked_during
from tominpmp.exceptions import ProblemError, brief
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot

# Share of its bound that a value may be beyond it between the instants of the rows.
USABLE = 2e-3

Own = TypeVar("Own", bound="PathConstraint")
# Points of a curve, from where it is nearest to one point to where it is to another.
Way = Callable[[Array, Array, int], Array]


@record
class PathConstraint(Record, Quantity):
    """A quantity that is to stay below a limit at all times of a motion.

    Or ``during`` a part of it: from one time of the motion until another [s]. Where it
    ends before that, the constraint holds at the goal.

    Subclasses are frozen dataclasses, declared with ``eq=False``.

    Attributes:
        during: Part of the motion on which it holds: from one time until another [s];
            None for all of it.
    """

    during: TimesOrNone = field(default=None, kw_only=True)

    @property
    @abstractmethod
    def subject(self) -> str:
        """What it is about: "frame tip"."""

    @property
    @abstractmethod
    def unit(self) -> str:
        """Unit of the quantity."""

    @property
    def top_speed(self) -> tuple[str, float] | None:
        """A frame, and how fast its origin may move [m/s]; None if that is open."""
        return None

    @property
    def guide(self) -> tuple[str, Way] | None:
        """A frame, and the way of its origin along a curve; None without any.

        The function gives so many points of the curve, shape (m, 3) [m], from where it
        is nearest to one point to where it is nearest to another, shape (3,) each.
        """
        return None

    @abstractmethod
    def validate(self, robot: Robot) -> None:
        """Check the constraint against a robot.

        Raises:
            FrameNotFound: If a frame is not part of it.
            JointNotFound: If a joint is not part of it.
        """

    # -- what follows from these -------------------------------------------------------

    def on(self: Own, robot: Robot) -> Own:
        """The constraint for a robot, ready to be evaluated."""
        self.validate(robot)
        # Motions of the frame belong to another robot.
        return self._altered(
            "_motions",
            _window=Window.of(self.during),
            _kinematics=RobotKinematics(robot),
        )

    @property
    def kinematics(self) -> RobotKinematics:
        """Placement of the robot's frames."""
        found = self.__dict__.get("_kinematics")
        if not isinstance(found, RobotKinematics):
            raise ProblemError(
                f"{self.name}: the constraint is on no robot, expected one that "
                "constraint.on(robot) has made, as a problem does",
                "constraints",
            )
        return found

    @property
    def window(self) -> Window | None:
        """When it holds, with the times of its rows; None for all the time."""
        return self.__dict__.get("_window")

    def with_times(self: Own, times: Array) -> Own:
        """The same with rows at more times [s]."""
        if self.window is None:
            return self
        return self._altered(_window=self.window.with_times(times))

    @property
    def kinks(self) -> Array:
        """Times of its rows, where it holds during a part of the motion."""
        return NO_TIMES if self.window is None else self.window.times

    @property
    def usable(self) -> Array:
        """A little, between the instants of the rows."""
        return np.full(self.count, USABLE)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Smooth values at states, shape (m, count)."""
        return self.value_rows(*self._parts(states))

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Their derivatives."""
        at, which = _indices(at, "at"), _indices(which, "which")
        used, place = np.unique(at, return_inverse=True)
        if not used.size:
            return Partials(at)
        found = self.term_rows(*(part[used] for part in self._parts(states)))
        by_q, by_v, by_a = (
            part[place, which] if part.size else None for part in found[1:]
        )
        by_t = None if self.window is None else np.zeros(at.size)
        return Partials(at, by_q, by_v, by_a, by_t=by_t)

    def bend(self, states: States, at: IntArray, which: IntArray) -> Partials | None:
        """Of values that are convex functions of vectors."""
        at, which = _indices(at, "at"), _indices(which, "which")
        used, place = np.unique(at, return_inverse=True)
        found = self.bend_rows(*(part[used] for part in self._parts(states)))
        if found is None or not used.size:
            return None
        size = next(part.shape[2] for part in found if part.size)
        by_q, by_v, by_a = (
            part[place, which].reshape(at.size * size, -1) if part.size else None
            for part in found
        )
        at, row = np.repeat(at, size), np.repeat(np.arange(at.size), size)
        by_t = None if self.window is None else np.zeros(at.size)
        return Partials(at, by_q, by_v, by_a, by_t=by_t, row=row)

    def measures(self, states: States) -> Array:
        """The quantity itself at states, shape (m,)."""
        return self.measure_rows(*self._parts(states))

    def sizes(self, t: Array, q: Array, v: Array, a: Array) -> Array:
        """The same at states of a motion, for who knows no :class:`States`.

        Args:
            t: Times [s], shape (m,).
            q: Positions, shape (m, n) [rad or m].
            v: Velocities, shape (m, n).
            a: Accelerations, shape (m, n); of any shape where ``order`` is below 2.

        Returns:
            Shape (m,); no more than the limit where it does not hold.
        """
        t = array(t, "t", (None,), "times [s]")
        q = array(q, "q", (t.size, self.kinematics.robot.n), JOINTS)
        sizes = self.measures(States(t, q, v, a))
        if self.window is None or not t.size:
            return sizes
        end = float(np.max(t))
        asked = self.window.asked(t) | ((t >= end) & (end <= self.window.end))
        return np.where(asked, sizes, np.minimum(sizes, self.largest))

    def _parts(self, states: States) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations; empty where not asked for."""
        none = np.zeros((len(instance(states, States, "states").q), 0))
        v = states.v if self.order >= 1 else none
        a = states.a if self.order >= 2 else none
        return states.q, v, a

    def excess_at_rest(self, q: Array) -> tuple[Array, Array]:
        """How far a configuration at rest is beyond the limit, and the Jacobian of it.

        Args:
            q: Positions, shape (n,) [rad or m].

        Returns:
            Excess in units of the scale, zero where the limit is kept, shape (count,),
            and its derivative, shape (count, n).
        """
        q = array(q, "q", (self.kinematics.robot.n,), JOINTS)
        v = np.zeros(q.size if self.order >= 1 else 0)
        a = np.zeros(q.size if self.order >= 2 else 0)
        values, by_q, *_ = self.terms(q, v, a)
        lower, upper = (bound[0] for bound in self.bounds(1))
        excess = values - np.clip(values, lower, upper)
        outside = (excess != 0.0) | (lower == upper)
        by_q = by_q if by_q.size else np.zeros((values.size, q.size))
        return excess, np.where(outside[:, None], by_q, 0.0)

    def lack(self, q: Array, v: Array, slack: float) -> str:
        """What is wrong with a state; nothing if the limit is kept, within a slack."""
        if self.order > 1:
            return ""  # accelerations are not known
        size = self.measure(q, v, np.zeros(0))
        if size <= self.largest + number(slack, "slack") * max(self.scale, 1.0):
            return ""
        return (
            f"the {self.name} is {size:.4g} {self.unit}, more than its limit "
            f"{self.largest:.4g} {self.unit}"
        )


def _indices(value: IntArray, name: str) -> IntArray:
    """Check indices of values, shape (k,)."""
    if not isinstance(value, np.ndarray) or value.dtype.kind != "i" or value.ndim != 1:
        raise wrong(value, name, "a row of indices")
    return value


def check_window(items: Sequence[PathConstraint], several: bool) -> None:
    """Check when constraints hold.

    Args:
        items: The constraints.
        several: Whether the motion has several segments.

    Raises:
        ProblemError: If that is no time, or told where a motion has several segments.
    """
    for k, item in enumerate(items):
        if checked_during(item.during) is not None and several:
            raise ProblemError(
                f"{item.name}: during is {brief(item.during)}, and the problem has "
                "several segments: expected None, and the constraint on those segments "
                "on which it holds",
                f"constraints[{k}].during",
            )


def checked(given: object, robot: Robot) -> tuple[PathConstraint, ...]:
    """Check a caller's constraints against a robot.

    Raises:
        ProblemError: If they are none.
        FrameNotFound: If a frame is not part of the robot.
    """
    items: Any = (given,) if isinstance(given, PathConstraint) else given
    expected = "a tuple of constraints as KeepUpright and ToolSpeed"
    instance(items, (list, tuple), "constraints", expected)
    for k, item in enumerate(items):
        instance(item, PathConstraint, f"constraints[{k}]", "a constraint")
        checked_during(item.during)
        item.validate(robot)
    return tuple(items)
