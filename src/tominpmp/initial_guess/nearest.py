"""Configurations at a goal, led along what reaches it to where the start is nearest.

Damped least squares end anywhere on the set of configurations that reach a goal, which
has as many dimensions as the goal leaves joints free. What takes the least time is
mostly near the point of it that speed limits let the arm reach soonest, in that branch
of it.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.initial_guess.at_goal import AtGoal
from tominpmp.initial_guess.path import speed_weights

# Steps at most, how far each of them may go, and one that is none [rad].
STEPS, LONGEST_STEP, SHORTEST_STEP = 25, 0.2, 1e-3
# The largest displacement counts: the sum of their fourth powers is near enough to it.
# Those below this share of the largest one are weighed as if they were that large.
POWER, LEAST_SHARE = 4, 0.05
# Keeps a system of equations regular that lacks some, as a share of the largest one.
REGULAR = 1e-10


def led_nearer(asked: AtGoal, q: Array) -> Array:
    """Lead a configuration to where the slowest joint has least to go.

    Newton's steps for the sum of the powers, with the goal to first order.

    Args:
        asked: What is asked of the configuration.
        q: A configuration that reaches the goal, shape (n,) [rad or m].

    Returns:
        A configuration near to one that reaches it, shape (n,).
    """
    problem = asked.system.problem
    limits, start = problem.robot.limits, problem.q_start
    low, high = limits.position_lower, limits.position_upper
    weights, scale = speed_weights(limits.velocity), asked.scales.joints
    for _ in range(STEPS):
        value, jacobian = asked.residual(q)
        share = weights * np.abs(q - start)
        share = np.maximum(share / max(float(share.max()), 1e-12), LEAST_SHARE)
        inverse = 1.0 / (weights**2 * share ** (POWER - 2))
        # The whole way would be the step if its weighted square were all that counts.
        way = (q - start) / (POWER - 1)
        step = _step(value, jacobian, inverse, way)
        pinned = ((q <= low) & (step < 0.0)) | ((q >= high) & (step > 0.0))
        if np.any(pinned):
            step = _step(value, jacobian, np.where(pinned, 0.0, inverse), way)
        far = float(np.max(np.abs(step) / scale))
        q = np.clip(q + min(1.0, LONGEST_STEP / max(far, 1e-12)) * step, low, high)
        if far < SHORTEST_STEP:
            break
    return q


def _step(value: Array, jacobian: Array, inverse: Array, way: Array) -> Array:
    """The step that leaves least of a way, and to first order nothing missing.

    Args:
        value: What is missing, shape (k,).
        jacobian: Its derivative, shape (k, n).
        inverse: Inverse weights of the joints, shape (n,); zero for one that stays.
        way: What the step is to undo as far as it can, shape (n,).
    """
    moving = np.where(inverse > 0.0, way, 0.0)
    normal = (jacobian * inverse) @ jacobian.T
    largest = float(np.max(np.diag(normal), initial=0.0))
    normal += max(REGULAR * largest, np.finfo(float).tiny) * np.eye(value.size)
    force = np.linalg.solve(normal, jacobian @ moving - value)
    return np.asarray(inverse * (jacobian.T @ force) - moving)
