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
        by = dynamics.forward_jacobians(x, u)
        tau_u = np.broadcast_to(np.eye(n), (count, n, n))
        return HeldRates(*by, u, np.zeros((count, n, 2 * n)), tau_u)
    patterns, which = np.unique(modes, axis=0, return_inverse=True)
    if len(patterns) > 1:
        # States with equal modes are solved together, and then restored to their order.
        rows = [np.flatnonzero(which.ravel() == k) for k in range(len(patterns))]
        parts = [differentiate_rates(dynamics, x[r], u[r], modes[r]) for r in rows]
        every, back = zip(*parts, strict=True), np.argsort(np.concatenate(rows))
        return HeldRates(*(np.concatenate(part)[back] for part in every))
    return _held_rates(dynamics, x, u, patterns[0])


def _held_rates(dynamics: Dynamics, x: Array, u: Array, modes: IntArray) -> HeldRates:
    """Rates of states at which the same joints are held."""
    count, n = u.shape
    q, v = x[:, :n], x[:, n:]
    free = np.flatnonzero((modes & HOLDS) == 0)
    follows = np.flatnonzero((modes & FOLLOWS) != 0)
    known = np.flatnonzero((modes & FOLLOWS) == 0)
    still = dynamics.inverse_jacobians(q, v, np.zeros_like(u))
    # The unknowns are the accelerations of free joints and the torques that follow.
    matrix = np.zeros((count, n, n))
    matrix[:, :, : free.size] = still.tau_a[:, :, free]
    matrix[:, follows, free.size + np.arange(follows.size)] = -1.0
    drive = -still.tau
    drive[:, known] += u[:, known]
    found = np.linalg.solve(matrix, drive[..., None])[..., 0]
    a, tau = np.zeros_like(u), u.copy()
    a[:, free], tau[:, follows] = found[:, : free.size], found[:, free.size :]
    by = dynamics.inverse_jacobians(q, v, a)
    slope = np.concatenate([by.tau_q, by.tau_v], axis=2)
    by_x = np.linalg.solve(matrix, -slope)
    by_u = np.linalg.solve(
        matrix, np.broadcast_to(np.eye(n)[:, known], (count, n, known.size))
    )
    f_x, f_u = np.zeros((count, 2 * n, 2 * n)), np.zeros((count, 2 * n, n))
    tau_x, tau_u = np.zeros((count, n, 2 * n)), np.zeros((count, n, n))
    f_x[:, :n, n:] = np.eye(n)
    f_x[:, n + free] = by_x[:, : free.size]
    f_u[:, (n + free)[:, None], known] = by_u[:, : free.size]
    tau_x[:, follows] = by_x[:, free.size :]
    tau_u[:, follows[:, None], known] = by_u[:, free.size :]
    tau_u[:, known, known] = 1.0
    return HeldRates(np.concatenate([v, a], axis=1), f_x, f_u, tau, tau_x, tau_u)
