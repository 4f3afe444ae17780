"""Paths of guesses that keep the constraints on positions along the motion.

A straight line in joint space keeps neither a tool upright nor its way short. Here its
configurations are shifted, by as little as possible, until the constraints on positions
hold, or until a tool whose speed is limited goes straight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.base import States
from tominpmp.constraints.path import PathConstraint
from tominpmp.least_squares import each, least_squares
from tominpmp.transcription.problem_functions import ProblemFunctions

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem

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
    found: list[Array | None] = []
    guided = _guided(system, line, held)
    if guided or not keeps:
        found.append(_shifted(system, line, guided, held))
    always = [item for item in problem.ready_constraints if item.window is None]
    fast = [item.top_speed[0] for item in always if item.top_speed is not None]
    for straight in STRAIGHT if fast and not guided else ():
        points = _straight(system, line, fast, straight)
        path = _shifted(system, line, points, held)
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


def keeps_positions(system: ProblemFunctions, q_end: Array) -> bool:
    """Whether a straight line to a configuration keeps constraints on positions."""
    path = np.linspace(system.problem.q_start, q_end, PLACES + 1)
    none = np.zeros(0)
    return all(
        item.measure(q, none, none) <= item.largest + CLOSE * item.scale
        for item in held_positions(system.problem)
        for q in path
    )


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


def _shifted(
    system: ProblemFunctions,
    line: Array,
    points: Mapping[str, Array],
    held: Sequence[PathConstraint],
) -> Array | None:
    """A line whose configurations are shifted until they are where they should be.

    Args:
        system: The problem.
        line: The configurations, shape (m, n).
        points: Where frames should be on the way, by frame, shape (m, 3) [m].
        held: Constraints on positions that should hold.

    Returns:
        The line; None if one of its configurations cannot be shifted so far, or jumps
        away from its neighbour.
    """
    kinematics, reach, none = system.kinematics, system.reach, np.zeros(0)

    def residual(row: int, q: Array) -> tuple[Array, Array]:
        """Distances of frames from their points, over the reach, and violations.

        Constraints are tightened by a small margin; where one is kept, value and
        Jacobian are zero.
        """
        values, slopes = [none], [np.zeros((0, q.size))]
        for frame, wanted in points.items():
            place = np.asarray(kinematics.placement(q, frame).translation)
            values.append((place - wanted[row + 1]) / reach)
            slopes.append(kinematics.jacobian(q, frame)[:3] / reach)
        for item in held:
            value, by_q, _, _ = item.terms(q, none, none)
            lower, upper = (bound[0] for bound in item.bounds(1))
            room = np.minimum(INSIDE, 0.25 * (upper - lower))
            excess = value - np.clip(value, lower + room, upper - room)
            values.append(excess)
            slopes.append(np.where((excess != 0.0)[:, None], by_q, 0.0))
        return np.concatenate(values), np.vstack(slopes)

    limits = system.problem.robot.limits
    inner, left = least_squares(
        each(residual),
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
