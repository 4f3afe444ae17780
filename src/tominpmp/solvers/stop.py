"""Stop rules: when an iteration ends. They are evaluated after each step."""

from __future__ import annotations

import numpy as np

from tominpmp.solvers.iterate import SMALLEST_RADIUS
from tominpmp.solvers.loop import Loop, Rule
from tominpmp.status import Status


def first_of(*rules: Rule | None) -> Rule:
    """Combine stop rules, if any: the first one that applies determines the status."""

    def rule(loop: Loop) -> Status | None:
        verdicts = (each(loop) for each in filter(None, rules))
        return next((status for status in verdicts if status is not None), None)

    return rule


def settled(loop: Loop) -> Status | None:
    """CONVERGED if no more progress is made, and slowing down removes violations."""
    done = loop.outcome is not None and loop.outcome.settled
    return Status.CONVERGED if done else None


def collapsed(loop: Loop) -> Status | None:
    """STALLED if the trust region has collapsed; a failure if no program was solved."""
    if loop.state.radius >= SMALLEST_RADIUS:
        return None
    return Status.NUMERICAL_FAILURE if loop.outcome is None else Status.STALLED


def weights_exceed(most: float) -> Rule:
    """Stop rule: INFEASIBLE once violations cost too much for any multiplier.

    The weight of a violation is raised until it exceeds the multiplier of the
    constraint. If violations remain with a weight far above all multipliers, no small
    change removes them.

    Args:
        most: Largest weight of a violation of 100 %, in multiples of the objective.
    """

    def rule(loop: Loop) -> Status | None:
        state = loop.state
        value = loop.objective.value(loop.program, state.z, state.values)
        heavy = np.max(state.weights, initial=0.0) > most * value
        return Status.INFEASIBLE if heavy else None

    return rule


def iterations(most: int) -> Rule:
    """Stop rule: ITERATION_LIMIT at the limit, which row exchanges may extend."""

    def rule(loop: Loop) -> Status | None:
        limit = max(most, loop.extended_limit)
        over = loop.outcome is not None and len(loop.history) >= limit
        return Status.ITERATION_LIMIT if over else None

    return rule
