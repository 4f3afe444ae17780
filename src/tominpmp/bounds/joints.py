"""How soon joints can be where a goal wants them, each by itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.least_time import Drive, Ramp
from tominpmp.bounds.one_joint import torque_drive
from tominpmp.bounds.result import LowerBound
from tominpmp.kinematics import prismatic_joints
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

    def bound(self, T: float, way: float) -> LowerBound:
        """What it needs for a way; no bound where there seems to be no motion."""
        reason = (
            f"joint {self.name} has {abs(way):.4g} {self.unit} to go, {self.limits}"
        )
        return LowerBound(T if math.isfinite(T) else 0.0, reason, self.name)


def joints_of(problem: Problem, smooth_ends: bool) -> list[Joint]:
    """The joints of a problem.

    Args:
        problem: The problem.
        smooth_ends: Whether accelerations that may not jump are zero at both ends.
    """
    robot, more = problem.robot, problem.motion_limits
    names, n = robot.joint_names, robot.n
    acceleration, jerk = np.full(n, np.inf), np.full(n, np.inf)
    if more is not None:
        acceleration = more.by_joint("acceleration", names)
        if smooth_ends:
            jerk = more.by_joint("jerk", names)
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
    for i, joint in enumerate(joints):
        way = max(float(lower[i]), 0.0) + min(float(upper[i]), 0.0)
        side = 1.0 if way >= 0.0 else -1.0
        v = [math.inf if at is None else side * float(at[i]) for at in (start, end)]
        if lower[i] == upper[i] and start is not None and end is not None:
            T = joint.drive.least_time_between(way, (float(start[i]), float(end[i])))
        elif way != 0.0:
            T = joint.drive.least_time(way, (v[0], v[1]))
        else:
            continue
        found.append(joint.bound(T, way))
    return found


@dataclass(frozen=True, eq=False)
class JointReach:
    """How far each joint gets in a time, whatever moves it.

    Attributes:
        joints: The joints.
        start: Largest speeds at the start, shape (n,), possibly infinite.
        end: Largest speeds at the end, shape (n,), possibly infinite.
    """

    joints: Sequence[Joint]
    start: Array
    end: Array

    def __call__(self, T: float) -> Array:
        """Farthest that each joint gets in a time, shape (n,)."""
        ends = zip(self.joints, self.start.tolist(), self.end.tolist(), strict=True)
        return np.array([joint.drive.farthest(T, (v, w)) for joint, v, w in ends])
