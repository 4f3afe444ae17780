"""Integrating the dynamics forward, and how motions depend on their torques."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.dynamics import Dynamics
from tominpmp.transcription.integrator import (
    NEWTON_STEPS,
    WEIGHTS,
    DefectJacobians,
    Newton,
    solve_systems,
)

NEWTON_STEPS_NEAR = 8  # on all steps at once, before giving up


class Rollout(NamedTuple):
    """A motion integrated forward from a state.

    Attributes:
        x: States at the ends of all steps, from the start on, shape (M + 1, 2n).
        inner: Inner stages, shape (M, 2n).
        u: Torques of the steps, shape (M, n).
        h: Lengths of the steps [s], shape (M,).
        substeps: Steps an interval.
        finite: Whether every step could be solved; what follows a failure is NaN.
    """

    x: Array
    inner: Array
    u: Array
    h: Array
    substeps: int
    finite: bool

    @property
    def nodes(self) -> Array:
        """States at the nodes, shape (N + 1, 2n)."""
        return self.x[:: self.substeps]


class Sensitivities(NamedTuple):
    """How the end of each interval depends on its start, torque and length.

    Attributes:
        A: With respect to x_k, shape (N, 2n, 2n).
        B: With respect to u_k, shape (N, 2n, n).
        c: With respect to h_k, shape (N, 2n).
    """

    A: Array
    B: Array
    c: Array


def rollout(
    dynamics: Dynamics,
    x_start: Array,
    u: Array,
    h: Array,
    substeps: int = 1,
    guess: Rollout | None = None,
) -> Rollout:
    """Integrate forward with a constant torque on each interval.

    With a motion near by as a guess, Newton's iteration runs on all steps at once,
    which takes a few evaluations of long rows in place of many of short ones; the
    outcome is the same. Otherwise, or where that fails, one step is solved after the
    other.

    Args:
        dynamics: Equations of motion.
        x_start: State at the start, shape (2n,).
        u: Torques of the intervals, shape (N, n) [N m or N].
        h: Lengths of the intervals, shape (N,) [s].
        substeps: Steps an interval.
        guess: A motion of as many steps.
    """
    u, h = np.repeat(u, substeps, axis=0), np.repeat(h / substeps, substeps)
    count, size = h.size, x_start.size
    with np.errstate(over="ignore", invalid="ignore"):
        if guess is not None and guess.finite:
            stages = np.stack([guess.inner, guess.x[1:]], axis=1)
            solved = _solve_steps(dynamics, x_start, u, h, stages, NEWTON_STEPS_NEAR)
            if solved is not None:
                return _as_rollout(x_start, solved, u, h, substeps)
        stages = np.full((count, 2, size), np.nan)
        x = x_start
        for k in range(count):
            start = np.stack([x, x])[None]
            one = slice(k, k + 1)
            solved = _solve_steps(dynamics, x, u[one], h[one], start, NEWTON_STEPS)
            if solved is None:
                break
            stages[k] = solved[0]
            x = stages[k, 1]
    return _as_rollout(x_start, stages, u, h, substeps)


def _as_rollout(
    x_start: Array, stages: Array, u: Array, h: Array, substeps: int
) -> Rollout:
    x = np.concatenate([x_start[None], stages[:, 1]])
    finite = bool(np.all(np.isfinite(x)))
    return Rollout(x, stages[:, 0], u, h, substeps, finite)


def compose_steps(by: DefectJacobians, substeps: int) -> Sensitivities:
    """Derivatives of intervals of so many steps each, from those of the steps."""
    size, n = by.by_control.shape[1:]
    right = np.concatenate(
        [by.by_start, by.by_control, by.by_length[..., None]], axis=2
    )
    # The end of a step makes its defect zero.
    parts = -solve_systems(by.by_end, right).reshape(-1, substeps, size, size + n + 1)
    parts[..., -1] /= substeps
    total = parts[:, 0]
    for s in range(1, substeps):
        A = parts[:, s, :, :size]
        carried = A @ total
        carried[..., size:] += parts[:, s, :, size:]
        total = carried
    return Sensitivities(total[..., :size], total[..., size:-1], total[..., -1])


def _solve_steps(
    dynamics: Dynamics, x_start: Array, u: Array, h: Array, stages: Array, most: int
) -> Array | None:
    """Stages of successive steps by Newton's iteration on all of them.

    Args:
        dynamics: Equations of motion.
        x_start: State before the first step, shape (s,).
        u: Torques, shape (M, n).
        h: Lengths [s], shape (M,).
        stages: Guess, shape (M, 2, s).
        most: Largest number of iterations.

    Returns:
        Stages, shape (M, 2, s); None where the iteration fails.
    """
    count, _, size = stages.shape
    weights = h[:, None, None] * WEIGHTS
    torque = np.repeat(u, 2, axis=0)
    identity = np.eye(2 * size)
    both = np.broadcast_to(np.vstack([np.eye(size)] * 2), (count, 2 * size, size))
    progress = Newton(1)
    for _ in range(most):
        by = dynamics.forward_jacobians(stages.reshape(-1, size), torque)
        f_x = by.f_x.reshape(count, 2, size, size)
        starts = np.concatenate([x_start[None], stages[:-1, 1]])
        residual = stages - starts[:, None] - weights @ by.f.reshape(stages.shape)
        coupling = weights[:, :, None, :, None] * f_x.transpose(0, 2, 1, 3)[:, None]
        matrix = identity - coupling.reshape(count, 2 * size, 2 * size)
        residual = residual.reshape(count, 2 * size, 1)
        if count == 1:
            change = -solve_systems(matrix, residual).reshape(1, 2 * size)
        else:
            right = np.concatenate([-residual, both], axis=2)
            change = _follow(solve_systems(matrix, right))
        stages = stages + change.reshape(stages.shape)
        if progress.settled(change.reshape(1, -1), stages.reshape(1, -1)):
            break
    return stages if progress.solved[0] else None


def _follow(parts: Array) -> Array:
    """Changes of all stages, each step starting where the one before it ends, (M, 2s).

    From those with a fixed start and their derivatives by it, shape (M, 2s, 1 + s).
    """
    size = parts.shape[2] - 1
    own, by_start = parts[..., 0].copy(), parts[..., 1:]
    for k in range(1, own.shape[0]):
        own[k] += by_start[k] @ own[k - 1, size:]
    return own
