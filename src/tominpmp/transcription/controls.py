"""Piecewise-constant torques: shares of their limits, jumps, and torques for a path."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.transcription.system import System


def driven_joints(system: System) -> IntArray:
    """Indices of the joints whose torque is free; the others have none to choose."""
    limits = system.problem.robot.limits
    return np.flatnonzero(limits.effort_upper > limits.effort_lower)


def torque_shares(system: System, u: Array) -> Array:
    """Torques as shares of their limits, brought into [-1, 1], shape (N, n)."""
    limits = system.problem.robot.limits
    u = np.clip(u, limits.effort_lower, limits.effort_upper)
    return np.asarray((u - system.effort_middle) / system.effort_half)


def share_steps(system: System, shares: Array, largest: Array) -> tuple[Array, Array]:
    """Smallest and largest steps of torque shares.

    Args:
        system: Limits.
        shares: Torques as shares of their limits, shape (N, n).
        largest: Largest step of each joint, in shares, shape (n,).

    Returns:
        Steps, each of shape (N, n); zero for joints without a motor.
    """
    driven = driven_joints(system)
    lower, upper = np.zeros_like(shares), np.zeros_like(shares)
    here = shares[:, driven]
    lower[:, driven] = np.clip(-1.0 - here, -largest[driven], 0.0)
    upper[:, driven] = np.clip(1.0 - here, 0.0, largest[driven])
    return lower, upper


def torque_jumps(system: System, count: int) -> sp.csr_matrix:
    """Jumps between neighbouring intervals in full ranges, from torque shares.

    Args:
        system: Which joints have motors.
        count: Number of intervals.

    Returns:
        Matrix of shape ((count - 1) k, count n) for k joints with motors.
    """
    difference = sp.diags([-0.5, 0.5], [0, 1], shape=(count - 1, count))
    pick = sp.identity(system.n, format="csr")[driven_joints(system)]
    return sp.csr_matrix(sp.kron(difference, pick))


def driving_torque(system: System, q: Array, v: Array, h: Array) -> Array:
    """Torques that drive a motion, in the middle of its intervals.

    Args:
        system: Dynamics.
        q: Positions at the nodes, shape (N + 1, n) [rad or m].
        v: Velocities there, shape (N + 1, n).
        h: Lengths of the intervals, shape (N,) [s].

    Returns:
        Torques, shape (N, n), whether within their limits or not.
    """
    step = h[:, None]
    middle = 0.5 * (q[:-1] + q[1:])
    speed, acceleration = np.diff(q, axis=0) / step, np.diff(v, axis=0) / step
    return system.dynamics.inverse(middle, speed, acceleration)
