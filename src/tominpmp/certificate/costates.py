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
    motion: Motion, found: DualSolution, replay: Replay | None = None
) -> Array:
    """Integrate the adjoint equation backwards over each interval.

    Each interval begins with the costate of the program at its end. Where an arm is
    unstable, errors of an integration from one end of the motion to the other grow by
    powers of ten.

    Args:
        motion: The motion.
        found: Its multipliers, and the costates just before the nodes.
        replay: Replay of the torques, whose states the equation is integrated along;
            None takes the states of the plan.

    Returns:
        Costates just after the start and just before the nodes 1 to N - 1, shape
        (N, 2 n).
    """
    n, changes = motion.changes.n, motion.changes
    shares = (np.arange(STEPS) + 0.5) / STEPS
    times, q, v, a, _ = motion.states(motion.instants(*shares.tolist()))
    left = motion.system.dynamics.inverse(q, v, a)  # torques less dry friction
    if replay is not None and replay.complete:
        q = np.stack([np.interp(times, replay.t, x) for x in replay.q.T], axis=1)
        v = np.stack([np.interp(times, replay.t, x) for x in replay.v.T], axis=1)
    x = np.concatenate([q, v], axis=1)
    slope = motion.system.dynamics.forward_jacobians(x, left).f_x
    steps = _transitions(slope, np.repeat(changes.h / STEPS, STEPS))
    steps = steps.reshape(changes.N, STEPS, 2 * n, 2 * n)
    p = found.costates
    for i in range(STEPS - 1, -1, -1):
        p = np.einsum("ki,kij->kj", p, steps[:, i]) + found.falls[:, i]
    p[1:] += found.falls[:-1, STEPS]
    return np.asarray(p)


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
        integrated: Costates of the adjoint equation, shape (N, 2 n).
    """
    scale = found.state_scale
    largest = float(np.max(np.abs(found.costates * scale), initial=0.0))
    apart = (found.costates[:-1] - integrated[1:]) * scale
    return float(np.max(np.abs(apart), initial=0.0)) / max(largest, 1e-300)
