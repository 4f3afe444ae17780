r"""Costates, integrated backwards along a motion.

.. math:: \dot p = -f_x^T p

between the instants at which a state limit is active: the adjoint equation of the
paper's differentials (equations 12 and 13) in real time. At these instants the costate
falls by the multiplier times the gradient of the limit. The multipliers of the linear
program give the costate without this equation: the program uses accelerations and the
inverse dynamics, this equation torques and the forward dynamics. Each checks the other.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.certificate.dual_program import PLACES, DualSolution
from tominpmp.certificate.motion import Motion
from tominpmp.verification.replay import Replay

# Steps of an interval: a step ends wherever costates may jump.
STEPS = PLACES


def integrate_costates(
    motion: Motion,
    found: DualSolution,
    replay: Replay | None = None,
    *,
    anew: bool = True,
) -> Array:
    """Integrate the adjoint equation backwards from node to node.

    Args:
        motion: The motion.
        found: Its multipliers, and the costate at the end.
        replay: Replay of the torques, whose states the equation is integrated along;
            None takes the states of the plan.
        anew: Whether each interval begins with the costate of the program at its end,
            else with the integrated costate. Where an arm is unstable, errors of an
            integration from one end to the other grow by powers of ten.

    Returns:
        Costates just after the start and just before the nodes 1 to N, shape
        (N + 1, 2 n).
    """
    changes, n = motion.changes, motion.changes.n
    shares = (np.arange(STEPS) + 0.5) / STEPS
    times = (changes.t[:-1, None] + changes.h[:, None] * shares).ravel()
    state = motion.trajectory(times)
    q, v = state.q, state.v
    if replay is not None and replay.complete:
        q = np.stack([np.interp(times, replay.t, x) for x in replay.q.T], axis=1)
        v = np.stack([np.interp(times, replay.t, x) for x in replay.v.T], axis=1)
    x = np.concatenate([q, v], axis=1)
    # Torques less dry friction.
    trajectory, robot = motion.trajectory, motion.task.problem.robot
    if trajectory.inverse_dynamics is None:
        left = state.u - robot.friction * trajectory.turns.at(times)
    else:
        left = motion.task.dynamics.inverse(state.q, state.v, state.a)
    slope = motion.task.dynamics.forward_jacobians(x, left).f_x
    steps = _transitions(slope, np.repeat(changes.h / STEPS, STEPS))
    steps = steps.reshape(changes.N, STEPS, 2 * n, 2 * n)
    out = np.empty((changes.N + 1, 2 * n))
    p = found.costates[-1].copy()
    for k in range(changes.N - 1, -1, -1):
        out[k + 1] = p
        if anew:
            p = found.costates[k].copy()
        for i in range(STEPS - 1, -1, -1):
            p = p @ steps[k, i]
            if i:
                p = p + found.pushes[k, i]
        if k:
            p = p + found.jumps[k - 1]
    out[0] = p
    return out


def _transitions(slope: Array, h: Array) -> Array:
    """State transition matrices of steps by Radau IIA of order 3, shape (m, k, k).

    Args:
        slope: f_x in the middle of each step, shape (m, k, k).
        h: Lengths of the steps [s], shape (m,).
    """
    z = slope * h[:, None, None]
    eye = np.eye(slope.shape[1])
    return np.asarray(np.linalg.solve(eye - 2 / 3 * z + z @ z / 6, eye + z / 3))


def disagreement(found: DualSolution, integrated: Array) -> float:
    """Largest difference between costates, relative to the largest costate.

    Args:
        found: Costates of the linear program.
        integrated: Costates of the adjoint equation, shape (N + 1, 2 n).
    """
    scale = found.state_scale
    largest = float(np.max(np.abs(found.costates * scale), initial=0.0))
    apart = (found.costates - integrated[1:]) * scale
    return float(np.max(np.abs(apart), initial=0.0)) / max(largest, 1e-300)
