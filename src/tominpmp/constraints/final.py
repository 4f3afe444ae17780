"""Constraints at the end of a segment: its goal, and its arrival time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import Constraint, Partials, States
from tominpmp.goals.base import Goal
from tominpmp.goals.place import GoalResidual
from tominpmp.kinematics import RobotKinematics


@dataclass(frozen=True, eq=False)
class GoalReached(Constraint):
    """Residual of a goal within its bounds: a(x(1)) = 0 (paper, equation 5).

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
        """Number of components of the residual."""
        return int(self.scale.size)

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Bounds of the residual, divided by its scale."""
        lower, upper = self.goal.bounds(self.kinematics)
        shape = instants, self.count
        lower = np.broadcast_to(lower / self.scale, shape)
        return lower, np.broadcast_to(upper / self.scale, shape)

    def _residuals(self, states: States) -> GoalResidual:
        """Residuals of m states, (m, p), and their derivatives, (m, p, n)."""
        each = zip(states.q, states.v, strict=True)
        found = [self.goal.residual(self.kinematics, *state) for state in each]
        return GoalResidual(*map(np.stack, zip(*found, strict=True)))

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """The residual, divided by its scale."""
        return self._residuals(states).value / self.scale

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives of the residual by the final configuration and velocity."""
        _, *slopes = self._residuals(states)
        by_q, by_v = (by[at, which] / self.scale[which, None] for by in slopes)
        return Partials(at, by_q, by_v)


@dataclass(frozen=True, eq=False)
class Arrival(Constraint):
    """Bounds on the arrival time at the end of a segment, before its dwell.

    Attributes:
        earliest: Earliest time [s].
        latest: Latest time [s]; infinity for no bound.
    """

    earliest: float
    latest: float

    name = "arrival"
    count = 1

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Bounds of the time [s]."""
        shape = instants, 1
        return np.full(shape, self.earliest), np.full(shape, self.latest)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """The times [s], shape (m, 1)."""
        return states.t[:, None]

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives by time, which are all 1."""
        return Partials(at, by_t=np.ones(at.size))
