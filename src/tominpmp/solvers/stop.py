"""When an iteration ends: rules that are asked after each step, and go together."""

from __future__ import annotations

from dataclasses import dataclass

from tominpmp.solvers.iterate import SMALLEST_RADIUS
from tominpmp.solvers.loop import Loop, Rule
from tominpmp.status import Status


def first_of(*rules: Rule) -> Rule:
    """All rules together: the first of them that ends an iteration says how."""

    def rule(loop: Loop) -> Status | None:
        found = (one(loop) for one in rules)
        return next((status for status in found if status is not None), None)

    return rule


def settled(loop: Loop) -> Status | None:
    """No more progress is to be had, and slowing down removes what is violated."""
    outcome = loop.outcome
    if outcome is None or not outcome.settled:
        return None
    restorable = loop.objective.restorable(loop.program, loop.state)
    return Status.CONVERGED if restorable else None


def exhausted(loop: Loop) -> Status | None:
    """Steps have become too small to get anywhere, or no program can be solved."""
    if loop.state.radius >= SMALLEST_RADIUS:
        return None
    return Status.NUMERICAL_FAILURE if loop.outcome is None else Status.STALLED


@dataclass(frozen=True)
class Raises:
    """Violations have stayed though their weights were raised.

    Attributes:
        most: So many raises of the weights are enough.
    """

    most: int

    def __call__(self, loop: Loop) -> Status | None:
        """INFEASIBLE once there were more."""
        return Status.INFEASIBLE if loop.state.raises > self.most else None


@dataclass(frozen=True)
class Iterations:
    """There were many iterations.

    Attributes:
        most: How many there may be, unless rows that have joined need more.
    """

    most: int

    def __call__(self, loop: Loop) -> Status | None:
        """ITERATION_LIMIT once there were as many."""
        most = max(self.most, loop.granted)
        over = loop.outcome is not None and len(loop.history) >= most
        return Status.ITERATION_LIMIT if over else None
