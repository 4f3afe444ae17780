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
from tominpmp.stopping import check
from tominpmp.transcription.problem_functions import ProblemFunctions

STEPS = 60
# Longest step of a joint [rad, or shares of the length that counts as 1 rad].
LONGEST_STEP = 0.5
# Residuals that end the steps, and that count as none [m, rad]; of arms shorter than a
# metre shares of their length.
TOLERANCE, REACHED = 1e-8, 1e-6
# Keeps a system of equations regular that lacks some, as a share of its diagonal.
REGULAR = 1e-12
# A start is given up when this many steps have not halved the residual; most of the
# time would go into those that get nowhere.
PATIENCE = 12
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

    Levenberg-Marquardt steps, clipped to the limits (Sugihara, 2011).

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
    q, _ = _solved(asked, q)
    return q, asked.missing(q)


def _solved(asked: AtGoal, q: Array) -> tuple[Array, float]:
    """The steps, in joint displacements of which each counts as 1 rad."""
    limits = asked.system.problem.robot.limits
    low, high = limits.position_lower, limits.position_upper
    q = np.clip(q, low, high)
    value, jacobian = asked.residual(q)
    damping = 1e-2
    error = mark = float(value @ value)
    for number in range(STEPS):
        check()
        if error < TOLERANCE**2:
            break
        if number % PATIENCE == PATIENCE - 1:
            if error > 0.25 * mark:
                break
            mark = error
        gradient = jacobian.T @ value
        pinned = ((q <= low) & (gradient > 0.0)) | ((q >= high) & (gradient < 0.0))
        free = ~pinned
        if not np.any(free):
            break
        J = (jacobian * asked.scales.joints)[:, free]
        normal = J.T @ J
        least = REGULAR * max(float(normal.diagonal().max()), np.finfo(float).tiny)
        normal += (damping * error + least) * np.eye(len(normal))
        step = np.zeros_like(q)
        step[free] = -np.linalg.solve(normal, J.T @ value)
        step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-12))
        trial = np.clip(q + asked.scales.joints * step, low, high)
        new_value, new_jacobian = asked.residual(trial)
        new_error = float(new_value @ new_value)
        if new_error < error:
            q, value, jacobian, error = trial, new_value, new_jacobian, new_error
            damping = max(0.3 * damping, 1e-6)
        else:
            damping *= 5.0
            if damping > 1e8:
                break
    return q, float(np.sqrt(error))


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
    found: list[Array] = []
    least, nearest = np.inf, problem.q_start
    wide = [rng.uniform(low, high) for _ in range(count)]
    near = [problem.q_start + NEARER * (q - problem.q_start) for q in wide]
    for start in (problem.q_start, *wide, *near):
        q, error = _solved(asked, start)
        if error < least:
            least, nearest = error, q
        if _is_new(asked, q, error, found):
            found.append(q)
    if not alone:
        found += _nearer(asked, found)
    weights = speed_weights(limits.velocity)
    found.sort(key=lambda q: float(np.max(np.abs(q - problem.q_start) * weights)))
    clear = [is_free(system, q) for q in found]
    free = _spread(asked, [q for q, ok in zip(found, clear, strict=True) if ok])
    blocked = _spread(asked, [q for q, ok in zip(found, clear, strict=True) if not ok])
    if not free and system.clearance is not None:
        apart = AtGoal(system, goal, alone=alone, beyond=beyond, apart=True)
        free = _led_out(apart, blocked[:LED_OUT])
    return GoalSearch(free, blocked, 0.0 if found else asked.missing(nearest))


def _is_new(asked: AtGoal, q: Array, error: float, others: list[Array]) -> bool:
    """Whether a configuration reaches the goal, and none of the others is near it."""
    return error < REACHED and not _near(asked, q, others, DISTINCT)


def _nearer(asked: AtGoal, found: list[Array]) -> list[Array]:
    """Configurations that reach a goal nearer to the start than those found."""
    nearer = list[Array]()
    for q in found:
        if isolated(asked, q):
            continue
        moved, error = _solved(asked, led_nearer(asked, q))
        if _is_new(asked, moved, error, [*found, *nearer]):
            nearer.append(moved)
    return nearer


def _led_out(asked: AtGoal, blocked: Sequence[Array]) -> list[Array]:
    """Configurations that reach a goal beside those that collide there."""
    found: list[Array] = []
    for q in blocked:
        if isolated(asked, q):
            continue
        moved, error = _solved(asked, q)
        if _is_new(asked, moved, error, found) and is_free(asked.system, moved):
            found.append(moved)
    return found


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
