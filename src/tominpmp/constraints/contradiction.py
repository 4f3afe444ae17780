"""Search for pairs of constraints that no configuration keeps, for error messages.

The search runs only if a start or a goal violates a constraint.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.path import PathConstraint
from tominpmp.least_squares import least_squares
from tominpmp.robot.robot import Robot

# Number of starts, and residual below which a constraint counts as kept.
STARTS, KEPT = 24, 1e-6


def contradiction(
    broken: PathConstraint, others: Sequence[PathConstraint], robot: Robot, q: Array
) -> str:
    """Reason for a violated constraint, if no configuration was found that keeps it.

    Args:
        broken: The violated constraint, ready to be evaluated.
        others: Constraints of the problem; the violated constraint is skipped.
        robot: The robot.
        q: A configuration that violates it, shape (n,).

    Returns:
        A clause, beginning with a colon; empty if configurations keep the constraint,
        alone and together with each of the others.
    """
    q_alone, residual = nearest((broken,), robot, q)
    if residual > KEPT:
        return (
            f": no configuration was found that keeps it; the nearest is "
            f"{np.round(q_alone, 4).tolist()}"
        )
    for number, other in enumerate(others, 1):
        if other is broken or other.during != broken.during:
            continue
        q_both, residual = nearest((broken, other), robot, q)
        if residual > KEPT:
            return (
                f": no configuration was found that keeps it together with the "
                f"{other.name} (at most {other.largest:.4g} {other.unit}; number "
                f"{number} of the constraints); they contradict each other, and come "
                f"nearest at {np.round(q_both, 4).tolist()}, where they are "
                f"{_size(broken, q_both)} and {_size(other, q_both)}"
            )
    return ""


def _size(item: PathConstraint, q: Array) -> str:
    """Quantity of a constraint at a configuration at rest, with its unit."""
    rest = np.zeros(q.size)
    return f"{item.measure(q, rest, rest):.4g} {item.unit}"


def nearest(
    items: Sequence[PathConstraint], robot: Robot, q: Array
) -> tuple[Array, float]:
    """Configuration with the smallest violation of constraints among local minima.

    Args:
        items: The constraints, ready to be evaluated.
        robot: The robot.
        q: Configuration to start from, shape (n,) [rad or m].

    Returns:
        Configuration, shape (n,), and the norm of the excesses over the limits there,
        in units of their scales.
    """
    limits, rng = robot.limits, np.random.default_rng(0)
    low = np.maximum(limits.position_lower, q - np.pi)
    high = np.minimum(limits.position_upper, q + np.pi)
    unit = np.ones(q.size)

    def excess(q: Array, _: IntArray) -> tuple[Array, Array]:
        values, slopes = zip(*(item.excess_at_rest(q) for item in items), strict=True)
        return np.concatenate(values, axis=1), np.concatenate(slopes, axis=1)

    starts = np.vstack([q, rng.uniform(low, high, (STARTS - 1, q.size))])
    found, norms = least_squares(excess, starts, (low, high), unit, unit, reached=KEPT)
    best = int(np.argmin(norms))
    return found[best], float(norms[best])
