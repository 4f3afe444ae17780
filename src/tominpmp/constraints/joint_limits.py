"""Limits of positions and of their derivatives, joint by joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, IntArray, Record
from tominpmp.constraints.base import (
    Constraint,
    Partials,
    States,
    both_instants,
    slope_partials,
)


@dataclass(frozen=True, eq=False)
class JointLimit(Record, Constraint):
    """Bounds of a derivative of some joints' positions.

    Attributes:
        joints: The joints with bounds, shape (k,).
        lower: Lower bounds, shape (k,).
        upper: Upper bounds, shape (k,).
        scale: Scale of the values, shape (k,).
        joint_count: Number n of all joints.
        name: Name of the kind of limit.
        field: "q", "v", "a" or "j", for the derivative.
        order: Order of the derivative. Slopes of accelerations, of order 3, are taken
            between pairs of instants.
        curable: Whether a slower motion along the same path violates it less.
    """

    joints: IntArray
    lower: Array
    upper: Array
    scale: Array
    joint_count: int
    name: str = ""
    field: str = ""
    order: int = 0
    curable: bool = False

    @classmethod
    def standstill(cls, scale: Array) -> JointLimit:
        """Zero acceleration at a dwell of an arm whose accelerations must not jump.

        Args:
            scale: Scale of the accelerations, shape (n,).
        """
        none, name = np.zeros(scale.size), "acceleration before a stay"
        every = np.arange(scale.size)
        return cls(every, none, none, scale, scale.size, name, order=2)

    @property
    def kind_name(self) -> str:
        """Name of the kind of limit."""
        return self.name

    @property
    def of_joints(self) -> IntArray:
        """The joint of each value."""
        return self.joints

    @property
    def count(self) -> int:
        """One value for each joint that has a limit."""
        return int(self.joints.size)

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Bounds in units of the scale."""
        shape = instants // 2 if self.order > 2 else instants, self.count
        lower = np.broadcast_to(self.lower / self.scale, shape)
        return lower, np.broadcast_to(self.upper / self.scale, shape)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """The derivative over its scale."""
        if self.order > 2:
            steps = states.a[1::2, self.joints] - states.a[::2, self.joints]
            return np.asarray(steps / np.diff(states.t)[::2, None] / self.scale)
        values = (states.q, states.v, states.a)[self.order]
        return np.asarray(values[:, self.joints] / self.scale)

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Unit vectors over the scale."""
        slopes = self.order > 2
        place, column = (
            (both_instants(at), np.tile(which, 2)) if slopes else (at, which)
        )
        by = np.zeros((place.size, self.joint_count))
        by[np.arange(place.size), self.joints[column]] = 1.0 / self.scale[column]
        by_q, by_v, by_a = (by if k == min(self.order, 2) else None for k in range(3))
        found = Partials(place, by_q, by_v, by_a)
        if not slopes:
            return found
        return slope_partials(found, states.t, at, self.evaluate(states)[at, which])
