"""Bounds from the motion of each joint by itself.

An arm with one joint is bounded by its torques, too. Its inertia does not change, so
that its acceleration is what torque, friction and gravity leave at its speed. Where
gravity acts alike wherever the joint is, as on a rail, speeding up to a peak and
slowing down is the fastest motion there is. That of a pendulum is taken to pull either
way as strongly as it does anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.energy import effort_bounds, effort_curves
from tominpmp.bounds.least_time import Both, Change, Drive, Ramp, SpeedLaw
from tominpmp.bounds.result import LowerBound
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import prismatic_joints
from tominpmp.problem.joint_limits import joint_limits
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot

# Quantities whose largest values bound a joint by itself: speeds, accelerations, jerks
# and torque rates, as kinds of limits name them.
BOUNDED = ("v", "a", "j", "du")


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint and the limits of its motion.

    Attributes:
        name: Its name.
        drive: Its limits of speed and acceleration.
        limits: These limits in words.
        unit: Unit of its position.
    """

    name: str
    drive: Drive
    limits: str
    unit: str


def joints_of(problem: Problem, smooth_ends: bool) -> list[Joint]:
    """The joints of a problem.

    Args:
        problem: The problem.
        smooth_ends: Whether accelerations that may not jump are zero at both ends.
    """
    tightest, found = _tightest_limits(problem), []
    names, slides = problem.robot.joint_names, prismatic_joints(problem.robot)
    for i, name in enumerate(names):
        unit = "m" if slides[i] else "rad"
        top, acceleration, jerk, _ = (float(most[i]) for most in tightest.values())
        ramp = Ramp(acceleration, jerk if smooth_ends else math.inf)
        limits = _in_words((top, ramp.acceleration, ramp.jerk), unit)
        found.append(Joint(name, Drive((ramp, ramp), (ramp, ramp), top), limits, unit))
    by_torque = _torque_drive(problem, tightest, smooth_ends)
    if by_torque is None:
        return found
    # Of an arm with one joint it has all limits in it.
    return [
        replace(found[0], drive=by_torque, limits="and no torque moves it there sooner")
    ]


def _tightest_limits(problem: Problem) -> dict[str, Array]:
    """The tightest limits of all joints by what they bound, see :data:`BOUNDED`.

    Infinite where a joint has no limit, shape (n,) each.
    """
    found = {of: np.full(problem.robot.n, math.inf) for of in BOUNDED}
    for item in joint_limits(problem.robot, problem.motion_limits):
        of = item.kind.quantity
        if of == "u" and problem.robot.kinematic:
            of = "a"
        if of in found:
            found[of] = np.minimum(found[of], item.upper)
    return found


def _in_words(limits: Sequence[float], unit: str) -> str:
    units = (f"{unit}/s", f"{unit}/s^2", f"{unit}/s^3")
    parts = [
        f"{value:.4g} {of}"
        for value, of in zip(limits, units, strict=True)
        if math.isfinite(value)
    ]
    return f"at {', '.join(parts)} at most" if parts else "without a limit"


def joint_bounds(
    joints: Sequence[Joint], lower: Array, upper: Array, ends: Array
) -> list[LowerBound]:
    """Bounds for ranges that joints have to end within.

    Args:
        joints: The joints.
        lower: Least displacement of each joint, with its sign, shape (n,).
        upper: Largest displacement of each joint, shape (n,).
        ends: Velocities at the start and at the end, shape (2, n); infinite for any.
    """
    found = []
    each = zip(joints, *(x.tolist() for x in (lower, upper, *ends)), strict=True)
    for joint, least, most, v0, v1 in each:
        way = max(least, 0.0) + min(most, 0.0)
        if least == most and math.isfinite(v0) and math.isfinite(v1):
            T = joint.drive.least_time_between(way, (v0, v1))
        elif way != 0.0:
            T = joint.drive.least_time(way, (v0, v1))
        else:
            continue
        # An infinite time would say that no motion exists, which is not proved.
        T = T if math.isfinite(T) else 0.0
        reason = f"joint {joint.name} has {abs(way):.4g} {joint.unit} to go"
        found.append(LowerBound(T, f"{reason}, {joint.limits}", joint.name))
    return found


def reach_of(joints: Sequence[Joint], ends: Array) -> Callable[[float], Array]:
    """Largest displacement of each joint in a time, shape (n,).

    Args:
        joints: The joints.
        ends: Velocities at the start and at the end, shape (2, n); infinite for any.
    """
    each = [*zip(joints, *np.abs(ends).tolist(), strict=True)]
    return lambda T: np.array([one.drive.farthest(T, (v, w)) for one, v, w in each])


# -- arms with one joint ---------------------------------------------------------------


def _torque_drive(
    problem: Problem, tightest: dict[str, Array], smooth_ends: bool
) -> Drive | None:
    """Limits of acceleration by the torques of an arm with one joint; else None.

    Args:
        problem: The problem.
        tightest: The tightest limits of its joints.
        smooth_ends: Whether accelerations that may not jump are zero at both ends.
    """
    robot = problem.robot
    if robot.n != 1 or robot.expansion_matrix is not None or robot.kinematic:
        return None
    effort = np.concatenate(effort_bounds(problem))
    if not np.all(np.isfinite(effort)):
        return None
    top, acceleration, jerk, rate = (float(most[0]) for most in tightest.values())
    mass, mean, wave = _inertia_and_weight(robot)

    def law(sign: float, torque: float) -> SpeedLaw:
        """Largest acceleration one way, over the speed that way."""
        limit = SpeedLaw.line(torque)
        for _, curve in effort_curves(problem):
            limit = limit.lower_of(_over_speed(curve.speed, curve.effort))
        dry, viscous = float(robot.friction[0]), float(robot.damping[0])
        against = np.array([dry, -dry]) + wave - sign * mean
        load = SpeedLaw(np.zeros(1), against, np.full(2, -viscous))
        total = limit.plus(load)
        total = SpeedLaw(total.knots, total.level / mass, total.slope / mass)
        if math.isfinite(acceleration):
            total = total.lower_of(SpeedLaw.line(acceleration))
        return total

    def smooth(item: SpeedLaw) -> Change:
        """The changes of speed within limits of jerk and torque rate, too."""
        most = item.highest(top)
        # Friction and gravity change the torque beside its rate.
        changes = ((float(robot.damping[0]), most), (wave, top))
        beside = sum(factor * by for factor, by in changes if factor > 0.0)
        fastest = min(jerk, (rate + beside) / mass)
        return Both(item, Ramp(most, fastest)) if smooth_ends else item

    ahead, back = law(1.0, float(effort[1])), law(-1.0, -float(effort[0]))
    return Drive(
        (smooth(ahead), smooth(back.reflected)),
        (smooth(back), smooth(ahead.reflected)),
        top,
    )


def _inertia_and_weight(robot: Robot) -> tuple[float, float, float]:
    """Inertia, mean torque of gravity, and its largest deviation from the mean."""
    dynamics = RobotDynamics(robot)
    q = np.array([[0.0], [0.5 * math.pi], [math.pi]])
    rest = np.zeros_like(q)
    mass = float(dynamics.inertial(q[:1], np.ones((1, 1)))[0, 0])
    first, middle, last = dynamics.inverse(q, rest, rest)[:, 0].tolist()
    if prismatic_joints(robot)[0]:
        return mass, first, 0.0
    mean = 0.5 * (first + last)
    return mass, mean, math.hypot(first - mean, middle - mean)


def _over_speed(speed: Array, effort: Array) -> SpeedLaw:
    """Torque over the absolute speed, constant beyond the last speed."""
    slope = np.append(np.diff(effort) / np.diff(speed), 0.0)
    one = SpeedLaw(speed[1:], effort - slope * speed, slope)
    other = one.reflected
    return SpeedLaw(
        np.concatenate([other.knots, [0.0], one.knots]),
        np.concatenate([other.level, one.level]),
        np.concatenate([other.slope, one.slope]),
    )
