"""Pairs of constraints that no configuration keeps, and their nearest configuration.

They are searched only where a start or a goal violates a constraint, for the message.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.path import PathConstraint
from tominpmp.least_squares import least_squares, row_by_row
from tominpmp.robot.robot import Robot

# Number of starts, steps from each, and the residual of a constraint that is kept.
STARTS, STEPS, KEPT = 24, 60, 1e-6


def contradiction(
    broken: PathConstraint, others: Sequence[PathConstraint], robot: Robot, q: Array
) -> str:
    """Reason of a violated constraint, if no configuration was found that keeps it.

    Args:
        broken: The constraint, ready to be evaluated.
        others: The other constraints of the problem.
        robot: The robot.
        q: A configuration that violates it, shape (n,).

    Returns:
        A clause, beginning with a colon; empty where a configuration keeps it.
    """
    q_alone, left = nearest((broken,), robot, q)
    if left > KEPT:
        return (
            f": no configuration was found that keeps it; the nearest is "
            f"{np.round(q_alone, 4).tolist()}"
        )
    for number, other in enumerate(others, 1):
        if other is broken or other.window != broken.window:
            continue
        q_both, left = nearest((broken, other), robot, q)
        if left > KEPT:
            return (
                f": no configuration was found that keeps it together with the "
                f"{other.name} (at most {other.largest:.4g} {other.unit}; number "
                f"{number} of the constraints); they contradict each other, and come "
                f"nearest at {np.round(q_both, 4).tolist()}, where they are "
                f"{_size(broken, q_both)} and {_size(other, q_both)}"
            )
    return ""


def _size(item: PathConstraint, q: Array) -> str:
    """A quantity at a configuration at rest, with its unit."""
    none = np.zeros(q.size)
    return f"{item.measure(q, none, none):.4g} {item.unit}"


def nearest(
    items: Sequence[PathConstraint], robot: Robot, q: Array
) -> tuple[Array, float]:
    """The configuration with the smallest violation of constraints that was found.

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
    one = np.ones(q.size)

    def beyond(_: int, q: Array) -> tuple[Array, Array]:
        values, slopes = zip(*(item.excess_at_rest(q) for item in items), strict=True)
        return np.concatenate(values), np.concatenate(slopes)

    starts = np.vstack([q, rng.uniform(low, high, (STARTS - 1, q.size))])
    found, left = least_squares(
        row_by_row(beyond), starts, (low, high), one, one, reached=KEPT, steps=STEPS
    )
    best = int(np.argmin(left))
    return found[best], float(left[best])
