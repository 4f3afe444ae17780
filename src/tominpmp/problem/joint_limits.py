"""Joint limits, one record for each kind: of the robot, and of its motion limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.motion_limits import POSITION, VELOCITY, LimitKind, MotionLimits, kinds_of
from tominpmp.problem.controls import control_bounds, control_kind, effort_range

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem


@dataclass(frozen=True, eq=False)
class JointBounds:
    """Bounds that one kind of limit sets on the joints of a robot.

    Attributes:
        kind: The kind of limit.
        lower: Lower bounds, -inf for joints without a bound, shape (n,).
        upper: Upper bounds, inf for joints without a bound, shape (n,).
        scale: Scale by which an excess over the bounds is divided, shape (n,).
        by_speed: Bounds that depend on the joint speed, by the index of the joint.
    """

    kind: LimitKind
    lower: Array
    upper: Array
    scale: Array
    by_speed: Mapping[int, Any] = field(default_factory=dict)

    @property
    def joints(self) -> IntArray:
        """Indices of the joints that have a bound, shape (k,)."""
        if self.by_speed:
            return np.array(list(self.by_speed))
        return np.flatnonzero(np.isfinite(self.lower) | np.isfinite(self.upper))

    def beyond(self, q: Array, v: Array, a: Array, u: Array) -> Array:
        """Excess of sampled states and torques over the bounds, shape (m, n)."""
        if self.kind.quantity == "uv":
            out = np.full(u.shape, -np.inf)
            for i, bound in self.by_speed.items():
                out[:, i] = self.kind.largest_excess(bound, u[:, i], v[:, i])
            return out
        return self.outside({"q": q, "v": v, "a": a, "u": u}[self.kind.quantity])

    def outside(self, values: Array) -> Array:
        """Excess of values over the nearer bound, negative inside, shape (..., n)."""
        return np.asarray(np.maximum(values - self.upper, self.lower - values))


def joint_limits(problem: Problem) -> list[JointBounds]:
    """Joint limits of a problem: position, velocity and control limits come first."""
    robot, limits = problem.robot, problem.motion_limits
    own, declared, names = robot.limits, limits or MotionLimits(), robot.joint_names
    low, high, top = own.position_lower, own.position_upper, own.velocity
    middle, half = effort_range(robot, limits)
    control = control_kind(robot)
    weakest, strongest = control_bounds(robot, limits)
    span = 0.5 * (strongest - weakest)
    # The torque range of a joint without a motor is zero, and cannot scale an excess.
    span = np.where(span > 0.0, span, np.max(span, initial=1e-12))
    bounds = [
        JointBounds(POSITION, low, high, high - low),
        JointBounds(VELOCITY, -top, top, top),
        JointBounds(control, middle - half, middle + half, span),
    ]
    unbounded = np.full(top.size, np.inf)
    for name, kind in kinds_of(declared).items():
        if kind.name == control.name:
            continue
        if kind.quantity == "uv":
            curves = sorted(declared._bounds_of(name, names).items())
            by_speed = {names.index(k): curve for k, curve in curves if curve != np.inf}
            scale = span.copy()
            scale[[*by_speed]] = [kind.scale(b, span[i]) for i, b in by_speed.items()]
            item = JointBounds(kind, -unbounded, unbounded, scale, by_speed)
        else:
            most = declared.by_joint(name, names)
            item = JointBounds(kind, -most, most, most)
        if item.joints.size:
            bounds.append(item)
    return bounds
