"""A motion over time: nodes, and the curve between the nodes.

Motions planned with the inverse dynamics are polynomials: of degree 2, with a constant
acceleration on each interval, or of degree 3 or 5; their torque follows from the
inverse dynamics at every instant. Motions planned with piecewise-constant torques are
known at their nodes, and are joined by cubic Hermite polynomials.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, BoolArray, IntArray, array_or_nan, in_brief
from tominpmp.checks import array, number, whole, wrong
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError, naming
from tominpmp.motion.curves import curve_through
from tominpmp.motion.samples import Samples, TimedRows, clock
from tominpmp.motion.turns import Turns
from tominpmp.notebook import motion_card

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

InverseDynamics = Callable[[Array, Array, Array], Array]
DYNAMICS = "a function (q, v, a) -> u"

# Distance from a node up to which a time counts as the node, due to rounding [s].
SAME_TIME = 1e-10
# Number of samples above which dt is rejected as a mistake; it protects the memory.
MAX_SAMPLES = 500_000
# Distance of a time from a motion up to which it counts as an end of the motion [s], or
# as a share of T: sums and files round.
ROUNDING = 1e-9


class State(NamedTuple):
    """The state of a trajectory at a time.

    Attributes:
        q: Positions [rad or m], shape (n,) or (m, n).
        v: Velocities [rad/s or m/s], same shape.
        a: Accelerations [rad/s^2 or m/s^2], same shape.
        u: Torques [N m or N], same shape.
    """

    q: Array
    v: Array
    a: Array
    u: Array

    def __repr__(self) -> str:
        """Show the numbers, or their count, on one line."""
        parts = (
            f"{k}={in_brief(np.asarray(x))}" for k, x in zip("qvau", self, strict=True)
        )
        return f"State({', '.join(parts)})"


@dataclass(frozen=True, eq=False)
class Trajectory(TimedRows):
    """A motion of all joints from time 0 to its duration.

    Two trajectories are equal if all attributes but functions are equal. A motion that
    takes no time, as it starts at its goal, has a single node.

    Attributes:
        joint_names: Names of the joints, in column order.
        t: Times of the nodes [s], increasing from 0, shape (N + 1,).
        q: Positions at the nodes [rad or m], shape (N + 1, n).
        v: Velocities at the nodes [rad/s or m/s], shape (N + 1, n).
        u: Torques at the nodes [N m or N], shape (N + 1, n). Where the torque jumps at
            a node, the row holds the value just after it; the last row holds the value
            at the end. NaN throughout for motions of kinematic robots.
        a: Acceleration of each interval, shape (N, n), for motions with constant
            acceleration on each interval; at the nodes, shape (N + 1, n), for motions
            of degree 5 between them; None for motions of degree 3.
        inverse_dynamics: Function (q, v, a) -> u on rows, for the torque between nodes;
            None for a torque that is constant on each interval.
        holding: Inverse dynamics of a motion that is given by its torques, for the
            torques that hold the arm before and after the motion.
        segment_ends: Times at which the segments of the motion end [s], after their
            dwells, in order up to T, shape (k,); each time is a node, and two times are
            equal where a segment takes no time. None for one segment.
        segment_dynamics: Functions like ``inverse_dynamics``, one for each segment, if
            the arm carries different payloads; empty otherwise.
    """

    joint_names: tuple[str, ...]
    t: Array
    q: Array
    v: Array
    u: Array
    a: Array | None = None
    inverse_dynamics: InverseDynamics | None = field(
        default=None, repr=False, compare=False
    )
    holding: InverseDynamics | None = field(default=None, repr=False, compare=False)
    segment_ends: Array | None = None
    segment_dynamics: tuple[InverseDynamics, ...] = field(
        default=(), repr=False, compare=False
    )

    def __post_init__(self) -> None:
        """Check the shapes and make the arrays read-only."""
        for name in ("inverse_dynamics", "holding"):
            function = getattr(self, name)
            if function is not None and not callable(function):
                raise wrong(function, name, DYNAMICS)
        with naming("trajectory"):
            self._take_rows("node", "qvu")
            t, expected = self.t, "finite times [s] that increase from 0"
            increasing = np.all(np.isfinite(t)) and np.all(np.diff(t) > 0.0)
            if t.size < 1 or not increasing or t[0] != 0.0:
                raise wrong(t, "t", expected)
            if self.a is not None:
                layout = "numbers, one for each joint, in a row per interval or node"
                if len(self._take("a", (None, self.n), layout)) != t.size:
                    self._take("a", (t.size - 1, self.n), layout)
            if self.segment_ends is not None:
                expected = f"times of nodes in order, up to T = {t[-1]:g} s"
                self._take_ends(expected, nodes=True)
        dynamics, ends = self.segment_dynamics, self.segment_ends
        known = isinstance(dynamics, list | tuple) and all(map(callable, dynamics))
        if not known or len(dynamics) not in (0, 1 if ends is None else len(ends)):
            raise wrong(dynamics, "segment_dynamics", f"for each segment {DYNAMICS}")

    def segment_at(self, times: Array) -> IntArray:
        """Index of the segment at each time, shape (m,); at an end the later one."""
        return self._segments_at(array(times, "times", (None,), "times [s]"))

    def _check_joints(self, expected: tuple[str, ...]) -> None:
        """Check that this is a motion of the joints of a robot."""
        if self.joint_names != expected:
            said = f"this is a motion of {', '.join(self.joint_names)}"
            said += f", expected a motion of {', '.join(expected)}"
            raise ProblemError(said, "trajectory")

    @property
    def duration(self) -> float:
        """Duration T [s]."""
        return float(self.t[-1])

    @property
    def degree(self) -> int:
        """Degree of the positions between the nodes: 2, 3 or 5."""
        if self.a is None:
            return 3
        return 5 if len(self.a) == self.t.size else 2

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    def __repr__(self) -> str:
        """Show joints, nodes and duration on one line."""
        return self._in_brief("node", f"T = {self.duration:.6g} s")

    @overload
    def __call__(
        self, time: ArrayLike, nu: None = None, *, hold: bool = False
    ) -> State: ...

    @overload
    def __call__(self, time: ArrayLike, nu: int, *, hold: bool = False) -> Array: ...

    def __call__(
        self, time: ArrayLike, nu: int | None = None, *, hold: bool = False
    ) -> State | Array:
        """Evaluate the motion.

        Args:
            time: A time [s] or an array of times, shape (m,), from 0 to T.
            nu: Order of a derivative of the position, as in SciPy's ``PPoly``: 0 for
                the position alone, 1 for the velocity, 3 for the jerk; None for the
                whole state.
            hold: Whether times may be before the start or after the end: there the arm
                rests at the position of the nearer end, with the torque that holds it;
                this torque is NaN for a motion without dynamics.

        Returns:
            Position, velocity, acceleration and torque, or the derivative: shape (n,)
            for a single time, (m, n) for an array of times. Where the torque or the
            acceleration jumps, the values just after the jump.

        Raises:
            ProblemError: If a time is not a number, the times are not in one row, or a
                time is outside of the motion by more than rounding and ``hold`` is
                False.
        """
        times = array_or_nan(time)
        if times.ndim > 1 or np.any(np.isnan(times)):
            raise wrong(time, "time", "a time or a row of times [s]")
        row = np.atleast_1d(times)
        slack = ROUNDING * max(1.0, self.duration)
        outside = (row < -slack) | (row > self.duration + slack)
        if np.any(outside) and hold is not True:
            raise ProblemError(
                f"time is {row[outside][0]:g} s, outside of the motion, which takes "
                f"from 0 to {self.duration:g} s; hold=True holds its ends",
                "time",
            )
        inside = np.clip(row, 0.0, self.t[-1])
        if nu is not None:
            value = np.array(self.derivative(nu)(inside))
            value[outside] *= nu == 0  # the arm rests outside of the motion
            return value[0] if times.ndim == 0 else value
        state = self._evaluate(inside)
        if np.any(outside):
            state = self._held(state, outside, row)
        if times.ndim == 0:
            return State(*(rows[0] for rows in state))
        return state

    def derivative(self, nu: int = 1) -> PPoly:
        """Time derivative of the position, as a ``scipy.interpolate.PPoly``.

        Args:
            nu: Order of the derivative: 0 for the position, 1 for the velocity, ...

        Returns:
            A function of times, which is NaN outside of the motion, with the methods
            ``derivative``, ``antiderivative``, ``solve`` and ``roots`` of SciPy.

        Raises:
            ProblemError: If the order is not a whole number from 0.
        """
        # Derivatives beyond the degree are zero, and SciPy loops up to the order.
        return self._curve.derivative(min(whole(nu, "nu"), 9))

    def _repr_html_(self) -> str:
        """Show curves and a table, in notebooks."""
        times = np.linspace(0.0, self.duration, 200)
        q, v, _, u = self(times)
        title = f"Trajectory in SI units, T = {self.duration:.6g} s"
        return motion_card(title, self.joint_names, times, q, v, u)

    def _held(self, state: State, outside: BoolArray, times: Array) -> State:
        """The states, with the arm held at rest at times outside of the motion."""
        q, v, a, u = map(np.array, state)
        v[outside] = a[outside] = 0.0
        rest = q[outside], v[outside], a[outside]
        u[outside] = self._torques(times[outside], *rest, held=True)
        return State(q, v, a, u)

    @cached_property
    def _curve(self) -> PPoly:
        """The positions, as polynomials between the nodes."""
        return curve_through(self.t, self.q, self.v, self.a)

    def _evaluate(self, times: Array) -> State:
        """The states at times within the motion, shape (m,)."""
        q, v, a = (self._curve(times, nu) for nu in range(3))
        node = np.searchsorted(self.t, times, side="right") - 1
        if self.inverse_dynamics is None:
            return State(q, v, a, self.u[node])
        u = self._torques(times, q, v, a)
        return State(q, v, a, np.where(node[:, None] < self.t.size - 1, u, self.u[-1]))

    def _torques(
        self, times: Array, q: Array, v: Array, a: Array, *, held: bool = False
    ) -> Array:
        """Torques by inverse dynamics; dry friction helps to hold an arm at rest."""
        several = self.segment_dynamics
        every = several or (self.inverse_dynamics or self.holding,)
        segment, out = self._segments_at(times), np.full_like(q, np.nan)
        for k, dynamics in enumerate(every):
            mask: BoolArray | slice = segment == k if several else slice(None)
            rows = q[mask], v[mask], a[mask]
            if dynamics is None or not len(rows[0]):
                continue
            # The dynamics of a robot take the directions; other functions determine
            # them from the velocity.
            owner = None if held else getattr(dynamics, "__self__", None)
            if isinstance(owner, RobotDynamics) and owner.friction is not None:
                out[mask] = owner.inverse_along(*rows, self.turns.at(times[mask]))
            else:
                out[mask] = dynamics(*rows)
        return out

    @cached_property
    def turns(self) -> Turns:
        """Directions of motion of the joints, and their reversals."""
        return Turns.of(self._curve.derivative())

    def with_torques(
        self,
        inverse_dynamics: InverseDynamics,
        segment_dynamics: tuple[InverseDynamics, ...] = (),
    ) -> Trajectory:
        """The same movement with torques by inverse dynamics.

        Args:
            inverse_dynamics: Inverse dynamics, see the attribute.
            segment_dynamics: Inverse dynamics on each segment, see the attribute.

        Raises:
            ProblemError: If the inverse dynamics are no functions.
        """
        if not callable(inverse_dynamics):
            raise wrong(inverse_dynamics, "inverse_dynamics", DYNAMICS)
        motion = replace(
            self,
            inverse_dynamics=inverse_dynamics,
            holding=None,
            segment_dynamics=segment_dynamics,
        )
        a = self._curve(self.t, 2)
        return replace(motion, u=motion._torques(self.t, self.q, self.v, a))

    def _on_nodes(self, t: Array) -> Trajectory:
        """The rest of the motion from the first of other nodes on.

        Args:
            t: Times of the nodes [s], among them all later nodes of the motion.
        """
        q, v, every, u = self(t)
        # Accelerations for each interval, or for each node.
        a = {2: every[:-1], 5: every}.get(self.degree)
        ends = None if self.segment_ends is None else self.segment_ends - t[0]
        return replace(self, t=t - t[0], q=q, v=v, u=u, a=a, segment_ends=ends)

    def sample(self, dt: float) -> Samples:
        """Sample the motion at a fixed rate; the end is always the last sample.

        Args:
            dt: Time between samples [s], positive.

        Returns:
            The samples, at 0, dt, 2 dt, ..., T.

        Raises:
            ProblemError: If dt is not a positive time, or would give more than half a
                million samples.
        """
        step = number(dt, "dt", "a positive time [s]", above=0.0)
        if self.duration / step > MAX_SAMPLES:
            raise ProblemError(
                f"dt is {step:.3g} s, too small for a motion of {self.duration:.3g} s: "
                f"more than {MAX_SAMPLES} samples",
                field="dt",
            )
        times = clock(self.duration, step)
        states = self(self._at_nodes(times))
        return Samples(self.joint_names, times, *states, segment_ends=self.segment_ends)

    def _at_nodes(self, times: Array) -> Array:
        """Times, moved to nodes from which they differ only by rounding.

        A time just before a node would yield the acceleration before a jump.
        """
        right = np.minimum(np.searchsorted(self.t, times), self.t.size - 1)
        left = np.maximum(right - 1, 0)
        nearer = np.abs(self.t[right] - times) < np.abs(self.t[left] - times)
        node = self.t[np.where(nearer, right, left)]
        return np.where(np.abs(node - times) < SAME_TIME, node, times)


def torque_breaks(trajectory: Trajectory, friction: Array) -> Array:
    """Times between which the torques of a motion are smooth [s].

    Args:
        trajectory: The motion.
        friction: Dry friction of the joints, shape (n,) [N m or N].

    Returns:
        The nodes, and, if torques follow from inverse dynamics, the reversals of joints
        with dry friction between them; in the order of time.
    """
    dry = friction > 0.0
    if trajectory.inverse_dynamics is None or not np.any(dry):
        return trajectory.t
    return np.union1d(trajectory.t, trajectory.turns.of_joints(dry))
