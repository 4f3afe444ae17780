r"""Equations of motion with some joints held at constant velocity.

A joint h that moves at its speed limit has zero acceleration. One torque f, mostly the
torque of the joint itself, follows from this condition; the accelerations of the other
joints follow from their torques:

.. math:: \tau(q, v, a) = u, \qquad a_h = 0, \qquad u_k \text{ given for } k \ne f.

If the torque of the joint itself is at its limit, the torque of another joint can hold
it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.dynamics import Dynamics

# Modes of a joint: its velocity is held constant (HOLDS), its torque follows from the
# constant velocity of some joint (FOLLOWS), or both (their sum).
HOLDS, FOLLOWS = 1, 2


class HeldRates(NamedTuple):
    """State derivatives and torques at m states, with their partial derivatives.

    Attributes:
        f: Derivatives dx/dt of x = (q, v), shape (m, 2n).
        f_x: Derivatives of f by x, shape (m, 2n, 2n).
        f_u: Derivatives of f by given torques, shape (m, 2n, n); zero for torques that
            follow.
        tau: Torques of all joints, shape (m, n) [N m or N].
        tau_x: Derivatives of tau by x, shape (m, n, 2n).
        tau_u: Derivatives of tau by given torques, shape (m, n, n).
    """

    f: Array
    f_x: Array
    f_u: Array
    tau: Array
    tau_x: Array
    tau_u: Array


def differentiate_rates(
    dynamics: Dynamics, x: Array, u: Array, modes: IntArray
) -> HeldRates:
    """State derivatives and torques, with their partial derivatives.

    Args:
        dynamics: Equations of motion.
        x: States (q, v), shape (m, 2n).
        u: Torques, shape (m, n); torques that follow are ignored.
        modes: HOLDS for joints with constant velocity, FOLLOWS for joints whose torque
            follows, their sum for both, 0 for other joints, shape (m, n); each row has
            equal numbers of both.
    """
    count, n = u.shape
    if not np.any(modes):
        moved = dynamics.forward_jacobians(x, u)
        tau_u = np.broadcast_to(np.eye(n), (count, n, n))
        return HeldRates(*moved, u, np.zeros((count, n, 2 * n)), tau_u)
    q, v = x[:, :n], x[:, n:]
    holds, follows = (modes & HOLDS) != 0, (modes & FOLLOWS) != 0
    # In each state, the torque of the k-th joint that follows holds the k-th held one.
    (state, held), (_, follower) = np.nonzero(holds), np.nonzero(follows)
    still = dynamics.inverse_jacobians(q, v, np.zeros_like(u))
    # The unknowns are the accelerations of free joints, and in the places of the held
    # joints the torques that follow.
    matrix = np.where(holds[:, None], 0.0, still.tau_a)
    matrix[state, follower, held] = -1.0
    drive = np.where(follows, 0.0, u) - still.tau
    found = np.linalg.solve(matrix, drive[..., None])[..., 0]
    a, tau = np.where(holds, 0.0, found), u.copy()
    tau[state, follower] = found[state, held]
    by = dynamics.inverse_jacobians(q, v, a)
    known = np.where(follows[:, None], 0.0, np.eye(n))
    right = np.concatenate([-by.tau_q, -by.tau_v, known], axis=2)
    slopes, by_tau = np.linalg.solve(matrix, right), np.zeros((count, n, 3 * n))
    by_tau[:, :, 2 * n :] = known
    by_tau[state, follower] = slopes[state, held]
    slopes[state, held] = 0.0
    f_x, f_u = np.zeros((count, 2 * n, 2 * n)), np.zeros((count, 2 * n, n))
    f_x[:, :n, n:] = np.eye(n)
    f_x[:, n:], f_u[:, n:] = slopes[..., : 2 * n], slopes[..., 2 * n :]
    f = np.concatenate([v, a], axis=1)
    return HeldRates(f, f_x, f_u, tau, by_tau[..., : 2 * n], by_tau[..., 2 * n :])
