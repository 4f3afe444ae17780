"""Detection of arcs: rough arcs and states, read off any motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.dynamics import STANDSTILL
from tominpmp.exact.structure import Arcs, read_arcs
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.controls import driven_joints
from tominpmp.transcription.problem_functions import ProblemFunctions

# Where velocities are looked at, and what counts as turning, as a share of the largest.
LOOKS = 1001
TURNING = 1e-5
# How far inside an interval its torque is looked at: it may jump at the ends.
INSIDE = 1e-6


def arcs_of(system: ProblemFunctions, trajectory: Trajectory) -> Arcs:
    """Arcs of a motion, roughly.

    The torque of an interval is that of the end at which it is larger: with constant
    accelerations it comes to its limit at one of them only.
    """
    t = trajectory.t
    h = np.diff(t)
    ends = [trajectory(t[:-1] + INSIDE * h).u, trajectory(t[1:] - INSIDE * h).u]
    first, last = ((u - system.effort_middle) / system.effort_half for u in ends)
    shares = np.where(np.abs(first) >= np.abs(last), first, last)
    driven = np.isin(np.arange(system.n), driven_joints(system))
    speeds = trajectory.v / system.problem.robot.limits.velocity
    return read_arcs(h, np.clip(shares, -1.0, 1.0), speeds, driven)


def one_way(system: ProblemFunctions, trajectory: Trajectory) -> Array | None:
    """Which way joints with dry friction move all along a motion, shape (n,).

    1 or -1, 0 for joints that rest or have none; None if one of them turns.
    """
    times = np.linspace(0.0, trajectory.duration, LOOKS)
    v = replace(trajectory, inverse_dynamics=None)(times).v
    forth, back = np.max(v, axis=0), np.max(-v, axis=0)
    most = np.maximum(forth, back)
    turns = np.minimum(forth, back) > TURNING * np.max(most)
    dry = system.problem.robot.friction > 0.0
    if np.any(turns & dry):
        return None
    ways = np.where(forth > back, 1.0, -1.0)
    return np.where(dry & (most > STANDSTILL), ways, 0.0)


def without_friction(system: ProblemFunctions, trajectory: Trajectory) -> Trajectory:
    """A motion with the torques that dry friction leaves, on ways taken for granted."""
    if system.ways is None:
        return trajectory
    inverse = trajectory.inverse_dynamics
    return replace(
        trajectory,
        u=trajectory.u - system.resistance,
        inverse_dynamics=None if inverse is None else system.dynamics.inverse,
    )
