"""Goals that no configuration was found to reach: what to say of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.path import PathConstraint
from tominpmp.exceptions import ProblemError
from tominpmp.initial_guess.guess import KINEMATIC_STARTS
from tominpmp.initial_guess.inverse_kinematics import AtGoal, find_configurations
from tominpmp.initial_guess.segments import following, unreached
from tominpmp.transcription.problem_functions import ProblemFunctions


def unreachable(system: ProblemFunctions, rng: np.random.Generator) -> ProblemError:
    """Error for a goal that no configuration was found to reach."""
    where, beyond = "", list[PathConstraint]()
    if system.parts:
        number, reached = unreached(system, rng)
        beyond = following(system, number)
        where = f"segment {number + 1} of {len(system.parts)}: "
        system = reached
    goal = system.problem.goal
    found = find_configurations(system, goal, 2 * KINEMATIC_STARTS, rng, beyond=beyond)
    if found.blocked:
        return ProblemError(f"{where}goal: {_collision(system, found.blocked)}", "goal")
    held = _against_constraints(system, rng, beyond)
    if held:
        return ProblemError(f"{where}goal: {held}", "goal")
    frame = goal.frame_name
    what = "reaches it" if frame is None else f"brings frame {frame!r} there"
    return ProblemError(
        f"{where}goal: no configuration within the position limits {what}; the nearest "
        f"one found misses it by {found.least:.4g} (m, rad)",
        "goal",
    )


def _collision(system: ProblemFunctions, blocked: Sequence[Array]) -> str:
    """What is in the way of configurations that reach a goal.

    Told of the one that overlaps least.
    """
    problem = system.problem
    margins = problem.checker.margins(problem.margin)
    contacts = [(problem.checker.closest(q, margins, None), q) for q in blocked]
    contact, q = max(
        ((contact, q) for contact, q in contacts if contact is not None),
        key=lambda one: one[0].distance - one[0].margin,
    )
    depth = f"lack {contact.lack:.4g} m of room"
    return (
        f"all {len(blocked)} configurations found to reach it are in collision: in the "
        "one that is least so, "
        f"{contact.pair} {depth}, at q = {np.round(q, 4).tolist()}"
    )


def _against_constraints(
    system: ProblemFunctions,
    rng: np.random.Generator,
    beyond: Sequence[PathConstraint],
) -> str:
    """What keeps configurations that reach a goal from being allowed; may be nothing.

    Told of the one that breaks the constraints least.
    """
    goal = system.problem.goal
    items = AtGoal(system, goal, beyond=beyond).constraints
    if not items:
        return ""
    found = find_configurations(system, goal, 2 * KINEMATIC_STARTS, rng, alone=True)
    reached = [*found.free, *found.blocked]
    if not reached:
        return ""

    def worst(q: Array) -> tuple[float, PathConstraint]:
        each = [
            (float(np.abs(item.excess_at_rest(q)[0]).max()), item) for item in items
        ]
        return max(each, key=lambda one: one[0])

    q = min(reached, key=lambda q: worst(q)[0])
    item, none = worst(q)[1], np.zeros_like(q)
    # Of loads it tells why they are not held.
    why = item.lack(q, none, 0.0).removeprefix(f"the {item.name} ")
    return (
        f"no configuration was found that reaches it and keeps the {item.name}: in the "
        f"nearest one it {why or 'is beyond its limit'}, at q = "
        f"{np.round(q, 4).tolist()}"
    )
