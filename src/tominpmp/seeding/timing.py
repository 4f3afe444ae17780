r"""Time-optimal timing of a straight line in joint space.

On q(s) = q_0 + s (q_1 - q_0) the torque is m(s) s'' + b(s) s'^2 + d s' + g(s). With x =
s'^2 the largest controllable x is found backwards from the end and followed forwards
(reachability analysis after Pham and Pham, 2018). Viscous friction enters with s', so
that the constraints are not linear in (s'', x); they are therefore evaluated on a table
of x.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.robot import JointLimits
from tominpmp.transcription.system import System

POINTS = 120  # grid points of s
SPEEDS = 160  # table entries of x at each of them


@dataclass(frozen=True)
class LineTiming:
    """A motion along a straight line in joint space.

    Attributes:
        q_start: Shape (n,).
        q_end: Shape (n,).
        s: Grid of the path parameter from 0 to 1, shape (m,).
        t: Time at each of them [s], shape (m,).
        x: Squared speed of s there [1/s^2], shape (m,).
    """

    q_start: Array
    q_end: Array
    s: Array
    t: Array
    x: Array

    @property
    def duration(self) -> float:
        """T [s]."""
        return float(self.t[-1])

    def position(self, times: Array) -> Array:
        """Configurations at times, shape (k, n); s'' is constant on each step."""
        index = np.clip(
            np.searchsorted(self.t, times, side="right") - 1, 0, self.t.size - 2
        )
        step = times - self.t[index]
        speed = np.sqrt(self.x)
        slope = (speed[index + 1] - speed[index]) / (self.t[index + 1] - self.t[index])
        s = self.s[index] + step * (speed[index] + 0.5 * step * slope)
        s = np.clip(s, 0.0, 1.0)
        return self.q_start + s[:, None] * (self.q_end - self.q_start)


def time_straight_line(
    system: System, q_start: Array, q_end: Array
) -> LineTiming | None:
    """Traverse a straight line from rest to rest in minimum time.

    Args:
        system: Dynamics and limits.
        q_start: Start, shape (n,) [rad or m].
        q_end: End, shape (n,).

    Returns:
        The timing; None if the torque limits do not let the arm stand somewhere on it.
    """
    direction = q_end - q_start
    moved = np.abs(direction) > 1e-12
    if not np.any(moved):
        return None
    limits = system.problem.robot.limits
    # Near the ends s grows with the square of time: spacing that is even in time.
    s = 0.5 * (1.0 - np.cos(np.pi * np.linspace(0.0, 1.0, POINTS)))
    q = q_start + s[:, None] * direction
    along = np.broadcast_to(direction, q.shape)
    zero = np.zeros_like(q)
    dynamics = system.dynamics
    g = dynamics.inverse(q, zero, zero)
    m = dynamics.inverse(q, zero, along) - g
    fast = dynamics.inverse(q, along, zero) - g
    slow = dynamics.inverse(q, -along, zero) - g
    b, d = 0.5 * (fast + slow), 0.5 * (fast - slow)  # even and odd in the speed

    with np.errstate(divide="ignore"):
        top = float(np.min(limits.velocity[moved] / np.abs(direction[moved])))
    # From rest on a path of length 1, x is at most twice the largest s''.
    _, push = _acceleration_range(m, b, d, g, np.zeros(1), limits)
    top = min(top, 2.0 * float(np.sqrt(max(push.max(), 0.0))))
    if not 0.0 < top < np.inf:
        return None
    # Quadratic spacing: resolution where the motion begins and ends.
    table = top**2 * np.linspace(0.0, 1.0, SPEEDS) ** 2
    lower, upper = _acceleration_range(m, b, d, g, table, limits)
    return _integrate(q_start, q_end, s, table, lower, upper)


def _acceleration_range(
    m: Array, b: Array, d: Array, g: Array, table: Array, limits: JointLimits
) -> tuple[Array, Array]:
    """Smallest and largest s'' on the table, shapes (points, speeds)."""
    low_u, high_u = limits.effort_lower, limits.effort_upper
    rest = (
        b[:, None] * table[:, None] + d[:, None] * np.sqrt(table)[:, None] + g[:, None]
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        one = (low_u - rest) / m[:, None]
        two = (high_u - rest) / m[:, None]
    idle = np.broadcast_to(np.abs(m[:, None]) < 1e-12, one.shape)
    outside = (rest < low_u) | (rest > high_u)
    low = np.where(idle, np.where(outside, np.inf, -np.inf), np.minimum(one, two))
    high = np.where(idle, np.where(outside, -np.inf, np.inf), np.maximum(one, two))
    return low.max(axis=2), high.min(axis=2)


def _integrate(
    q_start: Array, q_end: Array, s: Array, table: Array, lower: Array, upper: Array
) -> LineTiming | None:
    count, steps = s.size, np.diff(s)
    controllable = np.zeros(count)
    allowed = lower <= upper
    for i in range(count - 2, -1, -1):
        step, target = steps[i], controllable[i + 1]
        # Trapezoidal rule: friction changes along the step.
        brake = 0.5 * (lower[i] + np.interp(target, table, lower[i + 1]))
        reachable = (
            allowed[i]
            & (table + 2.0 * step * brake <= target + 1e-12)
            & (table + 2.0 * step * upper[i] >= 0.0)
        )
        if not reachable[0]:
            return None
        # The set is an interval from rest; the first failure ends it.
        last = int(np.argmin(reachable)) - 1 if not reachable.all() else table.size - 1
        controllable[i] = _refine(last, table, brake, target, step)
    x = np.zeros(count)
    for i in range(count - 1):
        step = steps[i]
        push = float(np.interp(x[i], table, upper[i]))
        ahead = min(controllable[i + 1], max(x[i] + 2.0 * step * push, 0.0))
        push = 0.5 * (push + float(np.interp(ahead, table, upper[i + 1])))
        x[i + 1] = min(controllable[i + 1], max(x[i] + 2.0 * step * push, 0.0))
        if x[i + 1] <= 0.0 and i + 1 < count - 1:
            return None
    speed = np.sqrt(x)
    t = np.concatenate([[0.0], np.cumsum(2.0 * steps / (speed[:-1] + speed[1:]))])
    return LineTiming(q_start, q_end, s, t, x)


def _refine(last: int, table: Array, brake: Array, target: float, step: float) -> float:
    """Largest x between two table entries that can still brake to the target."""
    if last + 1 >= table.size:
        return float(table[last])
    x0, x1 = table[last], table[last + 1]
    f0 = x0 + 2.0 * step * brake[last] - target
    f1 = x1 + 2.0 * step * brake[last + 1] - target
    if not (np.isfinite(f1) and f1 > 0.0 >= f0):
        return float(x0)
    return float(x0 + (x1 - x0) * (-f0) / (f1 - f0))
