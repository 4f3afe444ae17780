r"""Time-optimal timing of paths in joint space.

On q(s) the torque is m(s) s'' + b(s) s'^2 + d(s) s' + g(s). With x = s'^2 the largest
controllable x is computed backwards from the end, and a forward pass follows it
(reachability analysis after Pham and Pham, 2018). Viscous friction enters with s', so
that the constraints are not linear in (s'', x); they are therefore evaluated on a table
of x. Dry friction is a torque that depends only on the direction of a joint along the
path.

A motion that begins or ends moving does not follow a path that is at rest there: each
joint then has a timing of its own, and all have the same duration. It is judged by its
largest excess over all limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.base import States
from tominpmp.constraints.path import PathConstraint
from tominpmp.initial_guess.path import RoundedPath
from tominpmp.problem.controls import effort_range
from tominpmp.problem.joint_limits import joint_limits
from tominpmp.transcription.problem_functions import ProblemFunctions

POINTS = 120  # grid points of s
CORNER_POINTS = 9  # grid points added at each rounded corner
SPEEDS = 160  # table entries of x at each grid point
# Grid points and table entries for a straight line, on which no joint reverses: a finer
# table takes twice as long, and does not lead to fewer programs.
LINE_POINTS, LINE_SPEEDS = 64, 96
# Bisections for the speed at which a constraint becomes active that is not proportional
# to the speed.
BISECTIONS = 30


@dataclass(frozen=True, eq=False)
class PathTiming:
    """A motion along a path.

    Attributes:
        path: The path.
        s: Grid of the path parameter from 0 to 1, shape (m,).
        t: Time at each grid point [s], shape (m,).
        x: Squared speed of s at each grid point [1/s^2], shape (m,).
    """

    path: RoundedPath
    s: Array
    t: Array
    x: Array

    @property
    def duration(self) -> float:
        """T [s]."""
        return float(self.t[-1])

    def position(self, times: Array) -> Array:
        """Configurations at times, shape (k, n); s'' is constant on each interval."""
        index = np.searchsorted(self.t, times, side="right") - 1
        index = np.clip(index, 0, self.t.size - 2)
        step = times - self.t[index]
        speed = np.sqrt(self.x)
        slope = (speed[index + 1] - speed[index]) / (self.t[index + 1] - self.t[index])
        s = self.s[index] + step * (speed[index] + 0.5 * step * slope)
        return self.path.evaluate(np.clip(s, 0.0, 1.0))[0]


def time_path(system: ProblemFunctions, path: RoundedPath) -> PathTiming | None:
    """Traverse a path from rest to rest in minimum time.

    Args:
        system: Dynamics and limits.
        path: The path. Its corners should be rounded, as a sharp corner would have to
            be passed at rest.

    Returns:
        The timing; None if torque limits do not allow the arm to rest at some point of
        the path, or nothing limits the speed at some point.
    """
    limits = system.problem.robot.limits
    torques = effort_range(system.problem.robot, system.motion_limits)
    straight = path.s.size == 2
    points, speeds = (LINE_POINTS, LINE_SPEEDS) if straight else (POINTS, SPEEDS)
    s = path.grid(points, CORNER_POINTS)
    q, first, second = path.evaluate(s)
    zero = np.zeros_like(q)
    dynamics = system.dynamics
    g = dynamics.inverse(q, zero, zero)
    m = dynamics.inverse(q, zero, first) - g
    fast = dynamics.inverse(q, first, second) - g
    slow = dynamics.inverse(q, -first, second) - g
    b, d = 0.5 * (fast + slow), 0.5 * (fast - slow)  # even and odd in the speed
    if system.friction is not None:
        g = g + system.problem.robot.friction * np.sign(first)

    with np.errstate(divide="ignore"):
        top = np.min(limits.velocity / np.abs(first), axis=1)
    top = np.minimum(top, _path_speeds(system, q, first))
    # From rest on a path of length 1, x is at most twice the largest s'', which is
    # taken at rest.
    _, push = _acceleration_range(m, b, d, g, np.zeros((s.size, 1)), torques)
    top = np.minimum(top, 2.0 * np.sqrt(max(float(push.max()), 0.0)))
    if not (np.all(top > 0.0) and np.all(np.isfinite(top))):
        return None
    # Quadratic spacing gives resolution where the motion begins and ends.
    table = top[:, None] ** 2 * np.linspace(0.0, 1.0, speeds) ** 2
    lower, upper = _acceleration_range(m, b, d, g, table, torques)
    return _integrate(path, s, table, lower, upper)


def _acceleration_range(
    m: Array,
    b: Array,
    d: Array,
    g: Array,
    table: Array,
    torques: tuple[Array, Array],
) -> tuple[Array, Array]:
    """Smallest and largest feasible s'' on the table, shapes (points, speeds)."""
    middle, half = torques
    idle = np.abs(m) < 1e-12
    inverse = 1.0 / np.where(idle, 1.0, m)
    # Each joint bounds s'' to an interval around the s'' of its middle torque.
    x = table[:, None, :]
    need = (
        ((middle - g) * inverse)[..., None]
        - (b * inverse)[..., None] * x
        - (d * inverse)[..., None] * np.sqrt(x)
    )
    room = (half * np.abs(inverse))[..., None]
    # A joint that does not move leaves s'' free, or excludes every s'' if its torque
    # does not suffice.
    free = np.where(np.abs(need) > room, -np.inf, np.inf)
    room = np.where(idle[..., None], free, room)
    with np.errstate(invalid="ignore"):
        return np.max(need - room, axis=1), np.min(need + room, axis=1)


def _integrate(
    path: RoundedPath, s: Array, table: Array, lower: Array, upper: Array
) -> PathTiming | None:
    """Backward pass for controllable x, forward pass for the fastest x; then times."""
    count, steps = s.size, np.diff(s)
    controllable = np.zeros(count)
    allowed = lower <= upper
    for i in range(count - 2, -1, -1):
        step, target = steps[i], controllable[i + 1]
        # Trapezoidal rule: friction changes along the step.
        brake = 0.5 * (lower[i] + np.interp(target, table[i + 1], lower[i + 1]))
        reachable = (
            allowed[i]
            & (table[i] + 2.0 * step * brake <= target + 1e-12)
            & (table[i] + 2.0 * step * upper[i] >= 0.0)
        )
        if not reachable[0]:
            return None
        # The controllable set is an interval from rest: the first failure ends it.
        reached = reachable.size if reachable.all() else int(np.argmin(reachable))
        last = reached - 1
        controllable[i] = _refine(last, table[i], brake, target, step)
    x = np.zeros(count)
    for i in range(count - 1):
        step = steps[i]
        # Trapezoidal rule, for the next speed that fits the largest s'' there.
        target = x[i] + step * float(np.interp(x[i], table[i], upper[i]))
        push = -0.5 * upper[i + 1]
        beyond = table[i + 1] + 2.0 * step * push > target
        last = (int(np.argmax(beyond)) if beyond.any() else beyond.size) - 1
        if last >= 0:
            ahead = _refine(last, table[i + 1], push, target, step)
            x[i + 1] = min(controllable[i + 1], ahead)
        if x[i + 1] <= 0.0 and i + 1 < count - 1:
            return None
    speed = np.sqrt(x)
    t = np.concatenate([[0.0], np.cumsum(2.0 * steps / (speed[:-1] + speed[1:]))])
    return PathTiming(path, s, t, x)


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


def between_velocities(
    ends: Sequence[Array], top: Array, T: float, times: Array
) -> States:
    """Motion from velocities to velocities with the least peak acceleration per joint.

    A joint changes its speed, cruises if it reaches its speed limit, and changes its
    speed again. It overshoots its goal, or takes a run-up, where it has to.

    Args:
        ends: Positions and velocities at the start, then those at the end, (n,) each.
        top: Speed limits, shape (n,).
        T: Duration [s], in which the speed limits admit the displacements.
        times: Times of the motion [s], shape (m,).

    Returns:
        The states at these times; where an acceleration jumps, the one before.
    """
    q, v, q_end, v_end = ends
    way, mean = q_end - q, 0.5 * (v + v_end)
    # Displacement beyond that of constant accelerations.
    lack = way - T * mean
    wide = np.copysign(np.hypot(lack, 0.5 * T * (v_end - v)), lack)
    peak = np.clip(mean + (lack + wide) / T, -top, top)
    first, last = peak - v, peak - v_end
    # The inverse of the acceleration; zero where the velocity is constant.
    slow = 2.0 * (peak * T - way) / np.maximum(first**2 + last**2, 1e-300)
    a = np.divide(1.0, slow, out=np.zeros_like(slow), where=slow != 0.0)
    begins = np.stack([0.0 * first, first * slow, T - last * slow])
    since = np.maximum(times[:, None] - begins[:, None], 0.0)
    each = (0.5 * since**2, since, np.sign(since))
    second, once, now = (a * (ahead - up - down) for ahead, up, down in each)
    return States(times, q + times[:, None] * v + second, v + once, now)


def _path_speeds(system: ProblemFunctions, q: Array, first: Array) -> Array:
    """Speeds along a path at which constraints on velocities become active.

    Args:
        system: Functions of the problem.
        q: Configurations, shape (m, n).
        first: Derivatives of the configurations by the path parameter, shape (m, n).

    Returns:
        Derivatives of the path parameter by time, shape (m,); infinite where no
        constraint on velocities becomes active.
    """
    top = np.full(len(q), np.inf)
    for constraint in system.problem.ready_constraints:
        if constraint.order == 1 and constraint.curable:
            top = np.minimum(top, _speeds(constraint, q, first))
    return top


def _speeds(constraint: PathConstraint, q: Array, first: Array) -> Array:
    """Speeds along a path at which a constraint becomes active, infinite elsewhere.

    Args:
        constraint: The constraint on velocities.
        q: Configurations, shape (m, n).
        first: Derivatives of the configurations by the path parameter, shape (m, n).
    """
    most, empty = constraint.largest, np.zeros((len(q), 0))
    unit = constraint.measure_rows(q, first, empty)
    moving = unit > 0.0
    high = most / np.where(moving, unit, 1.0)

    def excess(speed: Array) -> Array:
        return constraint.measure_rows(q, speed[:, None] * first, empty) - most

    # Most measures are proportional to the speed along the path.
    bent = moving & (np.abs(excess(high)) > 1e-6 * abs(most))
    low = np.where(bent, 0.0, high)
    for _ in range(BISECTIONS if np.any(bent) else 0):
        middle = 0.5 * (low + high)
        over = excess(middle) > 0.0
        low, high = np.where(over, low, middle), np.where(over, middle, high)
    return np.where(moving, low, np.inf)


def speed_used(system: ProblemFunctions, q: Array, v: Array) -> Array:
    """Largest share of a speed limit that a motion uses, at m states, shape (m,).

    Speed limits of joints and of tools are taken into account.
    """
    problem = system.problem
    used = np.max(np.abs(v) / problem.robot.limits.velocity, axis=1)
    empty = np.zeros((len(q), 0))
    for item in problem.ready_constraints:
        if item.order == 1 and item.curable and item.window is None:
            used = np.maximum(used, item.measure_rows(q, v, empty) / item.largest)
    return np.asarray(used)


def largest_excess(system: ProblemFunctions, T: float, at: States) -> float:
    """Largest excess of a motion over its limits and constraints, except clearances.

    It is judged by samples, as a share of a limit, and zero within all limits. Where
    jerks or torque rates are limited, the motion is taken for one from rest to rest
    whose accelerations rise and fall at a constant rate.

    Args:
        system: Functions of the problem.
        T: Duration of the motion [s].
        at: States at the samples.
    """
    q, v, a, inverse = at.q, at.v, at.a, system.motor_dynamics.inverse
    u = inverse(q, v, a)
    inertial = u - inverse(q, v, 0.0 * a)
    rates = {"j": 8.0 * a / T, "du": 8.0 * inertial / T}
    worst = [0.0]
    for item in joint_limits(system.problem):
        rate = rates.get(item.kind.quantity)
        beyond = item.beyond(q, v, a, u) if rate is None else item.outside(rate)
        share = beyond[:, item.joints] / item.scale[item.joints]
        worst.append(float(np.max(share, initial=0.0)))
    for each in system.problem.ready_constraints:
        value, (lower, upper) = each.evaluate(at), each.bounds(len(q))
        worst.append(float(np.max(np.maximum(lower - value, value - upper))))
    return max(worst)
