r"""Time-optimal timing of paths in joint space, and the pace of other guesses.

On q(s) the torque is m(s) s'' + b(s) s'^2 + d(s) s' + g(s). With x = s'^2 the largest
controllable x is computed backwards from the end, and a forward pass follows it
(reachability analysis after Pham and Pham, 2018). Viscous friction enters with s', so
that the constraints are not linear in (s'', x); they are therefore evaluated on a table
of x. Dry friction is a torque that depends only on the direction of a joint along the
path.

A motion that begins or ends moving does not follow a path that is at rest there: each
joint then has a timing of its own, and all have the same duration. It is judged by its
largest excess over all limits.

Paths are timed only by limits of speeds and torques. Limits of accelerations, jerks or
torque rates matter the more, the shorter a motion is. If they dominate, programs that
begin with the timed duration are badly scaled: the guess is then scaled to the duration
that these limits allow.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from tominpmp.arrays import Array, BoolArray
from tominpmp.constraints.base import States
from tominpmp.constraints.path import PathConstraint
from tominpmp.exceptions import ProblemError
from tominpmp.initial_guess.constrained import CLOSE, constraints_of
from tominpmp.initial_guess.path import RoundedPath
from tominpmp.kinematics import units_of
from tominpmp.problem.joint_limits import (
    control_bounds,
    control_kind,
    effort_range,
    joint_limits,
)
from tominpmp.transcription.problem_functions import ProblemFunctions

# Grid points of s, and table entries of x at each: a finer table takes twice as long,
# changes the durations of guesses by less than 0.1 %, and leads to no fewer programs.
# Paths with waits have as many places at most.
POINTS, SPEEDS = 64, 96
CORNER_POINTS = 9  # grid points added at each rounded corner
# Bisections for the speed at which a constraint becomes active that is not proportional
# to the speed, and for a time-scaling factor.
BISECTIONS = 30
# A joint with a larger mean speed is considered to have no effective limits [rad/s or
# m/s].
FASTEST = 2000.0
# Largest time-scaling factor of a guess for held loads and accelerations of tools.
SLOWEST = 1000.0


def time_path(system: ProblemFunctions, path: RoundedPath) -> CubicHermiteSpline | None:
    """Traverse a path from rest to rest in minimum time.

    Args:
        system: Dynamics and limits.
        path: The path. Its corners should be rounded, as a sharp corner would have to
            be passed at rest.

    Returns:
        The path parameter, from 0 to 1, as a curve of time from 0 to T, with a constant
        second derivative between its knots; None if torque limits do not allow the arm
        to rest at some point of the path, or nothing limits the speed at some point.
    """
    limits = system.problem.robot.limits
    middle, half = effort_range(system.problem.robot, system.motion_limits)
    s = path.grid(POINTS, CORNER_POINTS)
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
    idle = np.abs(m) < 1e-12
    inverse = 1.0 / np.where(idle, 1.0, m)

    def acceleration_range(table: Array) -> tuple[Array, Array]:
        """Smallest and largest feasible s'' on the table, shapes (points, speeds)."""
        # Each joint bounds s'' to an interval around the s'' of its middle torque.
        x = table[:, None, :]
        need = (
            ((middle - g) * inverse)[..., None]
            - (b * inverse)[..., None] * x
            - (d * inverse)[..., None] * np.sqrt(x)
        )
        room = (half * np.abs(inverse))[..., None]
        # A joint that does not move leaves s'' free, or excludes every s'' if its
        # torque does not suffice.
        free = np.where(np.abs(need) > room, -np.inf, np.inf)
        room = np.where(idle[..., None], free, room)
        with np.errstate(invalid="ignore"):
            return np.max(need - room, axis=1), np.min(need + room, axis=1)

    with np.errstate(divide="ignore"):
        top = np.min(limits.velocity / np.abs(first), axis=1)
    for constraint in system.problem.ready_constraints:
        if constraint.order == 1 and constraint.curable:
            top = np.minimum(top, _speeds(constraint, q, first))
    # From rest on a path of length 1, x is at most twice the largest s'', which is
    # taken at rest.
    _, push = acceleration_range(np.zeros((s.size, 1)))
    top = np.minimum(top, 2.0 * np.sqrt(max(float(push.max()), 0.0)))
    if not (np.all(top > 0.0) and np.all(np.isfinite(top))):
        return None
    # Quadratic spacing gives resolution where the motion begins and ends.
    table = top[:, None] ** 2 * np.linspace(0.0, 1.0, SPEEDS) ** 2
    lower, upper = acceleration_range(table)
    return _integrate(s, table, lower, upper)


def _integrate(
    s: Array, table: Array, lower: Array, upper: Array
) -> CubicHermiteSpline | None:
    """Backward pass for controllable x, forward pass for the fastest x; then times."""
    count, steps = s.size, np.diff(s)
    controllable = np.zeros(count)
    allowed = lower <= upper
    for i in range(count - 2, -1, -1):
        step, target = steps[i], controllable[i + 1]
        # Trapezoidal rule: friction changes along the step.
        brake = 0.5 * (lower[i] + np.interp(target, table[i + 1], lower[i + 1]))
        usable = allowed[i] & (table[i] + 2.0 * step * upper[i] >= 0.0)
        # The controllable set is an interval from rest: the first failure ends it.
        fastest = _largest(table[i], table[i] + 2.0 * step * brake - target, usable)
        if fastest is None:
            return None
        controllable[i] = fastest
    x = np.zeros(count)
    for i in range(count - 1):
        step = steps[i]
        # Trapezoidal rule, for the next speed that fits the largest s'' there.
        target = x[i] + step * float(np.interp(x[i], table[i], upper[i]))
        ahead = _largest(table[i + 1], table[i + 1] - step * upper[i + 1] - target)
        x[i + 1] = min(controllable[i + 1], ahead or 0.0)
        if x[i + 1] <= 0.0 and i + 1 < count - 1:
            return None
    speed = np.sqrt(x)
    t = np.concatenate([[0.0], np.cumsum(2.0 * steps / (speed[:-1] + speed[1:]))])
    return CubicHermiteSpline(t, s, speed)


def _largest(
    table: Array, excess: Array, usable: BoolArray | bool = True
) -> float | None:
    """Largest x, by interpolation, before the first entry that is beyond a bound.

    Args:
        table: Values of x, increasing, shape (speeds,).
        excess: Their excess over the bound, shape (speeds,).
        usable: Whether each entry may be taken at all.

    Returns:
        The largest x; None if the first entry is beyond the bound.
    """
    fits = usable & (excess <= 1e-12)
    last = (fits.size if fits.all() else int(fits.argmin())) - 1
    if last < 0:
        return None
    x, beyond = table[last : last + 2], excess[last : last + 2]
    crossed = -np.inf < beyond[0] <= 0.0 < beyond[-1] < np.inf
    return float(np.interp(0.0, beyond, x) if crossed else x[0])


def fastest_between(
    system: ProblemFunctions, q_end: Array, v_end: Array, samples: int
) -> States:
    """Motion with the velocities of both ends, in the least feasible duration found.

    Feasible durations of motions that begin or end moving are separate intervals: the
    motion leads to its goal directly, or it has to overshoot it or take a run-up. They
    are judged by samples. As faster motions exist than those tried, a minimum of the
    excess below 100 % counts as an interval; without one, the duration of least excess
    is taken.

    Args:
        system: Functions of the problem.
        q_end: Configuration at the end, shape (n,) [rad or m].
        v_end: Velocity at the end, shape (n,) [rad/s or m/s].
        samples: Number of durations that are tried, and of states of the result.
    """
    problem = system.problem
    q, v, top = problem.q_start, problem.v_start, problem.robot.limits.velocity
    ends, way, mean = (q, v, q_end, v_end), q_end - q, 0.5 * (v + v_end)
    least = max(float(np.max(np.abs(way) / top)), 1e-3)
    # The short intervals are near the durations of constant accelerations.
    direct = np.divide(way, mean, out=np.zeros_like(way), where=mean != 0.0)
    durations = least * np.geomspace(1.001, 1e7, samples)
    durations = np.sort(np.append(durations, direct[direct > durations[0]]))
    shares = np.linspace(1e-9, 1.0 - 1e-9, 17)  # accelerations begin and end in jumps
    best = np.inf, 0.0
    for T in durations.tolist():
        at = between_velocities(ends, top, T, T * shares)
        excess = largest_excess(system, T, at)
        best = min(best, (excess, T))
        if best[0] <= CLOSE or best[0] < min(excess, 1.0):
            break
    return between_velocities(ends, top, best[1], np.linspace(0.0, best[1], samples))


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


def _speeds(constraint: PathConstraint, q: Array, first: Array) -> Array:
    """Speeds along a path at which a constraint becomes active, infinite elsewhere.

    Args:
        constraint: The constraint on velocities.
        q: Configurations, shape (m, n).
        first: Derivatives of the configurations by the path parameter, shape (m, n).

    Returns:
        Derivatives of the path parameter by time, shape (m,).
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
    used = np.max(np.abs(v) / system.problem.robot.limits.velocity, axis=1)
    empty = np.zeros((len(q), 0))
    for item in constraints_of(system, 1):
        if item.curable:
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
    for item in joint_limits(system.problem.robot, system.motion_limits):
        rate = rates.get(item.kind.quantity)
        beyond = item.beyond(q, v, a, u) if rate is None else item.outside(rate)
        share = beyond[:, item.joints] / item.scale[item.joints]
        worst.append(float(np.max(share, initial=0.0)))
    for each in system.problem.ready_constraints:
        value, (lower, upper) = each.evaluate(at), each.bounds(len(q))
        worst.append(float(np.max(np.maximum(lower - value, value - upper))))
    return max(worst)


def least_duration(system: ProblemFunctions, q: Array) -> float:
    """Estimate of the duration of a path under motion limits, from rest to rest [s].

    The path is given by configurations, shape (m, n). The estimate tends to be too
    short; it is 0 without limits of accelerations, jerks or torque rates.
    """
    span, zero = np.ptp(q, axis=0), np.zeros((1, q.shape[1]))
    load = system.dynamics.inverse(q[:1], zero, span[None])
    load = np.abs(load - system.dynamics.inverse(q[:1], zero, zero))[0]
    change, times = {"a": span, "j": span, "du": load}, [0.0]
    for item in joint_limits(system.problem.robot, system.motion_limits):
        if item.kind.quantity in change:
            # Distance from rest to rest under a bang-bang derivative of this order.
            order = item.kind.order
            power = 4.0 * 8.0 ** (order - 2) * change[item.kind.quantity] / item.upper
            times.append(float(np.max(power)) ** (1.0 / order))
    return max(times)


def slowdown(system: ProblemFunctions, t: Array, q: Array) -> float:
    """Time-scaling factor of a guess for limits beyond speeds and torques.

    Args:
        system: Functions of the problem.
        t: Times of the guess [s], shape (m,).
        q: Configurations of the guess, shape (m, n).

    Raises:
        ProblemError: If no limit is effective for the motion.
    """
    duration = float(t[-1])
    factor = max(1.0, least_duration(system, q) / duration)
    speed = np.ptp(q, axis=0) / (factor * duration)
    joint = int(np.argmax(speed))
    if speed[joint] > FASTEST:
        robot = system.problem.robot
        unit = units_of(robot)[joint]
        bounds = control_bounds(robot, system.problem.motion_limits)
        effort = max(abs(bound[joint]) for bound in bounds)
        raise ProblemError(
            f"robot: joint {robot.joint_names[joint]!r} would go "
            f"{np.ptp(q[:, joint]):.3g} {unit} in {factor * duration:.1e} s, as its "
            f"limits of velocity ({robot.limits.velocity[joint]:.3g} {unit}/s) and "
            f"{control_kind(robot).name} ({effort:.3g}) hardly limit it: a "
            "time-optimal motion needs limits. Expected those of the arm as velocity= "
            "and effort= of load_robot, limits='datasheet', or an acceleration= of "
            "MotionLimits",
            "robot",
        )
    return _load_time_scale(system, factor * t, q) * factor


def _load_time_scale(system: ProblemFunctions, t: Array, q: Array) -> float:
    """Time-scaling factor of a guess for held loads and for accelerations of tools.

    Args:
        system: Functions of the problem.
        t: Times of the guess [s], shape (m,).
        q: Configurations of the guess, shape (m, n).

    Returns:
        The factor; 1 without such constraints, or if slowing down does not remove the
        violation.
    """
    held = [item for item in constraints_of(system, 2) if item.curable]
    if not held or np.any(np.diff(t) <= 0.0):
        return 1.0
    v = np.gradient(q, t, axis=0)
    a = np.gradient(v, t, axis=0)

    def feasible(factor: float) -> bool:
        return all(
            np.max(item.value_rows(q, v / factor, a / factor**2)) <= 0.0
            for item in held
        )

    low, high = 1.0, SLOWEST
    if feasible(low) or not feasible(high):
        return 1.0
    for _ in range(BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if feasible(middle) else (middle, high)
    return high
