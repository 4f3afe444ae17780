r"""Equations of motion with some joints held at a constant velocity.

A joint that runs at its speed limit has no acceleration; the torque for that follows,
and the other joints move as their torques and this acceleration demand:

.. math:: M_{ff} \dot v_f = u_f - \tau_f(q, v, 0), \qquad \dot v_h = 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.dynamics import Dynamics


class Rates(NamedTuple):
    """State derivatives and torques, with their partial derivatives, one row a state.

    Attributes:
        f: dx/dt with x = (q, v), shape (m, 2n).
        f_x: Shape (m, 2n, 2n).
        f_u: Shape (m, 2n, n); zero for the torques of held joints.
        tau: Torques of all joints, shape (m, n) [N m or N].
        tau_x: Shape (m, n, 2n).
        tau_u: Shape (m, n, n).
    """

    f: Array
    f_x: Array
    f_u: Array
    tau: Array
    tau_x: Array
    tau_u: Array


def differentiate_rates(
    dynamics: Dynamics, x: Array, u: Array, held: BoolArray
) -> Rates:
    """State derivatives with their partial derivatives.

    Args:
        dynamics: Equations of motion.
        x: States (q, v), shape (m, 2n).
        u: Torques, shape (m, n); those of held joints are ignored.
        held: Which joints keep their velocity, shape (m, n).
    """
    count, n = u.shape
    some = np.any(held, axis=1)
    if not np.any(some):
        by = dynamics.forward_jacobians(x, u)
        tau_u = np.broadcast_to(np.eye(n), (count, n, n))
        return Rates(*by, u, np.zeros((count, n, 2 * n)), tau_u)
    out = Rates(
        np.empty((count, 2 * n)),
        np.empty((count, 2 * n, 2 * n)),
        np.empty((count, 2 * n, n)),
        np.empty((count, n)),
        np.empty((count, n, 2 * n)),
        np.empty((count, n, n)),
    )
    patterns, which = np.unique(held, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        rows = np.flatnonzero(which.ravel() == number)
        if pattern.any():
            part = _held_rates(dynamics, x[rows], u[rows], pattern)
        else:
            none = np.zeros((rows.size, n), dtype=bool)
            part = differentiate_rates(dynamics, x[rows], u[rows], none)
        for target, value in zip(out, part, strict=True):
            target[rows] = value
    return out


def _held_rates(dynamics: Dynamics, x: Array, u: Array, held: BoolArray) -> Rates:
    """Rates of rows of which the same joints are held."""
    count, n = u.shape
    q, v = x[:, :n], x[:, n:]
    free = np.flatnonzero(~held)
    a = np.zeros_like(u)
    still = dynamics.inverse_jacobians(q, v, a)
    mass = still.tau_a[:, free[:, None], free]
    drive = (u - still.tau)[:, free, None]
    a[:, free] = np.linalg.solve(mass, drive)[..., 0]
    by = dynamics.inverse_jacobians(q, v, a)
    tau_x = np.concatenate([by.tau_q, by.tau_v], axis=2)
    a_x, a_u = np.zeros((count, n, 2 * n)), np.zeros((count, n, n))
    a_x[:, free] = -np.linalg.solve(mass, tau_x[:, free])
    a_u[:, free[:, None], free] = np.linalg.inv(mass)
    f_x, f_u = np.zeros((count, 2 * n, 2 * n)), np.zeros((count, 2 * n, n))
    f_x[:, :n, n:] = np.eye(n)
    f_x[:, n:], f_u[:, n:] = a_x, a_u
    return Rates(
        np.concatenate([v, a], axis=1),
        f_x,
        f_u,
        by.tau,
        tau_x + by.tau_a @ a_x,
        by.tau_a @ a_u,
    )
