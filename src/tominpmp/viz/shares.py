"""Speeds and torques of a motion as shares of their limits."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tominpmp.arrays import Array
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.joint_limits import controls_in, effort_range
from tominpmp.problem.problem import Problem

# Number of sampled instants of a motion, in addition to both sides of its nodes.
INSTANTS = 160
# Colours of torques and speeds, on pages of motions and on the live page.
TORQUE_COLOR, SPEED_COLOR = "#12375f", "#d98200"


@dataclass(frozen=True, eq=False)
class Shares:
    """Speeds and torques of a motion as shares of their limits.

    Attributes:
        joint_names: Names of the joints, in column order.
        t: Times [s], shape (m,).
        torque: Torques, or accelerations of a kinematic robot, from -1 at the lower
            limit to 1 at the upper one, shape (m, n); 0 for joints without a motor.
        speed: Velocities over their limits, shape (m, n); 0 for joints without a limit.
        control: Name of the control: "torque" or "acceleration".
    """

    joint_names: tuple[str, ...]
    t: Array
    torque: Array
    speed: Array
    control: str = field(default="torque", kw_only=True)


def times_with_jumps(trajectory: Trajectory, count: int) -> Array:
    """Evenly spaced instants of a motion, and both sides of every jump at a node [s].

    The largest number below a node has the values before the jump.
    """
    even, nodes = np.linspace(0.0, trajectory.duration, count), trajectory.t[1:-1]
    return np.unique(np.concatenate([even, nodes, np.nextafter(nodes, -np.inf)]))


def shares_of_limits(
    problem: Problem, trajectory: Trajectory, times: Array | None = None
) -> Shares:
    """Compare a motion with the limits of its problem.

    A torque in the middle of its range has the share zero, and so has a quantity
    without a limit or a motor. Torques are relative to the limits scaled by
    ``effort_scale``.

    Args:
        problem: The problem.
        trajectory: The motion.
        times: Instants to evaluate [s], shape (m,); after the end the motion holds;
            None for evenly spaced instants, and both sides of every jump at a node.
    """
    if times is None:
        times = times_with_jumps(trajectory, INSTANTS)
    state = trajectory(times, hold=True)
    # Limits of speed are positive; a joint without one has an infinite limit.
    speed = state.v / problem.robot.limits.velocity
    middle, half = effort_range(problem.robot, problem.motion_limits)
    driven = np.isfinite(half) & (half > 0.0)
    middle, half = np.where(driven, middle, 0.0), np.where(driven, half, 1.0)
    controls = controls_in(problem.robot, state)
    torque = np.where(driven, (controls - middle) / half, 0.0)
    control = "acceleration" if problem.robot.kinematic else "torque"
    return Shares(trajectory.joint_names, times, torque, speed, control=control)
