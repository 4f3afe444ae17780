"""Where joints with dry friction turn: their torques jump there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.trajectory import Trajectory

# Instants of each interval at which velocities are compared, and bisections between.
LOOKS = 8
BISECTIONS = 50
# Reversals closer than this to a node, or to each other, are there [shares of T].
SAME = 1e-9


def torque_breaks(trajectory: Trajectory, friction: Array) -> Array:
    """Times between which the torques of a motion are smooth [s].

    Args:
        trajectory: The motion.
        friction: Dry friction of its joints, shape (n,) [N m or N].

    Returns:
        Its nodes, and where joints with friction turn between them if torques follow
        from the motion; in the order of time.
    """
    t = trajectory.t
    if trajectory.inverse_dynamics is None:
        return t
    return np.sort(np.concatenate([t, reversals(trajectory, friction)]))


def reversals(trajectory: Trajectory, friction: Array) -> Array:
    """Times at which joints with dry friction turn, away from the nodes [s].

    Args:
        trajectory: The motion.
        friction: Dry friction of its joints, shape (n,) [N m or N].
    """
    t = trajectory.t
    joints = np.flatnonzero(friction > 0.0)
    if not joints.size:
        return np.zeros(0)
    motion = replace(trajectory, inverse_dynamics=None)

    def speeds(times: Array) -> Array:
        return np.asarray(motion(times).v)

    inside = (np.arange(LOOKS) + 0.5) / LOOKS
    times = (t[:-1, None] + np.diff(t)[:, None] * inside).ravel()
    sign = np.sign(speeds(times)[:, joints])
    row, joint = np.nonzero(sign[1:] * sign[:-1] < 0.0)
    low, high = times[row], times[row + 1]
    for _ in range(BISECTIONS if row.size else 0):
        middle = 0.5 * (low + high)
        after = speeds(middle)[np.arange(row.size), joints[joint]]
        early = after * sign[row, joint] > 0.0
        low, high = np.where(early, middle, low), np.where(early, high, middle)
    found = np.sort(0.5 * (low + high))
    apart = SAME * trajectory.duration
    found = found[np.min(np.abs(found[:, None] - t), axis=1, initial=np.inf) > apart]
    return np.asarray(found[np.diff(found, prepend=-np.inf) > apart])
