"""Measures of a motion: torque roughness, path length, energy, peak acceleration.

Whether its accelerations are continuous, and its torques and speeds saturated, is
judged by the same rules everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import Array
from tominpmp.description.joint_table import JointLimits
from tominpmp.kinematics import units_of
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import ACCELERATION, MotionLimits
from tominpmp.robot.robot import datasheet_hint

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem

# Number of instants whose torques are compared for the roughness: a hundred would miss
# torques of some milliseconds, in which fast joints reach their speed limits.
ROUGHNESS_INSTANTS = 1000
# Quadrature points of each interval for energies, some of which have kinks where a
# motor begins to brake.
GAUSS_POINTS = 12
# Share of its limit from which a torque or speed counts as saturated.
SATURATED = 0.99
# Jumps of accelerations up to this are rounding, relative to the largest acceleration.
CONTINUOUS = 1e-6


def accelerations_continue(trajectory: Trajectory) -> bool:
    """Whether the accelerations of a motion do not jump at its nodes."""
    if trajectory.degree == 5:
        return True
    nodes = trajectory.t[1:-1]
    before, after = (trajectory(t, 2) for t in (np.nextafter(nodes, 0.0), nodes))
    largest = np.max(np.abs([before, after]), initial=0.0)
    return bool(np.all(np.abs(after - before) <= CONTINUOUS * largest))


def roughness(trajectory: Trajectory, limits: JointLimits) -> float:
    """Roughness of the torques of a motion; see :attr:`Solution.roughness`."""
    share = (np.arange(ROUGHNESS_INSTANTS) + 0.5) / ROUGHNESS_INSTANTS
    u = trajectory(share * trajectory.duration).u
    span = limits.effort_upper - limits.effort_lower
    driven = span > 0.0
    return float(np.sum((np.diff(u[:, driven], axis=0) / span[driven]) ** 2))


def travel(trajectory: Trajectory, limits: JointLimits) -> float:
    """Total travel of the joints from node to node, in time at speed limits [s].

    Joints without a speed limit count with 1 rad/s or m/s.
    """
    speed = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
    return float(np.sum(np.abs(np.diff(trajectory.q, axis=0)) / speed))


@dataclass(frozen=True)
class EnergyKind:
    """A kind of energy: an integral over time, summed over the motors.

    Its integrand is the square, or the positive part, of a term: a function of the
    torque and the velocity of a motor. Planner, solvers and solutions take all kinds
    from :data:`ENERGIES`, and name none of them. To add a kind, make an entry there,
    and add its key to ``Energy`` in ``options.py``.

    Attributes:
        name: Its name in messages.
        unit: Its unit.
        term: The term at torques and velocities of one shape, and its derivatives by
            both.
        squared: Whether the term is squared; otherwise only its positive part counts.
        jumping: Whether the torques of motions of least cost jump.
    """

    name: str
    unit: str
    term: Callable[[Array, Array], tuple[Array, Array, Array]]
    squared: bool = True
    jumping: bool = False

    def integrand(self, u: Array, v: Array) -> Array:
        """The integrand at torques and velocities, shapes (m, n) to (m,)."""
        term = self.term(u, v)[0]
        return np.asarray((term**2 if self.squared else term.clip(0.0)).sum(axis=1))

    def of(self, trajectory: Trajectory) -> float:
        """The energy of a motion, by Gauss quadrature."""
        h = np.diff(trajectory.t)
        places, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
        times = trajectory.t[:-1, None] + 0.5 * h[:, None] * (1.0 + places)
        state = trajectory(times.ravel())
        power = self.integrand(state.u, state.v).reshape(times.shape)
        return float(0.5 * h @ power @ weights)


# Kinds of energy by their names in options: the integral of the squared torques, and
# the work of the motors, which do not recover energy when they brake.
ENERGIES = {
    "torque_squared": EnergyKind("energy", "N^2 m^2 s", lambda u, v: (u, u**0, 0 * v)),
    "work": EnergyKind("work", "J", lambda u, v: (u * v, v, u), False, True),
}


@dataclass(frozen=True)
class PeakAcceleration:
    """Largest acceleration of a motion.

    Attributes:
        joint: Name of the joint.
        value: Absolute acceleration [rad/s^2, or m/s^2 for a prismatic joint].
        time: Time at which it is reached [s].
        unit: "rad/s^2" or "m/s^2".
        limited: Whether the joint has an acceleration limit in the problem.
    """

    joint: str
    value: float
    time: float
    unit: str
    limited: bool


def peak_acceleration(problem: Problem, trajectory: Trajectory) -> PeakAcceleration:
    """Find the largest acceleration of a motion.

    If some joints have no acceleration limit, only these joints are considered.
    """
    nodes = trajectory.t
    steps = np.diff(nodes)
    # Accelerations may jump at the nodes: both sides of a node are sampled.
    shares = np.array([1e-9, 0.25, 0.5, 0.75, 1.0 - 1e-9])
    inside = (nodes[:-1, None] + steps[:, None] * shares).ravel()
    times = inside if steps.size else nodes
    # Torques are not needed.
    sizes = np.abs(replace(trajectory, inverse_dynamics=None)(times).a)
    limits, names = problem.motion_limits or MotionLimits(), problem.robot.joint_names
    bounded = np.isfinite(limits.by_joint("acceleration", names))
    considered = sizes if np.all(bounded) else np.where(bounded, -1.0, sizes)
    row, joint = np.unravel_index(int(np.argmax(considered)), sizes.shape)
    unit = units_of(problem.robot, ACCELERATION)[joint]
    value, time = float(sizes[row, joint]), float(times[row])
    return PeakAcceleration(names[joint], value, time, unit, bool(bounded[joint]))


def acceleration_remark(problem: Problem, trajectory: Trajectory) -> str:
    """Remark on a motion that was planned without acceleration limits.

    Returns:
        A sentence; empty if all joints have an acceleration limit.
    """
    peak = peak_acceleration(problem, trajectory)
    if peak.limited:
        return ""
    limits = problem.motion_limits
    size = f"{peak.value:.0f}" if peak.value >= 100.0 else f"{peak.value:.3g}"
    which, where = f"No acceleration limit for {peak.joint}", ""
    if limits is None or ACCELERATION not in limits._bounded:
        which, where = "No acceleration limits", f" at {peak.joint}"
    hint = datasheet_hint(problem.robot, peak.joint)
    return f"{which}: the peak is {size} {peak.unit}{where}{hint}."
