"""The time that a joint needs for its way at its speed limit, ramps at both ends.

That is no proof: the ramps are those that all torques together can bring about where
the motion begins and ends, and it moves on while they last. Where the ramps are short
it is within thousandths of what a motion can reach, and tells when nothing is left to
be gained; where they are long, they are left out.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.problem_functions import ProblemFunctions

# Joints that move no farther during their ramp are where they were, near enough [rad].
SHORT = 0.05
# Joints faster than this share of their limit at an end have no ramp there.
AT_REST = 1e-6


def time_at_speed_limits(system: ProblemFunctions, motion: Trajectory) -> float:
    """Time that joints need for their ways between the ends of a motion, the longest.

    Args:
        system: The problem.
        motion: A motion that solves it.

    Returns:
        The time [s].
    """
    limit = system.problem.robot.limits.velocity
    way = motion.q[-1] - motion.q[0]
    ramps = np.zeros((2, limit.size))
    for index, (end, sign) in enumerate(((0, 1.0), (-1, -1.0))):
        if np.all(np.abs(motion.v[end]) <= AT_REST * limit):
            most = _accelerations(system, motion.q[end], sign * np.sign(way))
            ramps[index] = _ramp(limit, most)
    moved = ramps * limit
    # The mean speed of a ramp is half the limit.
    short = np.all(moved <= SHORT * system.step_scale, axis=0)
    lost = np.where(short & (moved.sum(axis=0) <= np.abs(way)), 0.5 * ramps.sum(0), 0.0)
    return float(np.max(np.abs(way) / limit + lost))


def _accelerations(system: ProblemFunctions, q: Array, way: Array) -> Array:
    """Largest acceleration of each joint its way, from rest, all torques helping, (n,).

    Those that no torque can bring about are zero.
    """
    zero = np.zeros((1, q.size))
    there = system.dynamics.inverse_jacobians(q[None], zero, zero)
    held, mobility = there.tau[0], np.linalg.pinv(there.tau_a[0])
    drive = mobility @ (system.effort_middle - held)
    return np.asarray(way * drive + np.abs(mobility) @ system.effort_half)


def _ramp(limit: Array, most: Array) -> Array:
    """Time from rest to the speed limit at the largest acceleration [s], (n,)."""
    return np.asarray(limit / np.maximum(most, 1e-12))
