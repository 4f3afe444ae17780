"""Configurations at a goal, led along what reaches it to where the start is nearest.

Damped least squares end anywhere on the set of configurations that reach a goal, which
has as many dimensions as the goal leaves joints free. What takes the least time is
mostly near the point of it that speed limits let the arm reach soonest, in that branch
of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tominpmp.arrays import Array
from tominpmp.initial_guess.at_goal import AtGoal
from tominpmp.initial_guess.path import speed_weights
from tominpmp.least_squares import damped_step, each

# Steps at most, how far each of them may go, and one that is none [rad].
STEPS, LONGEST_STEP, SHORTEST_STEP = 25, 0.2, 1e-3
# The largest displacement counts: the sum of their fourth powers is near enough to it.
# Those below this share of the largest one are weighed as if they were that large.
POWER, LEAST_SHARE = 4, 0.05


def led_nearer(asked: AtGoal, found: Sequence[Array]) -> list[Array]:
    """Lead configurations to where the slowest joint has least to go.

    Newton's steps for the sum of the powers, with the goal to first order.

    Args:
        asked: What is asked of the configurations.
        found: Configurations that reach the goal, each of shape (n,) [rad or m].

    Returns:
        As many near to some that reach it.
    """
    problem = asked.system.problem
    limits, start = problem.robot.limits, problem.q_start
    low, high = limits.position_lower, limits.position_upper
    weights, scale = speed_weights(limits.velocity), asked.scales.joints
    out, rows = np.array(found), np.arange(len(found))
    residual = each(lambda _, q: asked.residual(q))
    for _ in range(STEPS):
        if not rows.size:
            break
        q = out[rows]
        value, slope = residual(q, rows)
        share = weights * np.abs(q - start)
        largest = np.maximum(share.max(axis=1, keepdims=True), 1e-12)
        share = np.maximum(share / largest, LEAST_SHARE)
        unit = 1.0 / (weights * share ** (POWER / 2 - 1))
        # The whole way would be the step if its weighted square were all that counts.
        way = (q - start) / (POWER - 1)
        step = _step(value, slope, unit, way)
        pinned = ((q <= low) & (step < 0.0)) | ((q >= high) & (step > 0.0))
        if np.any(pinned):
            step = _step(value, slope, unit * ~pinned, way * ~pinned)
        far = np.max(np.abs(step) / scale, axis=1)
        step *= np.minimum(1.0, LONGEST_STEP / np.maximum(far, 1e-12))[:, None]
        out[rows] = np.clip(q + step, low, high)
        rows = rows[far >= SHORTEST_STEP]
    return list(out)


def _step(value: Array, slope: Array, unit: Array, way: Array) -> Array:
    """The steps that leave least of a way, and to first order nothing missing.

    Args:
        value: What is missing, shape (m, k).
        slope: Its derivatives, shape (m, k, n).
        unit: Displacements that count as much as each other, shape (m, n); zero for
            joints that stay.
        way: What the steps are to undo as far as they can, shape (m, n).
    """
    left = value - (slope @ way[:, :, None])[:, :, 0]
    return damped_step(left, slope, unit, np.zeros(len(value))) - way
