"""Path constraints of a user, beyond the limits of the robot.

A subclass in one file is a new constraint: scenario files and the command line accept
it by its name, every transcription keeps it, and it is replayed and certified.

Rows of a constraint that holds during a part of a motion are at times, not at shares of
the motion: the times stay when the duration of the motion changes.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, TypeAlias, TypeVar

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray, Record, pair_or_nan, record
from tominpmp.checks import JOINTS, FrameName, array, instance, number, optional, wrong
from tominpmp.constraints.base import NO_TIMES, Constraint, Partials, States
from tominpmp.exceptions import ProblemError, brief
from tominpmp.kinematics import FrameMotions, RobotKinematics
from tominpmp.robot.robot import Robot

# Tolerated excess of a value over its bound between rows, as a share of the bound.
USABLE = 2e-3
# Least and largest number of initial rows, and the time between them [s]: a motion that
# passes between two rows may be pushed to the other side by a row that joins later.
FIRST_TIMES, MOST_TIMES, FIRST_STEP = 21, 401, 0.1
# Times closer than this count as one [s].
SAME = 1e-6

Own = TypeVar("Own", bound="PathConstraint")
# Points of a curve, from its point nearest to a first point to that nearest to a last.
Way = Callable[[Array, Array, int], Array]
# Values and their derivatives by q, v and a; empty where they do not depend on it.
Linear = tuple[Array, Array, Array, Array]
NONE = np.zeros(0)


@dataclass(frozen=True, eq=False)
class Window:
    """The time window in which a constraint holds.

    A motion that ends before the end of the window rests at its goal until then, where
    the constraint is to hold, too.

    Attributes:
        begin: Begin of the window [s].
        end: End of the window [s]; infinity for no end.
        times: Times of its rows [s], ascending, shape (k,).
    """

    begin: float
    end: float
    times: Array

    @classmethod
    def of(cls, during: tuple[float, float] | None) -> Window | None:
        """The window of checked times; None for all the time."""
        if during is None:
            return None
        begin, end = during
        last = end if np.isfinite(end) else begin + FIRST_STEP * (FIRST_TIMES - 1)
        asked = 1 + np.ceil((last - begin) / FIRST_STEP)
        count = int(np.clip(asked, FIRST_TIMES, MOST_TIMES))
        return cls(begin, end, np.linspace(begin, last, count))

    def asked(self, t: Array) -> BoolArray:
        """Whether it holds at times of a motion, shape (m,)."""
        return np.asarray((t >= self.begin - SAME) & (t <= self.end + SAME))

    def with_times(self, more: Array) -> Window:
        """The window with more rows."""
        times = np.unique(np.concatenate([self.times, more]))
        apart = np.concatenate([[True], np.diff(times) > SAME])
        return replace(self, times=times[apart])


def _checked_during(given: object, name: str) -> tuple[float, float]:
    """Check the begin and end of a time window."""
    begin, end = pair_or_nan(given)
    if not (0.0 <= begin < np.inf and begin < end):
        expected = "two times (begin, end) from the start of the motion, in order [s]"
        raise wrong(given, name, f"{expected}; the end may be infinite")
    return begin, end


TimesOrNone: TypeAlias = Annotated[
    tuple[float, float] | None, optional(_checked_during)
]


@record
class PathConstraint(Record, Constraint):
    """A quantity that is to stay below a limit at all times of a motion.

    Or ``during`` a part of the motion: from one time until another [s]. If the motion
    ends before the second time, the constraint holds at the goal.

    Most quantities are the length of a :meth:`vector` that is a smooth function of the
    state; rows are made of the length rounded off about zero, where it has a kink, see
    :func:`rounded`. Other quantities give their rows by :meth:`terms`, or by
    :meth:`value_rows` and :meth:`term_rows`, and their number by ``count``. A subclass
    defines its functions either at one state (:meth:`measure`, :meth:`vector`) or at
    many at once (:meth:`measure_rows`, :meth:`vector_rows`), which is quicker.

    Subclasses are frozen dataclasses, declared with ``eq=False``.

    Attributes:
        during: Part of the motion on which it holds: from one time until another [s];
            None for the whole motion.
    """

    during: TimesOrNone = field(default=None, kw_only=True)

    @property
    @abstractmethod
    def subject(self) -> str:
        """Subject of the constraint: "frame tip"."""

    @property
    @abstractmethod
    def unit(self) -> str:
        """Unit of the quantity."""

    @property
    @abstractmethod
    def largest(self) -> float:
        """Largest value of the quantity that is allowed."""

    @property
    def scale(self) -> float:
        """Scale of an excess of the quantity."""
        return self.largest

    @property
    def count(self) -> int:
        """Number of values at a state: one."""
        return 1

    @property
    def top_speed(self) -> tuple[str, float] | None:
        """A frame, and the largest speed of its origin [m/s]; None without a limit."""
        return None

    @property
    def guide(self) -> tuple[str, Way] | None:
        """A frame, and the path of its origin along a curve; None without a curve.

        The function gives a number of points of the curve, shape (m, 3) [m], from its
        point nearest to a first point to that nearest to a last point, shape (3,) each.
        """
        return None

    @abstractmethod
    def validate(self, robot: Robot) -> None:
        """Check the constraint against a robot.

        Raises:
            FrameNotFound: If a frame is not part of it.
            JointNotFound: If a joint is not part of it.
        """

    # -- the quantity at one state, or at many at once ---------------------------------

    def measure(self, q: Array, v: Array, a: Array) -> float:
        """The quantity at one state, shapes (n,); derivatives not needed are empty."""
        if type(self).measure_rows is PathConstraint.measure_rows:
            raise NotImplementedError(f"{type(self).__name__} has no measure")
        return float(self.measure_rows(*_one_row(q, v, a))[0])

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Values of :meth:`measure` at m states, shapes (m, n) to (m,)."""
        found = [self.measure(*state) for state in _states(q, v, a)]
        return np.array(found, dtype=np.float64)

    def vector(self, q: Array, v: Array, a: Array) -> Linear:
        """A vector whose length is the quantity, and its derivatives.

        Returns:
            Vector, shape (k,), and derivatives by q, v and a, shape (k, n) each; empty
            where it does not depend on q, v or a.
        """
        if type(self).vector_rows is PathConstraint.vector_rows:
            raise NotImplementedError(f"{type(self).__name__} is no length")
        return _first(self.vector_rows(*_one_row(q, v, a)))

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Results of :meth:`vector` at m states: (m, k), and (m, k, n) or empty."""
        return _stacked(self.vector(*state) for state in _states(q, v, a))

    @property
    def _is_length(self) -> bool:
        return type(self).terms is PathConstraint.terms

    @property
    def bends(self) -> bool:
        """Whether values are lengths, which are convex functions of their vectors."""
        return self._is_length and type(self).term_rows is PathConstraint.term_rows

    def value_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Results of :meth:`values` at m states, shape (m, count)."""
        if self._is_length:
            limit = self.largest / self.scale
            sizes = self.measure_rows(q, v, a) / self.scale
            return rounded(sizes, limit)[:, None]
        found = [self.values(*state) for state in _states(q, v, a)]
        return np.array(found).reshape(-1, self.count)

    def term_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Results of :meth:`terms` at m states: (m, count), (m, count, n) or empty."""
        if not self._is_length:
            return _stacked(self.terms(*state) for state in _states(q, v, a))
        vector, *by = self.vector_rows(q, v, a)
        length, limit = np.linalg.norm(vector, axis=1), self.largest
        values = rounded(length / self.scale, limit / self.scale)[:, None]
        size = np.sqrt(0.5 * (length**2 + limit**2)) * self.scale
        along = (vector / np.maximum(size, 1e-300)[:, None])[:, None, :]
        by_q, by_v, by_a = (along @ part if part.size else part for part in by)
        return values, by_q, by_v, by_a

    def bend_rows(
        self, q: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array] | None:
        """Slopes of vectors; linearised values lack half of their squared lengths.

        Values are convex functions of the vectors of :meth:`vector_rows`: their change
        in a step of the vectors is known to second order.

        Returns:
            Derivatives by q, v and a, shape (m, count, k, n) each or empty; None for
            values that are no lengths.
        """
        if not self.bends:
            return None
        vector, *by = self.vector_rows(q, v, a)
        root = length_bend(vector, self.largest) / np.sqrt(self.scale)
        by_q, by_v, by_a = (
            (root @ part)[:, None] if part.size else part for part in by
        )
        return by_q, by_v, by_a

    def values(self, q: Array, v: Array, a: Array) -> Array:
        """Values of :meth:`terms` without derivatives, shape (count,)."""
        return self.terms(q, v, a)[0]

    def terms(self, q: Array, v: Array, a: Array) -> Linear:
        """Smooth values at a state, and their derivatives.

        Returns:
            Values in units of the scale, <= 0 where the limit is kept, shape (count,),
            and their derivatives by q, v and a, shape (count, n) each; empty where they
            do not depend on q, v or a.
        """
        return _first(self.term_rows(*_one_row(q, v, a)))

    # -- rows of the constraint --------------------------------------------------------

    def on(self: Own, robot: Robot) -> Own:
        """The constraint for a robot, ready to be evaluated."""
        self.validate(robot)
        # Motions of the frame belong to another robot.
        return self._altered(
            "motions",
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
        """Window in which it holds, with times of rows; None for the whole motion."""
        return self.__dict__.get("_window")

    def with_times(self: Own, times: Array) -> Own:
        """The constraint with rows at more times [s]."""
        if self.window is None:
            return self
        return self._altered(_window=self.window.with_times(times))

    @property
    def kinks(self) -> Array:
        """Times of its rows, where it holds during a part of the motion."""
        return NO_TIMES if self.window is None else self.window.times

    @property
    def usable(self) -> Array:
        """Tolerated excess between the instants of the rows, shape (count,)."""
        return np.full(self.count, USABLE)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Smooth values at states, shape (m, count)."""
        return self.value_rows(*self._parts(states))

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives of the smooth values."""
        used, place, parts = self._used(states, at, which)
        if not used.size:
            return Partials(at)
        by_q, by_v, by_a = (
            part[place, which] if part.size else None
            for part in self.term_rows(*parts)[1:]
        )
        by_t = None if self.window is None else np.zeros(at.size)
        return Partials(at, by_q, by_v, by_a, by_t=by_t)

    def bend(self, states: States, at: IntArray, which: IntArray) -> Partials | None:
        """Second-order terms of values that are convex functions of vectors."""
        used, place, parts = self._used(states, at, which)
        found = self.bend_rows(*parts)
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

    def _used(
        self, states: States, at: IntArray, which: IntArray
    ) -> tuple[IntArray, IntArray, list[Array]]:
        """Distinct instants of values, the index of each value, and their states."""
        _indices(which, "which")
        used, place = np.unique(_indices(at, "at"), return_inverse=True)
        return used, place, [part[used] for part in self._parts(states)]

    def measures(self, states: States) -> Array:
        """The quantity itself at states, shape (m,)."""
        return self.measure_rows(*self._parts(states))

    def sizes(self, t: Array, q: Array, v: Array, a: Array) -> Array:
        """The quantity at states of a motion, given as arrays.

        Args:
            t: Times [s], shape (m,).
            q: Positions, shape (m, n) [rad or m].
            v: Velocities, shape (m, n).
            a: Accelerations, shape (m, n); of any shape where ``order`` is below 2.

        Returns:
            Shape (m,); no more than the limit where the constraint does not hold.
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
        """Positions, velocities and accelerations; empty above the order."""
        none = np.zeros((len(instance(states, States, "states").q), 0))
        v = states.v if self.order >= 1 else none
        a = states.a if self.order >= 2 else none
        return states.q, v, a

    def excess_at_rest(self, q: Array) -> tuple[Array, Array]:
        """Excess over the limit of a configuration at rest, and its Jacobian.

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
        """Violation at a state, in words; empty if the limit is kept within a slack."""
        if self.order > 1:
            return ""  # accelerations are not known
        size = self.measure(q, v, np.zeros(0))
        if size <= self.largest + number(slack, "slack") * max(self.scale, 1.0):
            return ""
        return (
            f"the {self.name} is {size:.4g} {self.unit}, more than its limit "
            f"{self.largest:.4g} {self.unit}"
        )


@record
class FrameRows(PathConstraint):
    """A constraint on a frame of the robot.

    Attributes:
        frame: Name of the frame.
    """

    frame: FrameName
    quantity: ClassVar[str]
    # Name of the field that holds the limit; empty without a field.
    bound: ClassVar[str] = ""
    # Excesses are scaled by the limit, or by this if the limit is smaller, so that rows
    # stay of order one.
    least_scale: ClassVar[float] = 0.0

    @property
    def largest(self) -> float:
        """The limit."""
        return float(getattr(self, self.bound))

    @property
    def scale(self) -> float:
        """The limit, or the least scale if the limit is smaller."""
        return max(self.largest, self.least_scale)

    @property
    def name(self) -> str:
        """The quantity and its frame, in words."""
        return f"{self.quantity} of {self.subject}"

    @property
    def subject(self) -> str:
        """The frame."""
        return f"frame {self.frame}"

    def validate(self, robot: Robot) -> None:
        """Check that the robot has the frame."""
        instance(robot, Robot, "robot").frame_id(self.frame)

    @cached_property
    def motions(self) -> FrameMotions:
        """Placements and motions of the frame."""
        return FrameMotions(self.kinematics.robot, self.frame)


def _indices(value: IntArray, name: str) -> IntArray:
    """Check indices of values, shape (k,)."""
    if not isinstance(value, np.ndarray) or value.dtype.kind != "i" or value.ndim != 1:
        raise wrong(value, name, "a row of indices")
    return value


def checked(given: object, robot: Robot, several: bool) -> tuple[PathConstraint, ...]:
    """Check a caller's constraints against a robot.

    Args:
        given: The constraints.
        robot: The robot.
        several: Whether the motion has several segments.

    Raises:
        ProblemError: If an item is no constraint, or is to hold during a part of a
            motion of several segments.
        FrameNotFound: If a frame is not part of the robot.
    """
    items: Any = (given,) if isinstance(given, PathConstraint) else given
    expected = "a tuple of constraints as KeepUpright and ToolSpeed"
    instance(items, (list, tuple), "constraints", expected)
    for k, item in enumerate(items):
        instance(item, PathConstraint, f"constraints[{k}]", "a constraint").validate(
            robot
        )
        if item.during is not None and several:
            raise ProblemError(
                f"{item.name}: during is {brief(item.during)}, and the problem has "
                "several segments: expected None, and the constraint on those segments "
                "on which it holds",
                f"constraints[{k}].during",
            )
    return tuple(items)


def _one_row(q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
    """A state as rows of states; derivatives not needed may be empty."""
    q, v, a = (array(x, k, (None,), JOINTS) for k, x in (("q", q), ("v", v), ("a", a)))
    return q[None], v[None], a[None]


def _first(rows: Linear) -> Linear:
    """The first of many values with their derivatives."""
    values, *by = rows
    by_q, by_v, by_a = (part[0] if part.size else NONE for part in by)
    return values[0], by_q, by_v, by_a


def _stacked(every: Iterable[Linear]) -> Linear:
    """Values of single states, with their derivatives, as rows."""
    values, by_q, by_v, by_a = (np.array(part) for part in zip(*every, strict=True))
    return values, by_q, by_v, by_a


def _states(q: Array, v: Array, a: Array) -> Iterator[tuple[Array, Array, Array]]:
    """States in rows, one after the other."""
    q = array(q, "q", (None, None), JOINTS)
    shape = len(q), None
    return zip(
        q, array(v, "v", shape, JOINTS), array(a, "a", shape, JOINTS), strict=True
    )


def rounded(length: Array, limit: float) -> Array:
    """Excess of lengths over a limit, rounded off about zero where they have a kink.

    sqrt(2 x^2 + 2 L^2) - 2 L has the sign of x - L, and its slope there.
    """
    return np.asarray(np.sqrt(2.0 * (length**2 + limit**2)) - 2.0 * limit)


def length_bend(vector: Array, limit: float) -> Array:
    """Roots of the second derivative of rounded lengths by their vectors.

    The second derivative of s = sqrt(2 x^2 + 2 L^2) is (2 I - 4 x x^T / s^2) / s.

    Args:
        vector: The vectors x, shape (m, k).
        limit: The limit L.

    Returns:
        Symmetric matrices, shape (m, k, k).
    """
    square = np.sum(vector**2, axis=1)
    size = np.maximum(np.sqrt(2.0 * (square + limit**2)), 1e-300)
    # Along the vector the second derivative is smaller.
    along = 1.0 - np.sqrt(2.0) * limit / size
    outer = vector[:, :, None] * vector[:, None, :]
    outer *= (along / np.maximum(square, 1e-300))[:, None, None]
    root = np.eye(vector.shape[1]) - outer
    return np.asarray(np.sqrt(2.0 / size)[:, None, None] * root)
