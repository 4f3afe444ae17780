"""Where joints with dry friction turn: their torques jump there."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.trajectory import Trajectory


def torque_breaks(trajectory: Trajectory, friction: Array) -> Array:
    """Times between which the torques of a motion are smooth [s].

    Args:
        trajectory: The motion.
        friction: Dry friction of its joints, shape (n,) [N m or N].

    Returns:
        Its nodes, and where joints with friction turn between them if torques follow
        from the motion; in the order of time.
    """
    if trajectory.inverse_dynamics is None:
        return trajectory.t
    return np.union1d(trajectory.t, reversals(trajectory, friction))


def reversals(trajectory: Trajectory, friction: Array) -> Array:
    """Times at which joints with dry friction turn, away from the nodes [s].

    Args:
        trajectory: The motion.
        friction: Dry friction of its joints, shape (n,) [N m or N].
    """
    if not np.any(friction > 0.0):
        return np.zeros(0)
    return trajectory.turns.of_joints(friction > 0.0)
