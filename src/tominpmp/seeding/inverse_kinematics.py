"""Configurations that reach a goal on a frame, by damped least squares."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.goals import FrameGoal
from tominpmp.transcription.system import System

STEPS = 100
TOLERANCE = 1e-8
# Two solutions closer than this are one [rad or m].
DISTINCT = 1e-2


def solve_inverse_kinematics(
    system: System, goal: FrameGoal, q: Array
) -> tuple[Array, float]:
    """Bring the placement residual of a goal to zero within the position limits.

    Levenberg-Marquardt steps, clipped to the limits (Sugihara, 2011).

    Args:
        system: Kinematics and limits.
        goal: The goal.
        q: Where to begin, shape (n,) [rad or m].

    Returns:
        Configuration, shape (n,), and the norm of the residual left there.
    """
    limits = system.problem.robot.limits
    low, high = limits.position_lower, limits.position_upper
    q = np.clip(q, low, high)
    value, jacobian = goal.place_residual(system.kinematics, q)
    damping = 1e-2
    for _ in range(STEPS):
        error = float(value @ value)
        if error < TOLERANCE**2:
            break
        gradient = jacobian.T @ value
        pinned = ((q <= low) & (gradient > 0.0)) | ((q >= high) & (gradient < 0.0))
        free = ~pinned
        if not np.any(free):
            break
        J = jacobian[:, free]
        normal = J.T @ J + (damping * error + 1e-12) * np.eye(int(free.sum()))
        step = np.zeros_like(q)
        step[free] = -np.linalg.solve(normal, gradient[free])
        step *= min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-12))
        trial = np.clip(q + step, low, high)
        new_value, new_jacobian = goal.place_residual(system.kinematics, trial)
        if float(new_value @ new_value) < error:
            q, value, jacobian = trial, new_value, new_jacobian
            damping = max(0.3 * damping, 1e-6)
        else:
            damping *= 5.0
            if damping > 1e8:
                break
    return q, float(np.linalg.norm(value))


def goal_configurations(
    system: System, goal: FrameGoal, count: int, rng: np.random.Generator
) -> tuple[list[Array], float]:
    """Distinct configurations that reach a goal, the nearest to the start first.

    Args:
        system: Kinematics and limits.
        goal: The goal.
        count: Number of random starts, beside the start of the problem.
        rng: Random numbers.

    Returns:
        Configurations, and the smallest residual seen if there are none (else 0).
    """
    problem = system.problem
    limits = problem.robot.limits
    low = np.maximum(limits.position_lower, problem.q_start - np.pi)
    high = np.minimum(limits.position_upper, problem.q_start + np.pi)
    found: list[Array] = []
    least = np.inf
    starts = [problem.q_start, *(rng.uniform(low, high) for _ in range(count))]
    for start in starts:
        q, error = solve_inverse_kinematics(system, goal, start)
        least = min(least, error)
        if error < 1e-6 and all(np.abs(q - other).max() > DISTINCT for other in found):
            found.append(q)
    found.sort(key=lambda q: float(np.abs(q - problem.q_start).max()))
    return found, 0.0 if found else least
