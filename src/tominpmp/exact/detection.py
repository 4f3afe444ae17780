"""Detection of arcs in a motion: a first guess of their structure and lengths."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exact.structure import Arcs, read_arcs
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.problem_functions import ProblemFunctions

# Torques at the ends of an interval, where they may jump, are sampled at this distance
# inside the interval, as a share of it.
INSIDE = 1e-6


def arcs_of(system: ProblemFunctions, trajectory: Trajectory) -> Arcs:
    """Approximate arcs of a motion.

    The torque of an interval is the larger one of the torques at its ends: with
    constant accelerations, a torque reaches its limit at one end only.
    """
    t = trajectory.t
    h = np.diff(t)
    ends = [trajectory(t[:-1] + INSIDE * h).u, trajectory(t[1:] - INSIDE * h).u]
    first, last = ((u - system.effort_middle) / system.effort_half for u in ends)
    shares = np.where(np.abs(first) >= np.abs(last), first, last)
    driven = np.isin(np.arange(system.n), system.driven_joints)
    speeds = trajectory.v / system.problem.robot.limits.velocity
    return read_arcs(h, np.clip(shares, -1.0, 1.0), speeds, driven)


def constant_signs(system: ProblemFunctions, trajectory: Trajectory) -> Array | None:
    """Velocity signs of joints with dry friction throughout a motion, shape (n,).

    The signs are 1 or -1, and 0 for joints that rest or have no dry friction. None if a
    joint with dry friction reverses.
    """
    dry, ways = system.problem.robot.friction > 0.0, trajectory.turns.first
    forth, back = np.any(ways > 0.0, axis=0), np.any(ways < 0.0, axis=0)
    turns = trajectory.turns.of_joints(dry).size or np.any(dry & forth & back)
    return None if turns else np.where(dry, 1.0 * forth - 1.0 * back, 0.0)
