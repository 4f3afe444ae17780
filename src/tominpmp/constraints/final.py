"""Constraints at the end of a segment: its goal, and its arrival time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import Constraint, Partials, States
from tominpmp.goals import Goal
from tominpmp.kinematics import RobotKinematics


@dataclass(frozen=True, eq=False)
class GoalReached(Constraint):
    """The residual of a goal within its bounds: a(x(1)) = 0 (paper, equation 5).

    Attributes:
        goal: The goal.
        kinematics: Kinematics of the robot.
        scale: Scale of the residual, shape (p,).
    """

    goal: Goal
    kinematics: RobotKinematics
    scale: Array

    name = "goal"
    order = 1

    @property
    def count(self) -> int:
        """Number of values of the residual."""
        return int(self.scale.size)

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Bounds of the residual."""
        lower, upper = self.goal.bounds(self.kinematics)
        shape = instants, self.count
        lower = np.broadcast_to(lower / self.scale, shape)
        return lower, np.broadcast_to(upper / self.scale, shape)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """The residual."""
        rows = [
            self.goal.residual(self.kinematics, q, v).value / self.scale
            for q, v in zip(states.q, states.v, strict=True)
        ]
        return np.stack(rows)

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives of the residual by the final configuration and velocity."""
        by_q = np.zeros((at.size, states.q.shape[1]))
        by_v = np.zeros_like(by_q)
        for k in np.unique(at).tolist():
            mine = np.flatnonzero(at == k)
            q, v = states.q[k], states.v[k]
            _, whole_q, whole_v = self.goal.residual(self.kinematics, q, v)
            by_q[mine] = whole_q[which[mine]] / self.scale[which[mine], None]
            by_v[mine] = whole_v[which[mine]] / self.scale[which[mine], None]
        return Partials(at, by_q, by_v)


@dataclass(frozen=True, eq=False)
class Arrival(Constraint):
    """The time at the end of a segment, before its dwell, within bounds.

    Attributes:
        earliest: Earliest time [s].
        latest: Latest time [s]; infinity for no bound.
    """

    earliest: float
    latest: float

    name = "arrival"

    @property
    def count(self) -> int:
        """Number of values: one."""
        return 1

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Bounds of the time [s]."""
        shape = instants, 1
        return np.full(shape, self.earliest), np.full(shape, self.latest)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """The times [s], shape (m, 1)."""
        return states.t[:, None]

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives by time, which are 1."""
        return Partials(at, by_t=np.ones(at.size))
