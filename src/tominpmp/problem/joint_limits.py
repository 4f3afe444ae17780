"""Limits of single joints, kind by kind: of the robot, and those given beyond them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.motion_limits import POSITION, VELOCITY, LimitKind, MotionLimits, kinds_of
from tominpmp.problem.controls import control_bounds, control_kind, effort_range

if TYPE_CHECKING:
    from tominpmp.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class JointBounds:
    """Bounds of a kind of limit on the joints of a robot.

    Attributes:
        kind: The kind.
        lower: Lower bounds, infinite where a joint has no bound, shape (n,).
        upper: Upper bounds, infinite likewise, shape (n,).
        scale: Scale of an excess, shape (n,).
        by_speed: Bounds that depend on the speed, by the index of the joint.
    """

    kind: LimitKind
    lower: Array
    upper: Array
    scale: Array
    by_speed: Mapping[int, Any] = field(default_factory=dict)

    @property
    def joints(self) -> IntArray:
        """Joints that have a bound, shape (k,)."""
        if self.by_speed:
            return np.array(list(self.by_speed))
        return np.flatnonzero(np.isfinite(self.lower) | np.isfinite(self.upper))

    def beyond(self, q: Array, v: Array, a: Array, u: Array) -> Array:
        """Excess of a motion over the bounds at instants, shape (m, n)."""
        if self.kind.quantity == "uv":
            out = np.full(u.shape, -np.inf)
            for i, bound in self.by_speed.items():
                out[:, i] = self.kind.largest_excess(bound, u[:, i], v[:, i])
            return out
        return self.outside({"q": q, "v": v, "a": a, "u": u}[self.kind.quantity])

    def outside(self, values: Array) -> Array:
        """How far values are outside the bounds, shape (..., n)."""
        return np.asarray(np.maximum(values - self.upper, self.lower - values))


def joint_limits(robot: Robot, limits: MotionLimits | None) -> list[JointBounds]:
    """Limits of the joints of a robot; positions, speeds and controls come first.

    Args:
        robot: The robot.
        limits: Limits beyond those of its description.
    """
    own, more, names = robot.limits, limits or MotionLimits(), robot.joint_names
    low, high, top = own.position_lower, own.position_upper, own.velocity
    middle, half = effort_range(robot, limits)
    driving = control_kind(robot)
    weakest, strongest = control_bounds(robot, limits)
    span = 0.5 * (strongest - weakest)
    # A joint without a motor is scaled by the strongest motor.
    span = np.where(span > 0.0, span, np.max(span, initial=1e-12))
    found = [
        JointBounds(POSITION, low, high, high - low),
        JointBounds(VELOCITY, -top, top, top),
        JointBounds(driving, middle - half, middle + half, span),
    ]
    none = np.full(top.size, np.inf)
    for name, kind in kinds_of(more).items():
        if kind.name == driving.name:
            continue
        if kind.quantity == "uv":
            bounds = sorted(more._bounds_of(name, names).items())
            by_speed = {names.index(k): bound for k, bound in bounds if bound != np.inf}
            scale = span.copy()
            scale[[*by_speed]] = [kind.scale(b, span[i]) for i, b in by_speed.items()]
            item = JointBounds(kind, -none, none, scale, by_speed)
        else:
            most = more.by_joint(name, names)
            item = JointBounds(kind, -most, most, most)
        if item.joints.size:
            found.append(item)
    return found
