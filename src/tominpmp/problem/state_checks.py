"""Joint positions, velocities and torques at a state, against limits of a robot."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError
from tominpmp.kinematics import units_of
from tominpmp.motion_limits import EFFORT, joint_kinds
from tominpmp.robot.robot import Robot

# Largest excess of a start or goal over a limit that is moved onto the limit (positions
# in rad or m, velocities in rad/s or m/s), as encoders and files round; for narrow
# limits the largest share of the range between them.
SNAP, SNAP_SHARE = 1e-4, 1e-2
# Angles that exceed a limit and this size get a hint: they are probably in degrees.
LARGE_ANGLE, IN_RADIANS = 2.0 * np.pi, "; angles are in radians, not degrees"


def holding(robot: Robot, q: Array) -> tuple[Array, BoolArray]:
    """Torques that hold an arm at rest, and whether each motor has them.

    Args:
        robot: The robot.
        q: Configurations, shape (m, n).

    Returns:
        Shape (m, n) each.
    """
    limits, rest = robot.limits, np.zeros_like(q)
    tau = rest if robot.kinematic else RobotDynamics(robot).inverse(q, rest, rest)
    low, high = limits.effort_lower, limits.effort_upper
    slack = 1e-9 * np.maximum(1.0, np.maximum(np.abs(low), np.abs(high)))
    return tau, (low - slack <= tau) & (tau <= high + slack) | robot.kinematic


def unheld(robot: Robot, q: Array) -> str:
    """Clause on the first motor that cannot hold the arm at rest at q; may be empty."""
    tau, held = holding(robot, q[None])
    for i in np.flatnonzero(~held[0]).tolist():
        low, high = 0.0 + robot.limits.effort_lower[i], robot.limits.effort_upper[i]
        dry = " (its dry friction is not counted on)" if robot.friction[i] else ""
        return (
            f"joint {robot.joint_names[i]!r} cannot hold the arm against gravity "
            f"there: {tau[0, i]:.4g} {units_of(robot, EFFORT)[i]} needed, "
            f"[{low:.4g}, {high:.4g}] allowed{dry}"
        )
    return ""


def onto_limits(
    robot: Robot, quantity: str, values: Array, name: str
) -> tuple[Array, list[str]]:
    """Check joint values against limits, and move values just outside onto the limits.

    Args:
        robot: The robot.
        quantity: "position" or "velocity".
        values: Shape (n,); NaN for joints without a value.
        name: Name of the values in messages.

    Returns:
        The values within the limits, and a warning for each value that was moved.

    Raises:
        ProblemError: If a value is outside its limits by more than rounding.
    """
    limits, snapped = robot.limits, list[str]()
    lower, upper = limits.position_lower, limits.position_upper
    if quantity == "velocity":
        lower, upper = -limits.velocity, limits.velocity
    slack = np.minimum(SNAP, SNAP_SHARE * upper - SNAP_SHARE * lower)
    clipped = np.clip(values, lower, upper)
    excess = np.abs(clipped - values)
    for i in np.flatnonzero(excess > 0.0).tolist():
        unit = units_of(robot, joint_kinds()[quantity])[i]
        beyond = (
            f"{name}: joint {robot.joint_names[i]!r} is {values[i]:.10g} {unit}, "
            f"outside its {quantity} limits [{lower[i]:.10g}, {upper[i]:.10g}] {unit}"
        )
        if excess[i] > slack[i]:
            degrees = unit == "rad" and np.any(np.abs(values) > LARGE_ANGLE)
            field = name.split(" ")[0]
            raise ProblemError(beyond + (IN_RADIANS if degrees else ""), field)
        snapped.append(f"{beyond}, by {excess[i]:.1e}, and was set to the limit")
    return np.asarray(clipped), snapped
