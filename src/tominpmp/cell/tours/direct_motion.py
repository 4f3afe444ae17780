"""Motions between two configurations at rest that the joints make on their own.

Every joint speeds up, runs and slows down so that all arrive together, in the least
time that limits of speed and acceleration allow: no motion beats it. Where torques and
obstacles do not forbid it, which a replay tells, it is the fastest there is, and no
planning is needed.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.cell.tours.joint_times import JointTimes
from tominpmp.dynamics import RobotDynamics
from tominpmp.problem import Problem
from tominpmp.trajectory import Trajectory

# Ways below this are none [rad or m], and shares of the duration that are the same.
NO_WAY = 1e-9
SAME = 1e-9


def direct_motion(problem: Problem) -> Trajectory | None:
    """Make the fastest motion that limits of speed and acceleration allow.

    Args:
        problem: A problem from rest to a configuration at rest.

    Returns:
        The motion, with a constant acceleration on each interval; None where it would
        jump in velocity, or accelerations may not jump, or there is no way to go.
    """
    limits, goal = problem.motion_limits, problem.goal.configuration
    if goal is None or problem.segments or (limits is not None and limits.continuous):
        return None
    times, way = JointTimes.of(problem), goal - problem.q_start
    far = np.abs(way)
    moves = far > NO_WAY
    T = float(times.between(problem.q_start, goal))
    sudden = moves & ~np.isfinite(times.acceleration)
    if not np.any(moves) or np.any(sudden) or not 0.0 < T < np.inf:
        return None
    ramp = _ramps(times, far, T)
    t = np.unique(np.concatenate([[0.0, T], ramp, T - ramp]))
    t = t[np.append(True, np.diff(t) > SAME * T)]
    t[-1] = T
    speed = way / (T - ramp)
    q, v = _states(t, T, ramp, speed)
    q += problem.q_start
    q[-1] = goal
    middle = 0.5 * (t[1:] + t[:-1])[:, None]
    a = np.where(middle < ramp, 1.0, np.where(middle > T - ramp, -1.0, 0.0))
    a = a * speed / ramp
    dynamics = RobotDynamics(problem.robot).inverse
    joints = problem.robot.joint_names
    motion = Trajectory(joints, t, q, v, np.zeros_like(q), a=a)
    return motion.with_torques(dynamics)


def _ramps(times: JointTimes, far: Array, T: float) -> Array:
    """How long each joint speeds up, shape (n,) [s]: all alike if that is possible.

    Then the way is a straight line. The longer the ramp, the less acceleration it
    takes, up to half of the duration.
    """
    run = np.where(np.isfinite(times.velocity), far / times.velocity, 0.0)
    own = np.minimum(T - run, 0.5 * T)
    common = float(np.min(own))
    needed = far / (common * (T - common))
    if np.all(needed <= times.acceleration * (1.0 + 1e-9)):
        return np.full_like(far, common)
    return np.asarray(own)


def _states(t: Array, T: float, ramp: Array, speed: Array) -> tuple[Array, Array]:
    """Ways and velocities at times, shapes (m, n)."""
    t = t[:, None]
    first = np.minimum(t, ramp)
    run = np.clip(t - ramp, 0.0, T - 2.0 * ramp)
    last = np.clip(t - (T - ramp), 0.0, ramp)
    way = 0.5 * first**2 / ramp + run + last - 0.5 * last**2 / ramp
    return way * speed, (first - last) / ramp * speed
