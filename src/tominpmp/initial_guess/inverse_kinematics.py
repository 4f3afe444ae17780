"""Configurations that reach a goal on a frame, by damped least squares."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.path import PathConstraint
from tominpmp.goals import Goal
from tominpmp.initial_guess.at_goal import AtGoal
from tominpmp.initial_guess.nearest import led_nearer
from tominpmp.initial_guess.path import speed_weights
from tominpmp.initial_guess.rrt import is_free
from tominpmp.least_squares import each, least_squares
from tominpmp.transcription.problem_functions import ProblemFunctions

STEPS = 60
# Longest step of a joint [rad, or shares of the length that counts as 1 rad].
LONGEST_STEP = 0.5
# Residuals that end the steps, and that count as none [m, rad]; of arms shorter than a
# metre shares of their length.
TOLERANCE, REACHED = 1e-8, 1e-6
# Two solutions closer than this are one, and solutions at least so far apart go before
# those near to one of them [rad, or shares of the length that counts as 1 rad].
DISTINCT, SPREAD = 1e-2, 0.5
# Starts are drawn from this far round the start of the motion [likewise].
AROUND = np.pi
# Configurations in collision that are led out of it at most.
LED_OUT = 10
# Starts are drawn from all that is within reach, and as often from this share of it
# around the start of the motion: what is reached from there is mostly reached soonest.
# Of 60 goals 12 had nothing within 3 % of the nearest configuration without it, 2 with.
NEARER = 0.4
# Singular values of a goal's Jacobian below this share of the largest are none.
RANK = 1e-6


class GoalSearch(NamedTuple):
    """Configurations that reach a goal.

    Attributes:
        free: Those clear of obstacles, the most promising first, each of shape (n,).
        blocked: Those in collision.
        least: Smallest residual seen if there are neither (else 0).
    """

    free: list[Array]
    blocked: list[Array]
    least: float


def solve_inverse_kinematics(
    system: ProblemFunctions,
    goal: Goal,
    q: Array,
    *,
    alone: bool = False,
    beyond: Sequence[PathConstraint] = (),
    apart: bool = False,
) -> tuple[Array, float]:
    """Bring the placement residual of a goal to zero within the position limits.

    What a problem asks for at all times is to hold there, too.

    Args:
        system: Kinematics and limits.
        goal: The goal.
        q: Where to begin, shape (n,) [rad or m].
        alone: Whether nothing but the goal is asked for.
        beyond: Constraints on positions that hold from there on.
        apart: Whether bodies are to keep their distances, too.

    Returns:
        Configuration, shape (n,), and the norm of the residual left there.
    """
    asked = AtGoal(system, goal, alone=alone, beyond=beyond, apart=apart)
    (q,), _ = _solved(asked, q[None])
    return q, asked.missing(q)


def _solved(asked: AtGoal, q: Array) -> tuple[Array, Array]:
    """Configurations led to the goal, shape (m, n), and the norms of what is left."""
    limits = asked.system.problem.robot.limits
    return least_squares(
        each(lambda _, q: asked.residual(q)),
        q,
        (limits.position_lower, limits.position_upper),
        asked.scales.joints,
        LONGEST_STEP * asked.scales.joints,
        reached=TOLERANCE,
        steps=STEPS,
    )


def find_configurations(
    system: ProblemFunctions,
    goal: Goal,
    count: int,
    rng: np.random.Generator,
    *,
    alone: bool = False,
    beyond: Sequence[PathConstraint] = (),
) -> GoalSearch:
    """Distinct configurations that reach a goal, from twice as many starts as asked.

    Those that the speed limits let the arm reach soonest come first, as far as they are
    not near to one before them. If all are in collision, and the goal leaves the arm
    any freedom, it is looked for a way out of it.

    Returns:
        Configurations clear of obstacles and those in collision.
    """
    problem = system.problem
    limits = problem.robot.limits
    asked = AtGoal(system, goal, alone=alone, beyond=beyond)
    around = AROUND * asked.scales.joints
    low = np.maximum(limits.position_lower, problem.q_start - around)
    high = np.minimum(limits.position_upper, problem.q_start + around)
    wide = [rng.uniform(low, high) for _ in range(count)]
    near = [problem.q_start + NEARER * (q - problem.q_start) for q in wide]
    found, nearest = _led(asked, [problem.q_start, *wide, *near])
    if not alone:
        movable = [q for q in found if not isolated(asked, q)]
        found += _led(asked, led_nearer(asked, movable), found)[0]
    weights = speed_weights(limits.velocity)
    found.sort(key=lambda q: float(np.max(np.abs(q - problem.q_start) * weights)))
    clear = [is_free(system, q) for q in found]
    free = _spread(asked, [q for q, ok in zip(found, clear, strict=True) if ok])
    blocked = _spread(asked, [q for q, ok in zip(found, clear, strict=True) if not ok])
    if not free and system.clearance is not None:
        apart = AtGoal(system, goal, alone=alone, beyond=beyond, apart=True)
        movable = [q for q in blocked[:LED_OUT] if not isolated(asked, q)]
        free = [q for q in _led(apart, movable)[0] if is_free(system, q)]
    return GoalSearch(free, blocked, 0.0 if found else asked.missing(nearest))


def _led(
    asked: AtGoal, starts: Sequence[Array], known: Sequence[Array] = ()
) -> tuple[list[Array], Array]:
    """Configurations that starts are led to and that reach the goal, and the nearest.

    Those near to one that is known, or to one before them, are left out. The nearest is
    the one that misses the goal by least.
    """
    found = list[Array]()
    if not starts:
        return found, asked.system.problem.q_start
    ends, errors = _solved(asked, np.stack(starts))
    for q, error in zip(ends, errors, strict=True):
        if error < REACHED and not _near(asked, q, [*known, *found], DISTINCT):
            found.append(q)
    return found, np.asarray(ends[np.argmin(errors)])


def isolated(asked: AtGoal, q: Array) -> bool:
    """Whether no other configuration near one that reaches a goal reaches it."""
    _, by_q = asked.goal.place_residual(asked.system.kinematics, q)
    values = np.linalg.svd(by_q * asked.scales.joints, compute_uv=False)
    return values.size == q.size and bool(values[-1] > RANK * values[0])


def shut_out(system: ProblemFunctions, blocked: Sequence[Array]) -> bool:
    """Whether configurations in collision are all that may reach the goal.

    They are where each of them is the only one around, and bodies are nearer to each
    other than is allowed, not only nearer than what is asked for beyond that.
    """
    problem = system.problem
    if not blocked or problem.checker.moving:
        return False
    margins = problem.checker.margins(problem.margin)
    asked = AtGoal(system, problem.goal)
    return all(
        isolated(asked, q) and not problem.checker.is_free(q, margins) for q in blocked
    )


def goal_configurations(
    system: ProblemFunctions,
    goal: Goal,
    count: int,
    rng: np.random.Generator,
    *,
    beyond: Sequence[PathConstraint] = (),
) -> tuple[list[Array], float]:
    """As :func:`find_configurations`, those in collision only if there are no others.

    Returns:
        Configurations, and the smallest residual seen if there are none (else 0).
    """
    free, blocked, least = find_configurations(system, goal, count, rng, beyond=beyond)
    return free or blocked, least


def _near(asked: AtGoal, q: Array, others: list[Array], distance: float) -> bool:
    apart = (np.abs(q - other) / asked.scales.joints for other in others)
    return any(float(one.max()) <= distance for one in apart)


def _spread(asked: AtGoal, found: list[Array]) -> list[Array]:
    """Put configurations that are near to one before them last."""
    first: list[Array] = []
    last: list[Array] = []
    for q in found:
        (last if _near(asked, q, first, SPREAD) else first).append(q)
    return first + last
