"""Joint limits of positions, velocities, accelerations and jerks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, IntArray, Record
from tominpmp.constraints.base import USABLE, LimitOfJoints, Partials, States
from tominpmp.motion_limits import ACCELERATION

# Zero acceleration at the end is not a limit of the user, so it has no quantity.
AT_END = replace(ACCELERATION, name="acceleration at the end", quantity="")


@dataclass(frozen=True, eq=False)
class JointLimit(Record, LimitOfJoints):
    """Bounds on a derivative of the positions of some joints.

    Jerks (order 3) are differences of accelerations between pairs of instants, over
    time.

    Attributes:
        lower: Lower bounds, shape (k,).
        upper: Upper bounds, shape (k,).
        scale: Scale of the values, shape (k,).
    """

    lower: Array
    upper: Array
    scale: Array

    def __post_init__(self) -> None:
        """Set field and order by the kind of limit."""
        super().__post_init__()
        self._keep(field=self.kind.quantity, order=self.kind.order)

    @classmethod
    def at_end(cls, scale: Array) -> JointLimit:
        """Zero acceleration at the end of an arm whose accelerations must not jump.

        Args:
            scale: Scale of the accelerations, shape (n,).
        """
        zero = np.zeros(scale.size)
        return cls(AT_END, np.arange(scale.size), zero, zero, scale)

    @property
    def usable(self) -> Array | None:
        """Tolerated excess between rows: positions and velocities are continuous.

        Accelerations have rows at both ends of the intervals.
        """
        return np.full(self.count, USABLE) if self.order < 2 else None

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Bounds, divided by the scale."""
        shape = instants // 2 if self.order > 2 else instants, self.count
        lower = np.broadcast_to(self.lower / self.scale, shape)
        return lower, np.broadcast_to(self.upper / self.scale, shape)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Values of the derivative, divided by the scale."""
        if self.order > 2:
            steps = states.a[1::2, self.of_joints] - states.a[::2, self.of_joints]
            return np.asarray(steps / np.diff(states.t)[::2, None] / self.scale)
        values = (states.q, states.v, states.a)[self.order]
        return np.asarray(values[:, self.of_joints] / self.scale)

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Unit vectors, divided by the scale; for jerks, at both instants of a pair."""
        place, column = at, which
        if self.order > 2:
            place, column = Partials.both_instants(at), np.tile(which, 2)
        rows = np.eye(states.q.shape[1])[self.of_joints[column]]
        by = rows / self.scale[column, None]
        by_q, by_v, by_a = (by if k == min(self.order, 2) else None for k in range(3))
        found = Partials(place, by_q, by_v, by_a)
        if self.order <= 2:
            return found
        return found.slopes(states.t, at, self.evaluate(states)[at, which])
