"""How soon joints can be where a goal wants them, each by itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.least_time import Drive, Ramp
from tominpmp.bounds.one_joint import torque_drive
from tominpmp.bounds.result import LowerBound
from tominpmp.kinematics import prismatic_joints
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem import Problem


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint and what bounds its motion.

    Attributes:
        name: Its name.
        drive: Its speed limit, and what bounds its acceleration.
        limits: What that is, in words.
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
    robot, more = problem.robot, problem.motion_limits or MotionLimits()
    names = robot.joint_names
    acceleration = more.by_joint("acceleration", names)
    jerk = (more if smooth_ends else MotionLimits()).by_joint("jerk", names)
    slides, found = prismatic_joints(robot), []
    for i, name in enumerate(names):
        unit = "m" if slides[i] else "rad"
        ramp = Ramp(float(acceleration[i]), float(jerk[i]))
        top = float(robot.limits.velocity[i])
        limits = _in_words((top, ramp.acceleration, ramp.jerk), unit)
        found.append(Joint(name, Drive((ramp, ramp), (ramp, ramp), top), limits, unit))
    by_torque = torque_drive(problem, smooth_ends)
    if by_torque is None:
        return found
    # Of an arm with one joint it has all limits in it.
    return [
        replace(found[0], drive=by_torque, limits="and no torque moves it there sooner")
    ]


def _in_words(limits: Sequence[float], unit: str) -> str:
    units = (f"{unit}/s", f"{unit}/s^2", f"{unit}/s^3")
    parts = [
        f"{value:.4g} {of}"
        for value, of in zip(limits, units, strict=True)
        if math.isfinite(value)
    ]
    return f"at {', '.join(parts)} at most" if parts else "without a limit"


def joint_bounds(
    joints: Sequence[Joint],
    lower: Array,
    upper: Array,
    start: Array | None,
    end: Array | None,
) -> list[LowerBound]:
    """Bounds for ranges that joints have to end within.

    Args:
        joints: The joints.
        lower: How far each has to go at the least, with its sign, shape (n,).
        upper: How far it has to go at most, shape (n,).
        start: Velocities at the start, shape (n,); None if they may be any.
        end: Velocities at the end, shape (n,); None if they may be any.
    """
    found = []
    any_speed = np.full(len(joints), math.inf)
    v0, v1 = (any_speed if v is None else v for v in (start, end))
    known = start is not None and end is not None
    each = zip(joints, *(x.tolist() for x in (lower, upper, v0, v1)), strict=True)
    for joint, least, most, *ends in each:
        way = max(least, 0.0) + min(most, 0.0)
        if known and least == most:
            T = joint.drive.least_time_between(way, (ends[0], ends[1]))
        elif way != 0.0:
            T = joint.drive.least_time(way, (ends[0], ends[1]))
        else:
            continue
        # No bound where there seems to be no motion.
        T = T if math.isfinite(T) else 0.0
        reason = f"joint {joint.name} has {abs(way):.4g} {joint.unit} to go"
        found.append(LowerBound(T, f"{reason}, {joint.limits}", joint.name))
    return found


def reach_of(
    joints: Sequence[Joint], start: Array | None, end: Array | None
) -> Callable[[float], Array]:
    """How far each joint gets in a time at most, whatever moves it: shape (n,).

    Args:
        joints: The joints.
        start: Velocities at the start, shape (n,); None if they may be any.
        end: Velocities at the end, shape (n,); None if they may be any.
    """
    any_speed = np.full(len(joints), math.inf)
    v0, v1 = (any_speed if v is None else np.abs(v) for v in (start, end))
    each = [*zip(joints, v0.tolist(), v1.tolist(), strict=True)]
    return lambda T: np.array([one.drive.farthest(T, (v, w)) for one, v, w in each])
