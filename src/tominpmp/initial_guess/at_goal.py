"""What is asked of the configuration in which a motion ends, with its derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints import ClearanceConstraint
from tominpmp.constraints.path import PathConstraint
from tominpmp.goals import Goal, Scales
from tominpmp.transcription.problem_functions import ProblemFunctions

# How far beyond what is asked for bodies are led apart [m].
BEYOND = 1e-3


class AtGoal:
    """What is asked of the configuration in which a segment ends.

    Attributes:
        scales: What counts as 1 rad, of joints and of errors.

    Args:
        system: Kinematics and limits.
        goal: The goal.
        alone: Whether nothing but the goal is asked for.
        beyond: Constraints on positions that hold from there on.
        apart: Whether bodies are to keep their distances, too.
    """

    def __init__(
        self,
        system: ProblemFunctions,
        goal: Goal,
        *,
        alone: bool = False,
        beyond: Sequence[PathConstraint] = (),
        apart: bool = False,
    ) -> None:
        self.system, self.goal = system, goal
        place = goal.place(system.kinematics, system.problem.q_start)
        self.scales = Scales.of(system.kinematics, place)
        self.clearance = system.clearance if apart else None
        rests = goal.fixes_velocity and not np.any(goal.final_velocity(system.n))
        self.constraints = tuple(
            item
            for item in (*system.problem.ready_constraints, *beyond)
            if not alone
            and (item.order == 0 or rests)
            and (item.window is None or np.isinf(item.window.end))
        )

    def residual(self, q: Array) -> tuple[Array, Array]:
        """How far a configuration is from all of it, and the Jacobian of that.

        Returns:
            Shapes (k,) and (k, n), with lengths of the goal in units of their scale;
            zero where it is met.
        """
        place = self.goal.place(self.system.kinematics, q)
        value, by_q = place.residual()
        share = np.where(place.lengths, 1.0 / self.scales.lengths, 1.0)
        every = [(share * value, share[:, None] * by_q)]
        every += [item.excess_at_rest(q) for item in self.constraints]
        if self.clearance is not None:
            every.append(self._overlap(self.clearance, q))
        values, slopes = zip(*every, strict=True)
        return np.concatenate(values), np.concatenate(slopes)

    def missing(self, q: Array) -> float:
        """How far a configuration is from all of it, as a norm [m, rad]."""
        value, _ = self.residual(q)
        place = self.goal.place(self.system.kinematics, q)
        value[: place.value.size] = place.excess
        return float(np.linalg.norm(value))

    def _overlap(self, clearance: ClearanceConstraint, q: Array) -> tuple[Array, Array]:
        """What bodies lack of their distances [m], of those that lack anything."""
        lack = clearance.length * clearance.values(q[None])[0] + BEYOND
        near = np.flatnonzero(lack > 0.0)
        first = np.zeros(near.size, dtype=np.int64)
        found = clearance.derivatives_at(q[None], first, near)
        return lack[near], clearance.length * found.gradients
