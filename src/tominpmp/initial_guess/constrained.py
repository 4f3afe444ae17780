"""Paths of guesses that satisfy the constraints on positions along the motion.

A straight line in joint space does not keep a tool upright. Its configurations are
therefore shifted, as little as possible, until the constraints on positions hold.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.path import PathConstraint
from tominpmp.initial_guess.path import PLACES
from tominpmp.kinematics import FrameMotions
from tominpmp.least_squares import LONGEST_STEP, least_squares
from tominpmp.transcription.problem_functions import ProblemFunctions

# Tolerance of configurations of a path: violations as shares of their scale, distances
# of frames as shares of the reach.
CLOSE = 1e-4
# Margin to the limits that shifted configurations keep, as a share of the scale.
INSIDE = 0.02
# Largest difference of the shifts of neighbouring configurations, beyond which the path
# jumps [rad].
JUMP = 1.2


def constraints_of(
    system: ProblemFunctions, order: int, *, timed: bool = False
) -> list[PathConstraint]:
    """Constraints of an order that hold during the whole motion, or a time window."""
    known = [item for item in system.problem.ready_constraints if item.order == order]
    return [item for item in known if (item.window is not None) == timed]


def feasible_path(system: ProblemFunctions, q_end: Array) -> tuple[bool, Array | None]:
    """A path from the start to a configuration that satisfies constraints on the way.

    Args:
        system: Functions of the problem.
        q_end: Final configuration, shape (n,).

    Returns:
        Whether the straight line satisfies the constraints on positions, and corners of
        the path, shape (m, n); None if no path was found, or if the straight line
        satisfies these constraints and no frame has to follow a curve.
    """
    held, empty = constraints_of(system, 0), np.zeros((PLACES + 1, 0))
    line = np.linspace(system.problem.q_start, q_end, PLACES + 1)
    keeps = all(
        item.measure_rows(line, empty, empty).max() <= item.largest + CLOSE * item.scale
        for item in held
    )
    guided: dict[str, tuple[FrameMotions, Array]] = {}
    for item in held:
        if item.guide is not None:
            frame, between = item.guide
            motions = FrameMotions(system.problem.robot, frame)
            first, last = motions.placements(line[[0, -1]]).origin
            guided[frame] = motions, between(first, last, len(line))
    moves = bool(guided) or not keeps
    return keeps, _shifted(system, line, guided.values(), held) if moves else None


def _shifted(
    system: ProblemFunctions,
    line: Array,
    guided: Collection[tuple[FrameMotions, Array]],
    held: Sequence[PathConstraint],
) -> Array | None:
    """A line whose configurations are shifted to points and into constraints.

    Args:
        system: Functions of the problem.
        line: The configurations, shape (m, n).
        guided: Motions of frames that have to follow curves, and points along these,
            shape (m, 3) [m].
        held: Constraints on positions to be satisfied.

    Returns:
        The shifted line; None if a configuration does not converge, or jumps away from
        its neighbour.
    """
    robot, reach = system.problem.robot, system.reach
    # The points keep the constraints that give their curves. Distances from an arc
    # would lead away from them: its chord may pass its centre, where they have a kink.
    others = [item for item in held if item.guide is None]

    def residual(q: Array, rows: IntArray) -> tuple[Array, Array]:
        """Distances of frames from their points, as shares of the reach; violations.

        Constraints are tightened by a small margin. Value and Jacobian of a satisfied
        constraint are zero.
        """
        values, slopes, empty = list[Array](), list[Array](), np.zeros((len(q), 0))
        for motions, target in guided:
            values.append((motions.placements(q).origin - target[rows + 1]) / reach)
            slopes.append(motions.jacobians(q)[:, :3] / reach)
        for item in others:
            value, by_q, _, _ = item.term_rows(q, empty, empty)
            lower, upper = item.bounds(len(q))
            room = np.minimum(INSIDE, 0.25 * (upper - lower))
            excess = value - np.clip(value, lower + room, upper - room)
            values.append(excess)
            slopes.append(np.where((excess != 0.0)[:, :, None], by_q, 0.0))
        return np.concatenate(values, axis=1), np.concatenate(slopes, axis=1)

    inner, error = least_squares(
        residual,
        line[1:-1],
        (robot.limits.position_lower, robot.limits.position_upper),
        system.step_scale,
        LONGEST_STEP * system.step_scale,
        reached=CLOSE,
    )
    if np.any(error > CLOSE):
        return None
    out = np.concatenate([line[:1], inner, line[-1:]])
    steps = np.abs(np.diff(out, axis=0) - np.diff(line, axis=0)) / system.step_scale
    return None if float(steps.max()) > JUMP else out
