"""Dry friction along motions that are judged."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.dynamics import RobotDynamics
from tominpmp.motion.trajectory import State, Trajectory
from tominpmp.robot import Robot


def friction_along(robot: Robot, trajectory: Trajectory, times: Array) -> Array:
    """Dry friction that the motors of a motion overcome.

    Args:
        robot: The robot.
        trajectory: Its motion.
        times: Times within its intervals [s], shape (m,).

    Returns:
        Torques, shape (m, n) [N m or N].
    """
    return np.asarray(robot.friction * trajectory.turns.at(times))


def overcoming(
    robot: Robot, trajectory: Trajectory, times: Array, state: State
) -> Array:
    """What dry friction leaves of the torques of a motion, within its intervals.

    Args:
        robot: The robot.
        trajectory: The motion.
        times: Some times [s], shape (m,).
        state: The motion then, m rows.

    Returns:
        Torques, shape (m, n) [N m or N].
    """
    if trajectory.inverse_dynamics is not None:
        return RobotDynamics(robot, dry=False).inverse(state.q, state.v, state.a)
    return np.asarray(state.u - friction_along(robot, trajectory, times))
