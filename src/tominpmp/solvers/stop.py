"""Stop rules: when an iteration ends. They are evaluated after each step."""

from __future__ import annotations

from dataclasses import dataclass

from tominpmp.solvers.iterate import SMALLEST_RADIUS
from tominpmp.solvers.loop import Loop, Rule
from tominpmp.status import Status


def first_of(*rules: Rule) -> Rule:
    """Combine stop rules: the first rule that applies determines the status."""

    def rule(loop: Loop) -> Status | None:
        verdicts = (each(loop) for each in rules)
        return next((status for status in verdicts if status is not None), None)

    return rule


def settled(loop: Loop) -> Status | None:
    """CONVERGED if no more progress is made, and slowing down removes violations."""
    done = loop.outcome is not None and loop.outcome.settled
    return Status.CONVERGED if done else None


def exhausted(loop: Loop) -> Status | None:
    """STALLED if the trust region has collapsed; a failure if no program was solved."""
    if loop.state.radius >= SMALLEST_RADIUS:
        return None
    return Status.NUMERICAL_FAILURE if loop.outcome is None else Status.STALLED


@dataclass(frozen=True)
class Raises:
    """Stop rule: violations remain although their penalty weights were raised.

    Attributes:
        most: Most raises of the weights.
    """

    most: int

    def __call__(self, loop: Loop) -> Status | None:
        """INFEASIBLE once the weights were raised more often."""
        return Status.INFEASIBLE if loop.state.raises > self.most else None


@dataclass(frozen=True)
class Iterations:
    """Stop rule: the iteration limit.

    Attributes:
        most: The limit, which row exchanges may extend.
    """

    most: int

    def __call__(self, loop: Loop) -> Status | None:
        """ITERATION_LIMIT once the limit is reached."""
        most = max(self.most, loop.extended_limit)
        over = loop.outcome is not None and len(loop.history) >= most
        return Status.ITERATION_LIMIT if over else None
