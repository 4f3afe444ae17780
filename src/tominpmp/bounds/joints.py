"""Lower bounds from the motion of each joint alone.

An arm with one joint is also bounded by its torques. Its inertia is constant, so that
torque, friction and gravity bound the acceleration at each speed. Where gravity does
not depend on the position, as on a rail, speeding up to a peak and slowing down is the
fastest motion. The gravity of a pendulum is assumed to act in either direction with its
largest torque.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.bounds.energy import effort_bounds, effort_curves
from tominpmp.bounds.least_time import Drive, Ramp, SpeedLaw
from tominpmp.bounds.result import LowerBound
from tominpmp.dynamics import RobotDynamics
from tominpmp.goals.turns import TURN
from tominpmp.kinematics import prismatic_joints, units_of
from tominpmp.problem.joint_limits import joint_limits
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot

# Quantities whose largest values bound the motion of a single joint: speeds,
# accelerations, jerks and torque rates, in the letters of kinds of limits.
BOUNDED = ("v", "a", "j", "du")


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint and the limits of its motion.

    Attributes:
        name: Name of the joint.
        drive: Limits of its speed and acceleration.
        limits: The limits in words.
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
    tightest, joints, robot = tightest_limits(problem), [], problem.robot
    units = zip(robot.joint_names, units_of(robot), strict=True)
    for i, (name, unit) in enumerate(units):
        top, acceleration, jerk, _ = (float(most[i]) for most in tightest.values())
        ramp = Ramp(acceleration, jerk if smooth_ends else math.inf)
        limits = _in_words((top, ramp.acceleration, ramp.jerk), unit)
        joints.append(Joint(name, Drive((ramp, ramp), (ramp, ramp), top), limits, unit))
    by_torque = _torque_drive(problem, tightest, smooth_ends)
    if by_torque is None:
        return joints
    # The drive of an arm with one joint includes all limits.
    limits = "and no torque moves it there sooner"
    return [replace(joints[0], drive=by_torque, limits=limits)]


def tightest_limits(problem: Problem) -> dict[str, Array]:
    """The tightest limits of all joints by bounded quantity, see :data:`BOUNDED`.

    Shape (n,) each; infinite for joints without a limit.
    """
    tightest = {key: np.full(problem.robot.n, math.inf) for key in BOUNDED}
    for item in joint_limits(problem.robot, problem.motion_limits):
        key = item.kind.quantity
        if key == "u" and problem.robot.kinematic:
            key = "a"
        if key in tightest:
            tightest[key] = np.minimum(tightest[key], item.upper)
    return tightest


def _in_words(limits: Sequence[float], unit: str) -> str:
    """Limits of speed, acceleration and jerk in words."""
    units = (f"{unit}/s", f"{unit}/s^2", f"{unit}/s^3")
    finite = [
        f"{value:.4g} {per}"
        for value, per in zip(limits, units, strict=True)
        if math.isfinite(value)
    ]
    return f"at {', '.join(finite)} at most" if finite else "without a limit"


def joint_bounds(
    joints: Sequence[Joint],
    lower: Array,
    upper: Array,
    ends: Array,
    turning: BoolArray,
) -> list[LowerBound]:
    """Bounds for ranges within which joints have to end.

    Args:
        joints: The joints.
        lower: Least displacement of each joint, with its sign, shape (n,).
        upper: Largest displacement of each joint, with its sign, shape (n,).
        ends: Velocities at the start and at the end, shape (2, n); infinite where a
            velocity is free.
        turning: Joints that may end any number of turns away, shape (n,).
    """
    bounds = []
    ranges = zip(lower.tolist(), upper.tolist(), strict=True)
    pairs = zip(*ends.tolist(), strict=True)
    each = zip(joints, ranges, pairs, turning.tolist(), strict=True)
    for joint, (least, most), velocities, turns_on in each:
        T, way = _least(joint, least, most, velocities)
        for side in (TURN, -TURN) if turns_on else ():
            turns, step = 0, 1
            while step:
                further = (turns + step) * side
                other = _least(joint, least + further, most + further, velocities)
                # Beyond its braking distance, a joint only takes longer.
                if other[0] < T:
                    (T, way), turns, step = other, turns + step, 2 * step
                else:
                    step //= 2
        reason = f"joint {joint.name} has {abs(way):.4g} {joint.unit} to go"
        if velocities[0] and math.isfinite(velocities[0]):
            reason += f" from {velocities[0]:.4g} {joint.unit}/s"
        bounds.append(LowerBound(T, f"{reason}, {joint.limits}", joint.name))
    return bounds


def _least(
    joint: Joint, least: float, most: float, ends: tuple[float, float]
) -> tuple[float, float]:
    """Least time for a range of displacements [s], and the displacement."""
    way = max(least, 0.0) + min(most, 0.0)
    if least == most and math.isfinite(ends[0]) and math.isfinite(ends[1]):
        T = joint.drive.least_time_between(way, ends)
    else:
        T = joint.drive.least_time(way, ends) if way != 0.0 else 0.0
        # Wherever the joint ends, its velocity has to change.
        T = max(T, joint.drive.least_change(ends))
    # An infinite time would claim that no motion exists, which is not proved.
    return T if math.isfinite(T) else 0.0, way


def reach_of(joints: Sequence[Joint], ends: Array) -> Callable[[float], Array]:
    """Function from a time to the largest displacement of each joint, shape (n,).

    Args:
        joints: The joints.
        ends: Velocities at the start and at the end, shape (2, n); infinite where a
            velocity is free.
    """
    each = [*zip(joints, *np.abs(ends).tolist(), strict=True)]
    return lambda T: np.array([item.drive.farthest(T, (v, w)) for item, v, w in each])


# -- arms with one joint ---------------------------------------------------------------


def _torque_drive(
    problem: Problem, tightest: dict[str, Array], smooth_ends: bool
) -> Drive | None:
    """Acceleration limits of an arm with one joint by its torques; None for other arms.

    Args:
        problem: The problem.
        tightest: The tightest limits of the joints.
        smooth_ends: Whether accelerations that may not jump are zero at both ends.
    """
    robot = problem.robot
    if robot.n != 1 or robot.expansion_matrix is not None or robot.kinematic:
        return None
    weakest, strongest = effort_bounds(problem)
    top, acceleration, jerk, rate = (float(most[0]) for most in tightest.values())
    mass, mean, wave = _inertia_and_weight(robot)
    dry, viscous = float(robot.friction[0]), float(robot.damping[0])
    curves = [curve for _, curve in effort_curves(problem)]
    speeds = np.concatenate([[0.0], *(curve.speed for curve in curves)])
    bends = np.unique([-speeds, speeds])

    def law(sign: float, torque: float) -> SpeedLaw:
        """Largest acceleration in one direction, over the speed in that direction."""

        def limits(v: Array) -> Array:
            motors = [np.full(v.shape, torque), *(curve(v)[0] for curve in curves)]
            load = sign * mean - wave + dry * np.sign(v) + viscous * v
            allowed = [*(np.array(motors) - load) / mass]
            if math.isfinite(acceleration):
                allowed.append(np.full(v.shape, acceleration))
            return np.array(allowed)

        return SpeedLaw.least_of(limits, bends)

    def smooth(item: SpeedLaw) -> SpeedLaw:
        """Changes of speed that also obey the limits of jerk and torque rate.

        These limits count from zero acceleration, at smooth ends only.
        """
        most = item.highest(top)
        # The torque of friction and gravity changes in addition to the motor torque.
        changes = ((viscous, most), (wave, top))
        load_rate = sum(factor * by for factor, by in changes if factor > 0.0)
        fastest = min(jerk, (rate + load_rate) / mass)
        return replace(item, ramp=Ramp(most, fastest)) if smooth_ends else item

    ahead, back = law(1.0, float(strongest[0])), law(-1.0, -float(weakest[0]))
    return Drive(
        (smooth(ahead), smooth(back.reflected)),
        (smooth(back), smooth(ahead.reflected)),
        top,
    )


def _inertia_and_weight(robot: Robot) -> tuple[float, float, float]:
    """Inertia, mean gravity torque, and largest deviation of gravity from its mean."""
    dynamics = RobotDynamics(robot)
    q = np.array([[0.0], [0.5 * math.pi], [math.pi]])
    rest = np.zeros_like(q)
    mass = float(dynamics.inertial(q[:1], np.ones((1, 1)))[0, 0])
    first, middle, last = dynamics.inverse(q, rest, rest)[:, 0].tolist()
    if prismatic_joints(robot)[0]:
        return mass, first, 0.0
    mean = 0.5 * (first + last)
    return mass, mean, math.hypot(first - mean, middle - mean)
