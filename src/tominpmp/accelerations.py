"""Peak acceleration of a motion, and a remark where nothing limits it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.curves import states
from tominpmp.datasheets import find_datasheet
from tominpmp.kinematics import prismatic_joints
from tominpmp.problem import Problem
from tominpmp.trajectory import Trajectory


@dataclass(frozen=True)
class PeakAcceleration:
    """Largest acceleration of a motion.

    Attributes:
        joint: The joint.
        value: Its size [rad/s^2, or m/s^2 of a joint that slides].
        time: When it is reached [s].
        unit: "rad/s^2" or "m/s^2".
        limited: Whether the joint has a limit of accelerations in the problem.
    """

    joint: str
    value: float
    time: float
    unit: str
    limited: bool


def peak_acceleration(problem: Problem, trajectory: Trajectory) -> PeakAcceleration:
    """Find the largest acceleration of a motion; of joints without a limit, if any."""
    nodes = trajectory.t
    steps = np.diff(nodes)
    # Accelerations may jump at the nodes: just after and just before, and in between.
    shares = np.array([1e-9, 0.25, 0.5, 0.75, 1.0 - 1e-9])
    inside = (nodes[:-1, None] + steps[:, None] * shares).ravel()
    times = inside if steps.size else nodes
    motion = trajectory.t, trajectory.q, trajectory.v, trajectory.a
    sizes = np.abs(states(*motion, times)[2])
    limits, names = problem.motion_limits, problem.robot.joint_names
    bounded = np.zeros(len(names), dtype=bool)
    if limits is not None:
        bounded = np.isfinite(limits.by_joint("acceleration", names))
    looked_at = sizes if np.all(bounded) else np.where(bounded, -1.0, sizes)
    row, joint = np.unravel_index(int(np.argmax(looked_at)), sizes.shape)
    slides = bool(prismatic_joints(problem.robot)[joint])
    return PeakAcceleration(
        joint=names[joint],
        value=float(sizes[row, joint]),
        time=float(times[row]),
        unit="m/s^2" if slides else "rad/s^2",
        limited=bool(bounded[joint]),
    )


def acceleration_remark(problem: Problem, trajectory: Trajectory) -> str:
    """What to say of a motion that was planned without limits of accelerations.

    Returns:
        A sentence; empty if all joints have such a limit.
    """
    peak = peak_acceleration(problem, trajectory)
    if peak.limited:
        return ""
    limits, robot = problem.motion_limits, problem.robot
    size = f"{peak.value:.0f}" if peak.value >= 100.0 else f"{peak.value:.3g}"
    if limits is None or limits.acceleration is None:
        which = "No acceleration limits"
        size = f"{size} {peak.unit} at {peak.joint}"
    else:
        which = f"No acceleration limit for {peak.joint}"
        size = f"{size} {peak.unit}"
    joints = [joint.name for joint in robot.description.joints]
    names = robot.name, robot.description.name, robot.description.path.stem
    sheet = find_datasheet(names, joints)
    published = {} if sheet is None else sheet.by_joint(joints)
    hint = ""
    if peak.joint in published.get("acceleration", {}):
        hint = "; limits='datasheet' has them"
    return f"{which}: the peak is {size}{hint}."
