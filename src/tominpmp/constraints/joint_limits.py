"""Limits joint by joint: positions, velocities, accelerations, jerks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import Constraint, Partials, States


@dataclass(frozen=True, eq=False)
class JointLimit(Constraint):
    """Bounds of a derivative of some joints' positions.

    Attributes:
        joints: The joints that have one, shape (k,).
        lower: Lower bounds, shape (k,).
        upper: Upper bounds, shape (k,).
        scale: What values are divided by, shape (k,).
        joint_count: Number n of all joints.
    """

    joints: IntArray
    lower: Array
    upper: Array
    scale: Array
    joint_count: int

    @classmethod
    def symmetric(cls, limit: Array) -> JointLimit | None:
        """Limits of either direction, infinite for none, shape (n,); None if all are.

        Values are shares of the limits.
        """
        joints = np.flatnonzero(np.isfinite(limit))
        if not joints.size:
            return None
        most = limit[joints]
        return cls(joints, -most, most, most, limit.size)

    @property
    def count(self) -> int:
        """One value for each joint that has a limit."""
        return int(self.joints.size)

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Bounds in units of the scale."""
        shape = instants, self.count
        lower = np.broadcast_to(self.lower / self.scale, shape)
        return lower, np.broadcast_to(self.upper / self.scale, shape)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """The derivative over its scale."""
        values = (states.q, states.v, states.a)[self.order]
        return np.asarray(values[:, self.joints] / self.scale)

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Unit vectors over the scale."""
        by = np.zeros((at.size, self.joint_count))
        by[np.arange(at.size), self.joints[which]] = 1.0 / self.scale[which]
        by_q, by_v, by_a = (by if k == self.order else None for k in range(3))
        return Partials(at, by_q, by_v, by_a)


class PositionLimit(JointLimit):
    """Position limits of a robot description."""

    name = "position"
    field = "q"

    @classmethod
    def between(cls, lower: Array, upper: Array, scale: Array) -> PositionLimit | None:
        """Limits of all joints, infinite for none, shape (n,) each; None if all are."""
        joints = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
        if not joints.size:
            return None
        return cls(joints, lower[joints], upper[joints], scale[joints], lower.size)


class VelocityLimit(JointLimit):
    """Velocity limits."""

    name = "velocity"
    field = "v"
    order = 1
    curable = True


class AccelerationLimit(JointLimit):
    """Acceleration limits."""

    name = "acceleration"
    field = "a"
    order = 2
    curable = True


class JerkLimit(JointLimit):
    """Jerk limits, for motions whose accelerations do not jump."""

    name = "jerk"
    field = "j"
    order = 3
    curable = True
