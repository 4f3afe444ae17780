"""Paths of guesses that keep the constraints on positions along the motion.

A straight line in joint space keeps neither a tool upright nor its way short. Here its
configurations are shifted, by as little as possible, until the constraints on positions
hold, or until a tool whose speed is limited goes straight.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints import States
from tominpmp.constraints.path import PathConstraint
from tominpmp.least_squares import each, least_squares
from tominpmp.problem import Problem
from tominpmp.transcription.problem_functions import ProblemFunctions

# Configurations of a path that are shifted, and steps for each of them.
PLACES, STEPS = 24, 12
# Shares of straightness of a tool's path, in the order in which they are tried: not
# every arm reaches the whole of a straight line.
STRAIGHT = (1.0, 0.7, 0.4)
# Shifted until values are below this share of their scale, or points this near [m].
CLOSE = 1e-4
# Margin inside of their limits to which values are brought, as a share of the scale.
INSIDE = 0.02
# Largest step of a joint [rad], and between neighbours: beyond this the path jumps.
STEP, JUMP = 0.3, 1.2
# Bisections for the speed at which a constraint not linear in the speed is active.
BISECTIONS = 30

# Residual to be brought to zero at a configuration at a share of the path, (k,), and
# its Jacobian, (k, n).
Residual = Callable[[float, Array], tuple[Array, Array]]


def path_speeds(system: ProblemFunctions, q: Array, first: Array) -> Array:
    """Speeds along a path at which constraints on velocities become active.

    Args:
        system: The problem.
        q: Configurations, shape (m, n).
        first: Their derivatives by the path parameter, shape (m, n).

    Returns:
        Derivatives of the path parameter by time, shape (m,); infinite where no
        constraint on velocities becomes active.
    """
    top = np.full(len(q), np.inf)
    for constraint in system.problem.ready_constraints:
        if constraint.order == 1 and constraint.curable:
            found = [_speed(constraint, *row) for row in zip(q, first, strict=True)]
            top = np.minimum(top, found)
    return top


def speed_used(problem: Problem, q: Array, v: Array) -> Array:
    """Largest share of a speed limit that a motion uses, at m states, shape (m,).

    The limits are those of the joints and of the tools whose speed is limited.
    """
    used = np.max(np.abs(v) / problem.robot.limits.velocity, axis=1)
    none = np.zeros((0, q.shape[1]))
    states = States(np.zeros(len(q)), q, v, none)
    for item in problem.ready_constraints:
        if item.order == 1 and item.curable and item.window is None:
            used = np.maximum(used, item.measures(states) / item.largest)
    return np.asarray(used)


def _speed(constraint: PathConstraint, q: Array, first: Array) -> float:
    """Speed along a path at which a constraint becomes active at one configuration."""
    none = np.zeros(0)
    most = constraint.largest
    alone = constraint.measure(q, first, none)
    if not alone > 0.0:
        return np.inf
    high = most / alone
    if abs(constraint.measure(q, high * first, none) - most) <= 1e-6 * abs(most):
        return high  # the measure is proportional to the speed along the path
    low = 0.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        over = constraint.measure(q, middle * first, none) > most
        low, high = (low, middle) if over else (middle, high)
    return low


def held_positions(problem: Problem) -> list[PathConstraint]:
    """Constraints on positions that hold at all times of a motion."""
    every = problem.ready_constraints
    return [item for item in every if item.order == 0 and item.window is None]


def keeping_paths(system: ProblemFunctions, q_end: Array, keeps: bool) -> list[Array]:
    """Paths from the start to a configuration that keep constraints on the way.

    Args:
        system: The problem.
        q_end: Final configuration, shape (n,).
        keeps: Whether a straight line keeps constraints on positions.

    Returns:
        Corners of each path, shape (m, n): a path within the constraints on positions,
        where a straight line violates them, and a path on which tools whose speed is
        limited go straight, or along the curve that they are to keep to. The list is
        empty where the problem has no constraint of these kinds, or no path was found.
    """
    problem = system.problem
    held = held_positions(problem)
    line = np.linspace(problem.q_start, q_end, PLACES + 1)
    inside = partial(excess_of, held)
    found: list[Array | None] = []
    guided = _guided(system, line, held)
    if guided:
        along = partial(_off_points, system, guided)
        found.append(_shifted(system, line, _both(along, inside)))
    elif not keeps:
        found.append(_shifted(system, line, lambda _, q: inside(q)))
    always = [item for item in problem.ready_constraints if item.window is None]
    fast = [item.top_speed[0] for item in always if item.top_speed is not None]
    for straight in STRAIGHT if fast and not guided else ():
        points = _straight(system, line, fast, straight)
        along = partial(_off_points, system, points)
        path = _shifted(system, line, _both(along, inside))
        found.append(path)
        if path is not None:
            break
    return [path for path in found if path is not None]


def _guided(
    system: ProblemFunctions, line: Array, held: Sequence[PathConstraint]
) -> dict[str, Array]:
    """Points along the curves that frames are to keep to, by frame, (m, 3) [m]."""
    found: dict[str, Array] = {}
    for item in held:
        if item.guide is None:
            continue
        frame, between = item.guide
        places = [system.kinematics.placement(q, frame) for q in (line[0], line[-1])]
        first, last = (np.array(place.translation) for place in places)
        found[frame] = between(first, last, len(line))
    return found


def _both(along: Residual, inside: Callable[[Array], tuple[Array, Array]]) -> Residual:
    """A residual that stacks two residuals."""

    def residual(share: float, q: Array) -> tuple[Array, Array]:
        values, slopes = zip(along(share, q), inside(q), strict=True)
        return np.concatenate(values), np.vstack(slopes)

    return residual


def keeps_positions(system: ProblemFunctions, q_end: Array) -> bool:
    """Whether a straight line to a configuration keeps constraints on positions."""
    path = np.linspace(system.problem.q_start, q_end, PLACES + 1)
    none = np.zeros(0)
    return all(
        item.measure(q, none, none) <= item.largest + CLOSE * item.scale
        for item in held_positions(system.problem)
        for q in path
    )


def excess_of(held: Sequence[PathConstraint], q: Array) -> tuple[Array, Array]:
    """Violation of constraints on positions at a configuration.

    The constraints are tightened by a small margin.

    Returns:
        Violations, zero where a constraint is kept, shape (k,), and their Jacobian,
        zero there too, shape (k, n).
    """
    none = np.zeros(0)
    values, slopes = [none], [np.zeros((0, q.size))]
    for item in held:
        value, by_q, _, _ = item.terms(q, none, none)
        lower, upper = (bound[0] for bound in item.bounds(1))
        room = np.minimum(INSIDE, 0.25 * (upper - lower))
        excess = value - np.clip(value, lower + room, upper - room)
        values.append(excess)
        slopes.append(np.where((excess != 0.0)[:, None], by_q, 0.0))
    return np.concatenate(values), np.vstack(slopes)


def _straight(
    system: ProblemFunctions, line: Array, frames: Sequence[str], straight: float
) -> dict[str, Array]:
    """Points of straight lines for tools, by frame, shape (m, 3) [m].

    Below a share of 1, weighted means of the straight line and of the tool's path on
    the straight line in joint space.
    """
    shares = np.linspace(0.0, 1.0, len(line))[:, None]
    found: dict[str, Array] = {}
    for frame in frames:
        places = [system.kinematics.placement(q, frame).translation for q in line]
        bent = np.array(places)
        even = bent[0] + shares * (bent[-1] - bent[0])
        found[frame] = bent + straight * (even - bent)
    return found


def _off_points(
    system: ProblemFunctions, wanted: dict[str, Array], share: float, q: Array
) -> tuple[Array, Array]:
    """Distances of frames from their points at a share of the path, over the reach."""
    values, slopes = [], []
    for frame, points in wanted.items():
        there = points[round(share * (len(points) - 1))]
        place = np.asarray(system.kinematics.placement(q, frame).translation)
        values.append((place - there) / system.reach)
        slopes.append(system.kinematics.jacobian(q, frame)[:3] / system.reach)
    return np.concatenate(values), np.vstack(slopes)


def _shifted(system: ProblemFunctions, line: Array, residual: Residual) -> Array | None:
    """A line whose configurations are shifted until a residual is zero.

    None if a configuration cannot be shifted to zero residual, or jumps away from its
    neighbour.
    """
    limits, shares = system.problem.robot.limits, np.linspace(0.0, 1.0, len(line))
    inner, left = least_squares(
        each(lambda row, q: residual(float(shares[row + 1]), q)),
        line[1:-1],
        (limits.position_lower, limits.position_upper),
        system.step_scale,
        STEP * system.step_scale,
        reached=CLOSE,
        steps=STEPS,
    )
    if np.any(left > CLOSE):
        return None
    out = np.concatenate([line[:1], inner, line[-1:]])
    steps = np.abs(np.diff(out, axis=0) - np.diff(line, axis=0)) / system.step_scale
    return None if float(steps.max()) > JUMP else out
