"""Rough arcs and states, read off any motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tominpmp.arrays import Array
from tominpmp.refinement.arcs import Arcs, read_arcs
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.controls import driven_joints
from tominpmp.transcription.system import System

# How far inside an interval its torque is looked at: it may jump at the ends.
INSIDE = 1e-6


def arcs_of(system: System, trajectory: Trajectory) -> Arcs:
    """Arcs of a motion, roughly.

    The torque of an interval is that of the end at which it is larger: with constant
    accelerations it comes to its limit at one of them only.

    Args:
        system: Limits.
        trajectory: The motion.
    """
    t = trajectory.t
    h = np.diff(t)
    ends = [trajectory(t[:-1] + INSIDE * h).u, trajectory(t[1:] - INSIDE * h).u]
    first, last = ((u - system.effort_middle) / system.effort_half for u in ends)
    shares = np.where(np.abs(first) >= np.abs(last), first, last)
    driven = np.zeros(system.n, dtype=bool)
    driven[driven_joints(system)] = True
    speeds = trajectory.v / system.problem.robot.limits.velocity
    return read_arcs(h, np.clip(shares, -1.0, 1.0), speeds, driven)


def states_of(trajectory: Trajectory) -> Callable[[Array], Array]:
    """States (q, v) of a motion at times, shape (m,) to (m, 2n)."""

    def states(times: Array) -> Array:
        state = trajectory(times)
        return np.concatenate([state.q, state.v], axis=1)

    return states
