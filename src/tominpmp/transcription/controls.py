"""Piecewise-constant torques (the paper's equation 16): shares, jumps, first values.

They are what dry friction leaves of the torques of the motors: their limits depend on
which way a joint moves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.friction import NEAR, OVERLOAD, Ways, interval_signs
from tominpmp.dynamics import directions
from tominpmp.motion.trajectory import Trajectory, reversals
from tominpmp.transcription.problem_functions import ProblemFunctions


def driven_joints(system: ProblemFunctions) -> IntArray:
    """Indices of the joints whose torque is free; the others have none to choose."""
    limits = system.problem.robot.limits
    return np.flatnonzero(limits.effort_upper > limits.effort_lower)


def torque_shares(system: ProblemFunctions, u: Array) -> Array:
    """Torques as shares of their limits, brought within them, shape (N, n)."""
    limits, friction = system.problem.robot.limits, system.problem.robot.friction
    low, high = limits.effort_lower - friction, limits.effort_upper + friction
    if system.ways is not None:
        low = limits.effort_lower - system.resistance
        high = limits.effort_upper - system.resistance
    u = np.clip(u, low, high)
    return np.asarray((u - system.effort_middle) / system.effort_half)


def net_torque(system: ProblemFunctions, u: Array, v: Array) -> Array:
    """What dry friction leaves of the torques of motors, shape (N, n) [N m or N]."""
    if system.friction is None:
        return u
    return np.asarray(u - system.problem.robot.friction * directions(v, 0.0 * v))


def share_steps(
    system: ProblemFunctions, shares: Array, largest: Array, ways: Ways | None = None
) -> tuple[Array, Array]:
    """Smallest and largest steps of torque shares.

    Args:
        system: Limits.
        shares: Torques as shares of their limits, shape (N, n).
        largest: Largest step of each joint, in shares, shape (n,).
        ways: Which way joints with dry friction move on the intervals.

    Returns:
        Steps, each of shape (N, n); zero for joints without a motor.
    """
    driven = driven_joints(system)
    lower, upper = np.zeros_like(shares), np.zeros_like(shares)
    here = shares[:, driven]
    low, high = np.full_like(here, -1.0), np.ones_like(here)
    if ways is not None:
        low, high = ways.lower[:, driven], ways.upper[:, driven]
    lower[:, driven] = np.clip(low - here, -largest[driven], 0.0)
    upper[:, driven] = np.clip(high - here, 0.0, largest[driven])
    return lower, upper


def torque_jumps(system: ProblemFunctions, count: int) -> sp.csr_matrix:
    """Jumps between neighbouring intervals in full ranges, from torque shares.

    Matrix of shape ((count - 1) k, count n) for k joints with motors.
    """
    difference = sp.diags([-0.5, 0.5], [0, 1], shape=(count - 1, count))
    pick = sp.identity(system.n, format="csr")[driven_joints(system)]
    return sp.csr_matrix(sp.kron(difference, pick))


def driving_torque(system: ProblemFunctions, q: Array, v: Array, h: Array) -> Array:
    """Torques that drive a motion, in the middle of its intervals, shape (N, n).

    They are not brought within limits. Positions and velocities are those at the nodes,
    shape (N + 1, n).
    """
    step = h[:, None]
    middle = 0.5 * (q[:-1] + q[1:])
    speed, acceleration = np.diff(q, axis=0) / step, np.diff(v, axis=0) / step
    return system.dynamics.inverse(middle, speed, acceleration)


def first_ways(system: ProblemFunctions, v: Array) -> Ways:
    """Which way joints move on intervals, from velocities at the nodes, (N, n)."""
    assert system.friction is not None  # noqa: S101
    sign, change = interval_signs(v)
    ways = Ways.of(system.friction, sign)
    return replace(ways, both=change & (system.friction > 0.0))


def turned_ways(
    system: ProblemFunctions, ways: Ways | None, v: Array, shares: Array
) -> tuple[Ways, Array] | None:
    """Which way joints move on intervals of a motion, if that makes a difference.

    Args:
        system: The problem.
        ways: Which way they were taken to move on N intervals; None if no friction
            was reckoned with.
        v: Velocities at the nodes, shape (N + 1, n) [rad/s or m/s].
        shares: Torques without friction as shares of their limits, shape (N, n).

    Returns:
        Their ways, and the torques brought within their limits; None if the ways that
        they were taken to move will do.
    """
    if ways is None:
        ways = first_ways(system, v)
        return ways, np.clip(shares, ways.lower, ways.upper)
    sign, change = interval_signs(v)
    here = ways.friction * np.where(change, 1.0, sign)
    beyond = np.abs(shares + here) > 1.0 + OVERLOAD
    beyond |= change & (np.abs(shares - here) > 1.0 + OVERLOAD)
    at_limit = np.abs(shares + ways.load) > 1.0 - NEAR
    apart = ((sign != ways.sign) | change) & ~ways.both & (ways.friction > 0.0)
    wrong = apart & (beyond | at_limit)
    if not wrong.any():
        return None
    new = ways.turned(sign, wrong)
    # Where a joint turns within an interval its torque has to do for either way.
    both = new.both | (change & (ways.friction > 0.0))
    new = Ways(new.friction, np.where(both, 0.0, new.sign), both, new.turns)
    return new, np.clip(shares, new.lower, new.upper)


def motor_torques(
    system: ProblemFunctions, motion: Trajectory, ways: Ways | None
) -> Trajectory:
    """Torques of the motors for a motion with given torques without friction.

    Args:
        system: The problem.
        motion: The motion, joined by cubic polynomials between its nodes.
        ways: Which way joints with dry friction move on its intervals; None takes it
            from the motion.

    Returns:
        The motion with nodes where joints with friction turn.
    """
    friction = system.problem.robot.friction
    if system.friction is None:
        return motion
    t = np.sort(np.concatenate([motion.t, reversals(motion, friction)]))
    middle = 0.5 * (t[1:] + t[:-1])
    state = motion(middle)
    sign = motion.turns.at(middle)
    if ways is not None:
        index = np.searchsorted(motion.t, middle) - 1
        sign = np.where(ways.both[index], sign, ways.sign[index])
    u = state.u + friction * sign
    nodes = motion(t)
    u = np.vstack([u, u[-1:]])
    holding = motion.holding
    return Trajectory(motion.joint_names, t, nodes.q, nodes.v, u, holding=holding)
