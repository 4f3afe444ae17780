"""Joint limits of a problem, among them the limits of its controls.

The controls are torques, or accelerations of a kinematic robot. A kinematic robot is a
double integrator: acceleration limits bound its controls as torque limits bound those
of other robots.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.dynamics import RobotDynamics
from tominpmp.motion_limits import (
    ACCELERATION,
    CONTROL_ACCELERATION,
    EFFORT,
    POSITION,
    VELOCITY,
    LimitKind,
    MotionLimits,
    kinds_of,
)

if TYPE_CHECKING:
    from tominpmp.motion.trajectory import State
    from tominpmp.robot.robot import Robot

# Accelerations and jerks beyond this count as unlimited, and accelerations below its
# inverse as this inverse [rad/s^2, rad/s^3].
MOST = 1e9


def control_kind(robot: Robot) -> LimitKind:
    """Kind of the limits on the controls of a robot: torque or acceleration limits."""
    return CONTROL_ACCELERATION if robot.kinematic else EFFORT


def control_bounds(robot: Robot, limits: MotionLimits | None) -> tuple[Array, Array]:
    """Least and largest torques of a robot, or accelerations of a kinematic one.

    Args:
        robot: The robot.
        limits: Motion limits in addition to the limits of its description.

    Returns:
        Shape (n,) each [N m or N, rad/s^2 or m/s^2].
    """
    if not robot.kinematic:
        return robot.limits.effort_lower, robot.limits.effort_upper
    most = (limits or MotionLimits()).by_joint("acceleration", robot.joint_names)
    return -most, most


def effort_range(robot: Robot, limits: MotionLimits | None) -> tuple[Array, Array]:
    """Middle of the torque range of a robot, and half of its width.

    Torque-speed curves are not part of this range.

    Args:
        robot: The robot.
        limits: Motion limits in addition to the limits of its description, of which
            their ``effort_scale`` leaves a share.

    Returns:
        Shape (n,) each [N m or N]; accelerations for a kinematic robot [rad/s^2 or
        m/s^2].
    """
    lower, upper = control_bounds(robot, limits)
    share = 0.5 if limits is None else 0.5 * limits.effort_scale
    return share * (lower + upper), share * (upper - lower)


def accelerations_alone(robot: Robot, limits: MotionLimits | None, q: Array) -> Array:
    """Accelerations that limits allow each joint, if the other joints rest.

    Where torques limit them, these are estimates: the torque that gravity leaves, over
    the inertia at the joint.

    Args:
        robot: The robot.
        limits: Motion limits in addition to the limits of its description.
        q: Configurations, shape (k, n) [rad or m].

    Returns:
        Shape (k, n) [rad/s^2 or m/s^2].
    """
    dynamics, rest = RobotDynamics(robot), np.zeros_like(q)
    _, half = effort_range(robot, limits)
    weight = np.abs(dynamics.inverse(q, rest, rest))
    inertia = np.diagonal(dynamics.mass(q), axis1=1, axis2=2)
    spare = np.maximum(half - weight, 0.1 * half)
    most = (limits or MotionLimits()).by_joint("acceleration", robot.joint_names)
    return np.minimum(spare / np.maximum(inertia, 1e-9), most)


def durations_alone(
    robot: Robot, limits: MotionLimits | None, q: Array, change: Array
) -> Array:
    """Durations that changes of velocity take each joint, if the other joints rest.

    Args:
        robot: The robot.
        limits: Motion limits in addition to the limits of its description.
        q: Configuration, shape (n,) [rad or m].
        change: Amounts of the changes, shape (n,) [rad/s or m/s].

    Returns:
        Shape (n,) [s].
    """
    jerk = (limits or MotionLimits()).by_joint("jerk", robot.joint_names)
    jerk = np.minimum(jerk, MOST)
    alone = accelerations_alone(robot, limits, q[None])[0]
    a = np.clip(np.minimum(alone, np.sqrt(change * jerk)), 1.0 / MOST, MOST)
    return np.asarray(change / a + a / jerk)


def controls_in(robot: Robot, state: State) -> Array:
    """Controls of a robot in states of a motion: torques, or accelerations."""
    return state.a if robot.kinematic else state.u


def need_smooth(robot: Robot, limits: MotionLimits | None) -> bool:
    """Whether motion limits rule out controls that jump.

    Acceleration limits alone do not for a kinematic robot: they bound its controls.
    """
    bounded = [] if limits is None else limits._bounded
    return bool(bounded) and not (robot.kinematic and bounded == [ACCELERATION])


# -- limits of all kinds ---------------------------------------------------------------


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


def joint_limits(robot: Robot, limits: MotionLimits | None) -> list[JointBounds]:
    """Joint limits of a problem: position, velocity and control limits come first.

    Args:
        robot: The robot.
        limits: Motion limits in addition to the limits of its description.
    """
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
