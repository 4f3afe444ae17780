"""A motion over time: nodes, and the curve between them.

Two curves occur. Motions planned with the inverse dynamics have a constant acceleration
on each interval: position and velocity are exact polynomials and the torque follows from
the inverse dynamics at every instant. Motions planned with piecewise-constant torque are
given at their nodes and joined by cubic Hermite polynomials.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, frozen_array
from tominpmp.exceptions import ProblemError

InverseDynamics = Callable[[Array, Array, Array], Array]


class State(NamedTuple):
    """What a trajectory gives at a time.

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


@dataclass(frozen=True)
class Samples:
    """A trajectory sampled at many times, one row a time.

    Attributes:
        joint_names: Names of the joints, in column order.
        t: Times [s], shape (m,).
        q: Positions [rad or m], shape (m, n).
        v: Velocities [rad/s or m/s], shape (m, n).
        a: Accelerations [rad/s^2 or m/s^2], shape (m, n).
        u: Torques [N m or N], shape (m, n).
    """

    joint_names: tuple[str, ...]
    t: Array
    q: Array
    v: Array
    a: Array
    u: Array


@dataclass(frozen=True)
class Trajectory:
    """A motion of all joints from time 0 to its duration.

    Attributes:
        joint_names: Names of the joints, in column order.
        t: Times of the nodes [s], increasing from 0, shape (N + 1,).
        q: Positions at the nodes [rad or m], shape (N + 1, n).
        v: Velocities at the nodes [rad/s or m/s], shape (N + 1, n).
        u: Torques at the nodes [N m or N], shape (N + 1, n). Where the torque jumps at a
            node, the row holds the value just after it; the last row holds the value at
            the end.
        a: Acceleration of each interval, shape (N, n), for motions with constant
            acceleration on each interval; None for motions with constant torque.
        inverse_dynamics: Function (q, v, a) -> u on rows, for the torque between nodes of
            a motion with constant acceleration; without it the torque is constant.
    """

    joint_names: tuple[str, ...]
    t: Array
    q: Array
    v: Array
    u: Array
    a: Array | None = None
    inverse_dynamics: InverseDynamics | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Check the shapes and make the arrays read-only."""
        for name in ("t", "q", "v", "u"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        if self.a is not None:
            object.__setattr__(self, "a", frozen_array(self.a))
        nodes, n = self.t.size, len(self.joint_names)
        for name in ("q", "v", "u"):
            shape = getattr(self, name).shape
            if shape != (nodes, n):
                raise ProblemError(
                    f"trajectory field {name!r} has shape {shape}, expected "
                    f"{(nodes, n)}: one row a node, one column a joint",
                    field=name,
                )
        if nodes < 2 or not np.all(np.diff(self.t) > 0.0):
            raise ProblemError("trajectory times must increase", field="t")

    @property
    def duration(self) -> float:
        """Duration T [s]."""
        return float(self.t[-1])

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    def __call__(self, time: ArrayLike) -> State:
        """Evaluate the motion.

        Args:
            time: A time [s] or an array of times, shape (m,). Times before the start or
                after the end give the state there.

        Returns:
            Position, velocity, acceleration and torque: shape (n,) for a single time,
            (m, n) for an array of times.
        """
        times = np.atleast_1d(np.asarray(time, dtype=np.float64))
        state = self._evaluate(np.clip(times, 0.0, self.t[-1]))
        if np.ndim(time) == 0:
            return State(*(part[0] for part in state))
        return state

    def _evaluate(self, times: Array) -> State:
        k = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, self.t.size - 2)
        s = (times - self.t[k])[:, None]
        h = (self.t[k + 1] - self.t[k])[:, None]
        q0, v0 = self.q[k], self.v[k]
        if self.a is not None:
            a = self.a[k]
            q, v = q0 + s * v0 + 0.5 * s**2 * a, v0 + s * a
        else:
            q1, v1 = self.q[k + 1], self.v[k + 1]
            c2 = (3.0 * (q1 - q0) / h - 2.0 * v0 - v1) / h
            c3 = (2.0 * (q0 - q1) / h + v0 + v1) / h**2
            q = q0 + s * (v0 + s * (c2 + s * c3))
            v = v0 + s * (2.0 * c2 + 3.0 * s * c3)
            a = 2.0 * c2 + 6.0 * s * c3
        u = self.u[k] if self.inverse_dynamics is None else self.inverse_dynamics(q, v, a)
        return State(q, v, a, u)

    def sample(self, dt: float) -> Samples:
        """Sample the motion at a fixed rate; the end is always the last sample.

        Args:
            dt: Time between samples [s], positive.

        Returns:
            The samples, at 0, dt, 2 dt, ..., T.

        Raises:
            ProblemError: If dt is not a positive number.
        """
        if not np.isfinite(dt) or dt <= 0.0:
            raise ProblemError(f"dt is {dt}, expected a positive time in s", field="dt")
        times = np.arange(0.0, self.duration, dt)
        if self.duration - times[-1] < 1e-9 * self.duration and times.size > 1:
            times = times[:-1]
        times = np.append(times, self.duration)
        return Samples(self.joint_names, frozen_array(times), *self(times))

