"""Path constraints of users, in addition to the limits of the robot.

A subclass in one file is a new constraint: scenario files and the command line accept
it by its name, every transcription keeps it, and the replay and the certificate check
it.

A constraint that holds during a part of a motion has rows at fixed times, not at shares
of the duration: the times do not change with the duration of the motion.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, TypeAlias, TypeVar

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray, Record, pair_or_nan, record
from tominpmp.checks import JOINTS, FrameName, array, instance, number, wrong
from tominpmp.constraints.base import NO_TIMES, USABLE, Constraint, Partials, States
from tominpmp.exceptions import ProblemError, brief, naming
from tominpmp.kinematics import FrameMotions, RobotKinematics
from tominpmp.robot.robot import Robot

# Least and largest number of initial rows of a time window, and the usual time between
# them [s]: a motion that violates a constraint between two distant rows may be pushed
# to the other side by a row that joins later.
FIRST_TIMES, MOST_TIMES, FIRST_STEP = 21, 401, 0.1
# Times closer than this count as one [s].
SAME = 1e-6

Own = TypeVar("Own", bound="PathConstraint")
# Function from two points and a number to that many points of a curve, between the
# curve points nearest to the two points.
CurveSampler = Callable[[Array, Array, int], Array]
# Values and their derivatives by q, v and a; EMPTY for derivatives that are zero.
Linear = tuple[Array, ...]
EMPTY = np.zeros(0)


@dataclass(frozen=True, eq=False)
class Window:
    """The time window in which a constraint holds.

    A motion that ends before the end of the window rests at its goal until then, and
    the constraint must hold there, too.

    Attributes:
        begin: Start of the window [s].
        end: End of the window [s]; infinity for no end.
        times: Times of the rows [s], ascending, shape (k,).
    """

    begin: float
    end: float
    times: Array

    @classmethod
    def between(cls, begin: float, end: float) -> Window:
        """The window between two checked times, with its initial rows."""
        last = end if np.isfinite(end) else begin + FIRST_STEP * (FIRST_TIMES - 1)
        usual = 1 + np.ceil((last - begin) / FIRST_STEP)
        count = int(np.clip(usual, FIRST_TIMES, MOST_TIMES))
        return cls(begin, end, np.linspace(begin, last, count))

    def contains(self, t: Array) -> BoolArray:
        """Whether times of a motion are within the window, shape (m,)."""
        return np.asarray((t >= self.begin - SAME) & (t <= self.end + SAME))

    def with_times(self, more: Array) -> Window:
        """The window with rows at more times [s]."""
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


During: TypeAlias = Annotated[tuple[float, float], _checked_during]


@record
class PathConstraint(Record, Constraint):
    """A quantity that must not exceed a limit at any time of a motion.

    With ``during``, the constraint holds during a part of the motion only, from one
    time until another [s]. If the motion ends before the second time, the constraint
    must hold at the goal.

    Most quantities are the length of a :meth:`vector` that is a smooth function of the
    state; their rows use a length that is smoothed at zero, where the length has a
    kink, see :func:`rounded_excess`. Other quantities define their rows by
    :meth:`terms`, or by :meth:`value_rows` and :meth:`term_rows`, and the number of
    rows by ``count``. A subclass defines its functions either at one state
    (:meth:`measure`, :meth:`vector`) or at many states at once (:meth:`measure_rows`,
    :meth:`vector_rows`), which is faster.

    Subclasses are frozen dataclasses, declared with ``eq=False``.

    Attributes:
        during: Part of the motion during which the constraint holds: from one time
            until another [s]; None for the whole motion.
    """

    _owner = "constraint."
    during: During | None = field(default=None, kw_only=True)

    @property
    @abstractmethod
    def subject(self) -> str:
        """Subject of the constraint, such as "frame tip"."""

    @property
    @abstractmethod
    def unit(self) -> str:
        """Unit of the quantity."""

    @property
    @abstractmethod
    def largest(self) -> float:
        """Largest admissible value of the quantity."""

    @property
    def scale(self) -> float:
        """Scale of the excess of the quantity over its limit."""
        return self.largest

    @property
    def count(self) -> int:
        """Number of values at a state: one, unless a subclass has several."""
        return 1

    @property
    def top_speed(self) -> tuple[str, float] | None:
        """A frame, and the largest speed of its origin [m/s]; None without a limit."""
        return None

    @property
    def guide(self) -> tuple[str, CurveSampler] | None:
        """A frame, and a curve that its origin must follow; None without a curve.

        The function gives a number of points of the curve, shape (m, 3) [m], between
        the curve points nearest to a first and a last point, shape (3,) each.
        """
        return None

    @abstractmethod
    def validate(self, robot: Robot) -> None:
        """Check the constraint against a robot.

        Raises:
            FrameNotFound: If the robot does not have a frame of the constraint.
            JointNotFound: If the robot does not have a joint of the constraint.
        """

    # -- the quantity at one state, or at many at once ---------------------------------

    def measure(self, q: Array, v: Array, a: Array) -> float:
        """The quantity at one state, shapes (n,); v and a are empty if not needed.

        Raises:
            NotImplementedError: If the subclass defines no quantity.
        """
        if type(self).measure_rows is PathConstraint.measure_rows:
            raise NotImplementedError(f"{type(self).__name__} has no measure")
        return float(self.measure_rows(*_one_row(q, v, a))[0])

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Results of :meth:`measure` at m states, shapes (m, n) to (m,)."""
        found = [self.measure(*state) for state in _states(q, v, a)]
        return np.array(found, dtype=np.float64)

    def vector(self, q: Array, v: Array, a: Array) -> Linear:
        """A vector whose length is the quantity, and its derivatives.

        Returns:
            Vector, shape (k,), and its derivatives by q, v and a, shape (k, n) each;
            empty for derivatives that are zero.

        Raises:
            NotImplementedError: If the quantity is not the length of a vector.
        """
        if type(self).vector_rows is PathConstraint.vector_rows:
            raise NotImplementedError(f"{type(self).__name__} is no length")
        return _first(self.vector_rows(*_one_row(q, v, a)))

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Results of :meth:`vector` at m states: (m, k), and (m, k, n) or empty."""
        return _stacked(self.vector(*state) for state in _states(q, v, a))

    @property
    def _is_length(self) -> bool:
        """Whether rows are lengths of vectors unless a subclass defines them."""
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
            return rounded_excess(sizes, limit)[:, None]
        found = [self.values(*state) for state in _states(q, v, a)]
        return np.array(found).reshape(-1, self.count)

    def term_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Results of :meth:`terms` at m states: (m, count), (m, count, n) or empty."""
        if not self._is_length:
            return _stacked(self.terms(*state) for state in _states(q, v, a))
        vector, *by = self.vector_rows(q, v, a)
        length, limit = np.linalg.norm(vector, axis=1), self.largest
        values = rounded_excess(length / self.scale, limit / self.scale)[:, None]
        size = np.sqrt(0.5 * (length**2 + limit**2)) * self.scale
        along = (vector / np.maximum(size, 1e-300)[:, None])[:, None, :]
        return values, *(along @ part if part.size else part for part in by)

    def bend_rows(self, q: Array, v: Array, a: Array) -> tuple[Array, ...] | None:
        """Derivatives of vectors that give the second-order change of the values.

        Values are convex functions of the vectors of :meth:`vector_rows`. In a step,
        the linearised values lack half of the squared lengths of the vectors here.

        Returns:
            Derivatives by q, v and a, shape (m, count, k, n) each or empty; None for
            values that are not lengths.
        """
        if not self.bends:
            return None
        vector, *by = self.vector_rows(q, v, a)
        root = curvature_root(vector, self.largest) / np.sqrt(self.scale)
        return tuple((root @ part)[:, None] if part.size else part for part in by)

    def values(self, q: Array, v: Array, a: Array) -> Array:
        """Values of :meth:`terms` without derivatives, shape (count,)."""
        return self.terms(q, v, a)[0]

    def terms(self, q: Array, v: Array, a: Array) -> Linear:
        """Smooth values at a state, and their derivatives.

        Returns:
            Values in units of the scale, <= 0 if the limit is kept, shape (count,), and
            their derivatives by q, v and a, shape (count, n) each; empty for zero
            derivatives.
        """
        return _first(self.term_rows(*_one_row(q, v, a)))

    # -- rows of the constraint --------------------------------------------------------

    def on(self: Own, robot: Robot) -> Own:
        """The constraint for a robot, ready to be evaluated."""
        self.validate(robot)
        # Cached motions of the frame, and of a load, may belong to another robot.
        return self._altered(
            "motions",
            "_loaded",
            _window=self.during and Window.between(*self.during),
            _kinematics=RobotKinematics(robot),
        )

    @property
    def kinematics(self) -> RobotKinematics:
        """Placement of the robot's frames.

        Raises:
            ProblemError: If the constraint is not the result of :meth:`on`.
        """
        found = self.__dict__.get("_kinematics")
        if not isinstance(found, RobotKinematics):
            raise ProblemError(
                f"{self.name}: the constraint has no robot, expected the result of "
                "constraint.on(robot), which a problem calls",
                "constraints",
            )
        return found

    @property
    def window(self) -> Window | None:
        """Time window of the constraint; None if it holds for the whole motion."""
        return self.__dict__.get("_window")

    def with_times(self: Own, times: Array) -> Own:
        """The constraint with rows at more times [s]."""
        if self.window is None:
            return self
        return self._altered(_window=self.window.with_times(times))

    @property
    def kinks(self) -> Array:
        """Times of the rows of the time window, if the constraint has one [s]."""
        return NO_TIMES if self.window is None else self.window.times

    @property
    def usable(self) -> Array:
        """Tolerated excess of values between the instants of rows, shape (count,)."""
        return np.full(self.count, USABLE)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Smooth values at states, shape (m, count)."""
        return self.value_rows(*self._parts(states))

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives of the smooth values."""
        used, place, parts = self._used(states, at, which)
        if not used.size:
            return Partials(at)
        return self._partials(self.term_rows(*parts)[1:], (place, which), at)

    def bend(self, states: States, at: IntArray, which: IntArray) -> Partials | None:
        """Second-order terms of values that are convex functions of vectors."""
        used, place, parts = self._used(states, at, which)
        found = self.bend_rows(*parts)
        if found is None or not used.size:
            return None
        size = next(part.shape[2] for part in found if part.size)
        row = np.repeat(np.arange(at.size), size)
        return self._partials(found, (place, which), at[row])._replace(row=row)

    def _partials(
        self, rows: Sequence[Array], chosen: tuple[IntArray, IntArray], at: IntArray
    ) -> Partials:
        """Partial derivatives, from those by q, v and a at distinct instants.

        ``chosen`` holds, for each value, the place of its instant among them and the
        index of the value.
        """
        by_q, by_v, by_a = (
            part[chosen].reshape(at.size, -1) if part.size else None for part in rows
        )
        by_t = None if self.window is None else np.zeros(at.size)
        return Partials(at, by_q, by_v, by_a, by_t=by_t)

    def _used(
        self, states: States, at: IntArray, which: IntArray
    ) -> tuple[IntArray, IntArray, list[Array]]:
        """Distinct instants, the index of each value among them, and their states."""
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
            Shape (m,); clipped to the limit at times outside the time window.
        """
        t = array(t, "t", (None,), "times [s]")
        q = array(q, "q", (t.size, self.kinematics.robot.n), JOINTS)
        sizes = self.measures(States(t, q, v, a))
        if self.window is None or not t.size:
            return sizes
        end = float(np.max(t))
        holds = self.window.contains(t) | ((t >= end) & (end <= self.window.end))
        return np.where(holds, sizes, np.minimum(sizes, self.largest))

    def _parts(self, states: States) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations; empty above the order."""
        empty = np.zeros((len(instance(states, States, "states").q), 0))
        v = states.v if self.order >= 1 else empty
        a = states.a if self.order >= 2 else empty
        return states.q, v, a

    def excess_at_rest(self, q: Array) -> tuple[Array, Array]:
        """Excess over the limit at configurations at rest, and its Jacobian.

        Args:
            q: Positions, shape (..., n) [rad or m].

        Returns:
            Excess in units of the scale, zero if the limit is kept, shape (..., count),
            and its derivative, shape (..., count, n).
        """
        q = array(q, "q", (..., self.kinematics.robot.n), JOINTS)
        rows = q.reshape(-1, q.shape[-1])
        rest = np.zeros_like(rows)
        at = States(np.zeros(len(rows)), rows, rest, rest)
        values, by_q, *_ = self.term_rows(*self._parts(at))
        lower, upper = self.bounds(len(rows))
        excess = values - np.clip(values, lower, upper)
        outside = (excess != 0.0) | (lower == upper)
        slope = np.zeros((*values.shape, q.shape[-1]))
        slope[outside] = by_q[outside] if by_q.size else 0.0
        shape = (*q.shape[:-1], self.count)
        return excess.reshape(shape), slope.reshape(*shape, q.shape[-1])

    def lack(self, q: Array, v: Array, slack: float) -> str:
        """Violation at a state, as a clause; empty if it is within a slack."""
        if self.order > 1:
            return ""  # accelerations are not known
        size = self.measure(q, v, np.zeros(0))
        if size <= self.largest + number(slack, "slack") * max(self.scale, 1.0):
            return ""
        return (
            f"the {self.name} is {size:.4g} {self.unit}, {size - self.largest:.2g} "
            f"{self.unit} more than its limit {self.largest:.4g} {self.unit}"
        )


@record
class FrameRows(PathConstraint):
    """A constraint on a frame of the robot.

    Attributes:
        frame: Name of the frame.
        quantity: Name of the quantity, in reports and messages.
        bound: Name of the field that holds the limit; empty without a field.
        least_scale: Scale of an excess where the limit is smaller: rows should be of
            order one.
    """

    frame: FrameName
    quantity: ClassVar[str]
    bound: ClassVar[str] = ""
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
        """Quantity and frame, such as "speed of frame tip"."""
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
        several: Whether the motion has segments, even a single one.

    Raises:
        ProblemError: If an item is not a constraint, or has a time window although the
            motion has segments.
        FrameNotFound: If the robot does not have a frame of a constraint.
        JointNotFound: If the robot does not have a joint of a constraint.
    """
    items: Any = (given,) if isinstance(given, PathConstraint) else given
    expected = "a tuple of constraints such as KeepUpright and ToolSpeed"
    instance(items, (list, tuple), "constraints", expected)
    for k, item in enumerate(items):
        name = f"constraints[{k}]"
        instance(item, PathConstraint, name, "a constraint")
        with naming(name, name):
            item.validate(robot)
        if item.during is not None and several:
            raise ProblemError(
                f"{item.name}: during is {brief(item.during)}, and the problem has "
                "segments: expected None, and the constraint given to the segments on "
                "which it holds",
                f"constraints[{k}].during",
            )
    return tuple(items)


def _one_row(q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
    """One state as rows of states; v and a may be empty."""
    q, v, a = (array(x, k, (None,), JOINTS) for k, x in (("q", q), ("v", v), ("a", a)))
    return q[None], v[None], a[None]


def _first(rows: Linear) -> Linear:
    """Values and derivatives at the first of several states."""
    values, *by = rows
    return values[0], *(part[0] if part.size else EMPTY for part in by)


def _stacked(every: Iterable[Linear]) -> Linear:
    """Values and derivatives at single states, stacked to rows."""
    return tuple(np.array(part) for part in zip(*every, strict=True))


def _states(q: Array, v: Array, a: Array) -> Iterator[tuple[Array, Array, Array]]:
    """Iterate over states that are given as rows."""
    q = array(q, "q", (None, None), JOINTS)
    shape = len(q), None
    return zip(
        q, array(v, "v", shape, JOINTS), array(a, "a", shape, JOINTS), strict=True
    )


def rounded_excess(length: Array, limit: float) -> Array:
    """Excess of lengths over a limit, smoothed at length zero, where it has a kink.

    sqrt(2 x^2 + 2 L^2) - 2 L has the sign of x - L, and its slope at x = L.
    """
    return np.asarray(np.sqrt(2.0 * (length**2 + limit**2)) - 2.0 * limit)


def curvature_root(vector: Array, limit: float) -> Array:
    """Square roots of the second derivatives of rounded lengths by their vectors.

    The second derivative of s = sqrt(2 x^2 + 2 L^2) is (2 I - 4 x x^T / s^2) / s.

    Args:
        vector: The vectors x, shape (m, k).
        limit: The limit L.

    Returns:
        Symmetric matrices, shape (m, k, k).
    """
    square = np.sum(vector**2, axis=1)
    size = np.maximum(np.sqrt(2.0 * (square + limit**2)), 1e-300)
    # The second derivative is smaller along the vector than across it.
    along = 1.0 - np.sqrt(2.0) * limit / size
    outer = vector[:, :, None] * vector[:, None, :]
    outer *= (along / np.maximum(square, 1e-300))[:, None, None]
    root = np.eye(vector.shape[1]) - outer
    return np.asarray(np.sqrt(2.0 / size)[:, None, None] * root)
