"""Dry friction along motions that are judged."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.dynamics import STANDSTILL, RobotDynamics, directions
from tominpmp.robot import Robot
from tominpmp.trajectory import State, Trajectory


def friction_at_ends(
    robot: Robot, trajectory: Trajectory, t: Array, ends: State
) -> Array:
    """Dry friction at both ends of intervals.

    Where a joint sets out or stops there, its velocity is rounding: the way it goes is
    that in the middle.

    Args:
        robot: The robot.
        trajectory: Its motion.
        t: Ends of the intervals, shape (N + 1,) [s].
        ends: The motion just after the beginning and just before the end of each
            interval, 2 N rows.

    Returns:
        Friction that the motors overcome, shape (2 N, n) [N m or N].
    """
    middle = trajectory(0.5 * (t[1:] + t[:-1]))
    inside = np.repeat(directions(middle.v, middle.a), 2, axis=0)
    slow = np.abs(ends.v) <= STANDSTILL
    way = np.where(slow, inside, directions(ends.v, ends.a))
    return np.asarray(robot.friction * way)


def overcoming(robot: Robot, trajectory: Trajectory, state: State) -> Array:
    """What dry friction leaves of the torques of a motion, within its intervals.

    Args:
        robot: The robot.
        trajectory: Its motion.
        state: The motion at some times, m rows.

    Returns:
        Torques, shape (m, n) [N m or N].
    """
    if trajectory.inverse_dynamics is not None:
        return RobotDynamics(robot, dry=False).inverse(state.q, state.v, state.a)
    return np.asarray(state.u - robot.friction * directions(state.v, state.a))
