r"""Three-stage Radau IIA: accurate integration with constant torques on arcs.

The scheme has order 5 and is L-stable (Hairer and Wanner, 1996, section IV.5). Its last
node is the end of the step, so that the last stage is the state at the end:

.. math::
    X_i = x + h \sum_j a_{ij} f(X_j, u), \qquad x_{+} = X_3.

Newton's iteration solves all steps at once, starting from the motion that was found
last: it converges from guesses from which step-by-step integration would diverge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.dynamics import Dynamics
from tominpmp.exact.held_joints import Rates, differentiate_rates
from tominpmp.transcription.integrator import forward_sweep, solve_systems

_R = math.sqrt(6.0)
NODES = np.array([(4.0 - _R) / 10.0, (4.0 + _R) / 10.0, 1.0])
WEIGHTS = np.array(
    [
        [(88 - 7 * _R) / 360, (296 - 169 * _R) / 1800, (3 * _R - 2) / 225],
        [(296 + 169 * _R) / 1800, (88 + 7 * _R) / 360, -(3 * _R + 2) / 225],
        [(16 - _R) / 36, (16 + _R) / 36, 1 / 9],
    ]
)
STAGES = 3
NEWTON_STEPS = 12
# Newton steps that increase the residual are tried at most this number of times, and
# halved in between.
HALVINGS = 4


@dataclass(frozen=True, eq=False)
class IntegratedArcs:
    """A motion that was integrated in steps with constant torque each.

    Attributes:
        x_start: State at the start, shape (2n,).
        stages: States at the inner stages and the end of each step, shape (M, 3, 2n).
        h: Lengths of the steps [s], shape (M,).
        rates: State derivatives and torques at the 3 M stages.
    """

    x_start: Array
    stages: Array
    h: Array
    rates: Rates

    @property
    def x(self) -> Array:
        """State at the start and at the end of each step, shape (M + 1, 2n)."""
        return np.concatenate([self.x_start[None], self.stages[:, -1]])

    @cached_property
    def sensitivities(self) -> tuple[Array, Array, Array]:
        """Derivatives of the stages of each step by its start, torque and length.

        Shapes (M, 3, 2n, 2n), (M, 3, 2n, n) and (M, 3, 2n).
        """
        count, _, size = self.stages.shape
        n = size // 2
        f = self.rates.f.reshape(count, STAGES, size)
        f_u = self.rates.f_u.reshape(count, STAGES, size, n)
        by_u = np.einsum("ij,mjab->miab", WEIGHTS, f_u).reshape(count, -1, n)
        by_h = np.einsum("ij,mja->mia", WEIGHTS, f).reshape(count, -1, 1)
        by_u = by_u * self.h[:, None, None]
        right = np.concatenate([_by_starts(count, size), by_u, by_h], axis=2)
        matrix = _stage_matrix(self.h, self.rates.f_x, count, size)
        found = np.linalg.solve(matrix, right).reshape(count, STAGES, size, -1)
        return found[..., :size], found[..., size:-1], found[..., -1]


def integrate(
    dynamics: Dynamics,
    x_start: Array,
    u: Array,
    modes: IntArray,
    h: Array,
    guess: Array,
) -> tuple[IntegratedArcs | None, int]:
    """Integrate forward, by solving all steps at once from a guess.

    Args:
        dynamics: Equations of motion.
        x_start: State at the start, shape (2n,).
        u: Torques of the steps, shape (M, n) [N m or N].
        modes: Modes of the joints on the steps, shape (M, n); see
            :func:`~tominpmp.exact.held_joints.differentiate_rates`.
        h: Lengths of the steps [s], shape (M,).
        guess: Stages of a similar motion, shape (M, 3, 2n).

    Returns:
        The motion, or None if Newton's iteration fails; and the number of states at
        which the dynamics were evaluated.
    """
    count, _, size = guess.shape
    torque = np.repeat(u, STAGES, axis=0)
    mode = np.repeat(modes, STAGES, axis=0)
    by_starts = _by_starts(count, size)

    def residual_at(stages: Array) -> tuple[Rates, Array]:
        rates = differentiate_rates(dynamics, stages.reshape(-1, size), torque, mode)
        starts = np.concatenate([x_start[None], stages[:-1, -1]])
        slope = np.einsum("ij,mja->mia", WEIGHTS, rates.f.reshape(stages.shape))
        return rates, stages - starts[:, None] - h[:, None, None] * slope

    stages, each = guess, torque.shape[0]
    if not np.all(np.isfinite(guess)):
        return None, 0
    cost = each
    with np.errstate(all="ignore"):
        rates, residual = residual_at(stages)
        for _ in range(NEWTON_STEPS):
            before = float(np.max(np.abs(residual)))
            if not np.isfinite(before):
                return None, cost
            matrix = _stage_matrix(h, rates.f_x, count, size)
            right = np.concatenate([-residual.reshape(count, -1, 1), by_starts], axis=2)
            change = forward_sweep(solve_systems(matrix, right)).reshape(stages.shape)
            damping = 1.0
            for _ in range(HALVINGS):
                trial = stages + damping * change
                rates, residual = residual_at(trial)
                cost += each
                after = float(np.max(np.abs(residual)))
                if after <= before or after < 1e-10:
                    break
                damping *= 0.5
            else:
                return None, cost
            stages = trial
            size_of = float(np.max(np.abs(change) / (1.0 + np.abs(stages))))
            if damping == 1.0 and (size_of < 1e-7 and after < 1e-10):
                return IntegratedArcs(x_start, stages, h, rates), cost
    return None, cost


def explicit_stages(
    dynamics: Dynamics, x_start: Array, u: Array, modes: IntArray, h: Array
) -> Array:
    """Stages of a motion by explicit integration step by step, as an initial guess.

    Args:
        dynamics: Equations of motion.
        x_start: State at the start, shape (2n,).
        u: Torques of the steps, shape (M, n) [N m or N].
        modes: Modes of the joints on the steps, shape (M, n); see
            :func:`~tominpmp.exact.held_joints.differentiate_rates`.
        h: Lengths of the steps [s], shape (M,).

    Returns:
        Stages, shape (M, 3, 2n); NaN if explicit integration diverges.
    """
    out = np.empty((h.size, STAGES, x_start.size))
    x = x_start
    s = NODES[:, None]
    for i, step in enumerate(h.tolist()):
        torque, mode = u[i : i + 1], modes[i : i + 1]

        def rate(state: Array, torque: Array = torque, mode: IntArray = mode) -> Array:
            if not mode.any():
                rates = dynamics.forward(state[None], torque)
            else:
                rates = differentiate_rates(dynamics, state[None], torque, mode).f
            return np.asarray(rates[0])

        with np.errstate(all="ignore"):
            # Classical Runge-Kutta step of order 4, with cubic Hermite interpolation.
            k1 = rate(x)
            k2 = rate(x + 0.5 * step * k1)
            k3 = rate(x + 0.5 * step * k2)
            k4 = rate(x + step * k3)
            end = x + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            if not np.all(np.isfinite(end)):
                return np.full_like(out, np.nan)
            out[i] = (
                x
                + (3.0 * s**2 - 2.0 * s**3) * (end - x)
                + step * s * (1.0 - s) * ((1.0 - s) * k1 - s * k4)
            )
        x = end
    return out


def _stage_matrix(h: Array, f_x: Array, count: int, size: int) -> Array:
    """Jacobians of the step equations by the stages, shape (M, 3 s, 3 s)."""
    blocks = f_x.reshape(count, STAGES, size, size)
    coupling = WEIGHTS[None, :, None, :, None] * np.moveaxis(blocks, 1, 2)[:, None]
    coupling = coupling.reshape(count, STAGES * size, STAGES * size)
    return np.asarray(np.eye(STAGES * size) - h[:, None, None] * coupling)


def _by_starts(count: int, size: int) -> Array:
    """Negative Jacobians of the step equations by the starts, shape (M, 3 s, s)."""
    block = np.tile(np.eye(size), (STAGES, 1))
    return np.broadcast_to(block, (count, STAGES * size, size))
