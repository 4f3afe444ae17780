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
from tominpmp.dynamics import Dynamics, ForwardJacobians
from tominpmp.exact.held_joints import HeldRates, differentiate_rates
from tominpmp.transcription.integrator import solve_steps

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
# Largest number of iterations of Newton's method.
NEWTON_STEPS = 12


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
    rates: HeldRates

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
        n, every = size // 2, STAGES * size
        weights = self.h[:, None, None] * WEIGHTS
        f, f_x, f_u = (
            part.reshape(count, STAGES, *part.shape[1:]) for part in self.rates[:3]
        )
        by_starts = np.broadcast_to(
            np.tile(np.eye(size), (STAGES, 1)), (count, every, size)
        )
        by_u = np.einsum("mij,mjab->miab", weights, f_u).reshape(count, every, n)
        by_h = (WEIGHTS @ f).reshape(count, every, 1)
        right = np.concatenate([by_starts, by_u, by_h], axis=2)
        coupling = np.einsum("mij,mjab->miajb", weights, f_x)
        matrix = np.eye(every) - coupling.reshape(count, every, every)
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
    """Integrate forward in M steps, by solving all steps at once from a guess.

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
    torque, mode = np.repeat(u, STAGES, axis=0), np.repeat(modes, STAGES, axis=0)
    cost = 0

    def rates(x: Array, torque: Array) -> ForwardJacobians:
        nonlocal cost
        cost += len(x)
        return ForwardJacobians(*differentiate_rates(dynamics, x, torque, mode)[:3])

    with np.errstate(all="ignore"):
        weights = h[:, None, None] * WEIGHTS
        stages, (found,) = solve_steps(rates, x_start, u, weights, guess, NEWTON_STEPS)
        if not found:
            return None, cost
        x = stages.reshape(len(torque), -1)
        solved = differentiate_rates(dynamics, x, torque, mode)
    return IntegratedArcs(x_start, stages, h, solved), cost + len(x)
