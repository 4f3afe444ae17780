r"""Lower bounds from the work of the torques on a whole arm.

With :math:`w = \sqrt{v^T M v}`, the square root of twice the kinetic energy, the work
of the torques implies :math:`\dot w \le |u - g|_{M^{-1}}`; Coriolis forces do not
appear, as they do no work. If each joint has a rotor of inertia :math:`A_i`, the mass
matrix satisfies :math:`M \ge A`: w is at least the speed :math:`|v|_A`, and its rate at
most :math:`|u - g|_{A^{-1}}`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.least_time import OneWay, Ramp, SpeedLaw
from tominpmp.bounds.result import LowerBound
from tominpmp.dynamics import RobotDynamics
from tominpmp.motion_limits import EffortCurve
from tominpmp.problem.joint_limits import effort_range, joint_limits
from tominpmp.robot.robot import Robot

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem


def energy_bounds(problem: Problem, q: Array, ends: Array) -> list[LowerBound]:
    """Bound on motions to a configuration.

    Empty if a rotor has no inertia, joints are coupled, or torques are unlimited.

    Args:
        problem: The problem.
        q: Final configuration, shape (n,) [rad or m].
        ends: Velocities at the start and at the end, shape (2, n) [rad/s or m/s].
    """
    robot = problem.robot
    rotors = robot.armature
    if robot.expansion_matrix is not None or not np.all(rotors > 0.0):
        return []
    # Dry friction dissipates energy, which helps to brake.
    forces = np.max(np.abs(effort_bounds(problem)), axis=0)
    forces = forces + gravity_bounds(robot) + robot.friction
    rate = float(np.sqrt(np.sum(forces**2 / rotors)))
    if not np.isfinite(rate):
        return []
    drag = float(np.max(robot.damping / rotors))
    both = np.stack([problem.q_start, q])
    twice = np.sum(ends * RobotDynamics(robot).inertial(both, ends), axis=1)
    first, last = np.sqrt(np.maximum(twice, 0.0)).tolist()
    top = float(np.sqrt(np.sum(rotors * robot.limits.velocity**2)))
    slowing = SpeedLaw(np.zeros(0), np.array([rate]), np.array([drag]))
    motion = OneWay(Ramp(rate), slowing, top, (first, last))
    distance = float(np.sqrt(np.sum(rotors * (q - problem.q_start) ** 2)))
    T = motion.least_time(distance)
    reason = "no torques carry the arm there sooner"
    # A distance that vanishes within rounding seems impossible.
    return [LowerBound(T, reason)] if np.isfinite(T) else []


def effort_bounds(problem: Problem) -> tuple[Array, Array]:
    """Least and largest torques that motions may use, over all speeds, (n,) each."""
    middle, half = effort_range(problem.robot, problem.motion_limits)
    lower, upper = middle - half, middle + half
    for i, curve in effort_curves(problem):
        most = float(np.max(curve.effort))
        upper[i], lower[i] = min(upper[i], most), max(lower[i], -most)
    return lower, upper


def effort_curves(problem: Problem) -> list[tuple[int, EffortCurve]]:
    """Torque-speed curves of motors, each with the index of its joint."""
    limits = joint_limits(problem.robot, problem.motion_limits)
    every = (pair for item in limits for pair in item.by_speed.items())
    return [(i, curve) for i, curve in every if isinstance(curve, EffortCurve)]


def gravity_bounds(robot: Robot) -> Array:
    """Largest torque of gravity on each joint at any configuration, shape (n,)."""
    model = robot.model
    strength = float(np.linalg.norm(robot.gravity))
    out = np.zeros(model.nv)
    slides = [str(j.shortname()).startswith("JointModelP") for j in model.joints]
    travel = np.maximum(
        np.abs(model.lowerPositionLimit), np.abs(model.upperPositionLimit)
    )
    for body in range(1, model.njoints):
        weight = float(model.inertias[body].mass) * strength
        lever, joint = float(np.linalg.norm(model.inertias[body].lever)), body
        while joint > 0 and weight > 0.0:
            item, place = model.joints[joint], model.jointPlacements[joint].translation
            out[item.idx_v] += weight * (1.0 if slides[joint] else lever)
            lever += float(np.linalg.norm(place))
            if slides[joint]:
                lever += float(travel[item.idx_q])
            joint = int(model.parents[joint])
    return out
