"""Bounds on inertia and on the work of torques that hold at all configurations."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.kinematics import prismatic_joints
from tominpmp.motion_limits import MotionLimits
from tominpmp.robot import Robot

# Instants around the circle, or along the rail, of the second joint at which the
# inertia of a two-joint arm is looked at, and those that determine it.
GRID = 1440
SAMPLES = 8


@dataclass(frozen=True, eq=False)
class EnergyBounds:
    """How fast torques can raise the kinetic energy.

    Attributes:
        robot: The robot.
        inverse: Matrices such that at any configuration one of them is no less than the
            inverse of the mass matrix, shape (k, n, n).
        acceleration: Bound on the rate of w, the root of twice the kinetic energy.
        drag: Bound on the rate at which friction lowers w, relative to w [1/s].
    """

    robot: Robot
    inverse: Array
    acceleration: float
    drag: float

    def rate(self, direction: Array) -> float:
        """Largest |direction v| / w at any configuration; direction of shape (n,)."""
        squares = np.einsum("i,kij,j->k", direction, self.inverse, direction)
        return float(np.sqrt(np.max(squares)))

    def inertia_at(self, q: Array) -> Array:
        """Mass matrices, shape (m, n) to (m, n, n)."""
        return inertia_at(self.robot, q)


def inertia_at(robot: Robot, q: Array) -> Array:
    """Mass matrices at configurations, shape (m, n) to (m, n, n)."""
    model, data = robot.model, robot.model.createData()
    out = np.empty((q.shape[0], model.nv, model.nv))
    for k, row in enumerate(robot.expand(q)):
        out[k] = pin.crba(model, data, row)
    upper = np.triu(out)
    out = upper + np.triu(upper, 1).transpose(0, 2, 1)
    S = robot.expansion_matrix
    return out if S is None else np.asarray(S.T @ out @ S)


def gravity_bounds(robot: Robot) -> Array:
    """Largest torque of gravity on each joint at any configuration, shape (nv,)."""
    model = robot.model
    strength = float(np.linalg.norm(robot.gravity))
    out = np.zeros(model.nv)
    slides = _slides(robot)
    travel = np.maximum(
        np.abs(model.lowerPositionLimit), np.abs(model.upperPositionLimit)
    )
    for joint in range(1, model.njoints):
        for body in model.subtrees[joint]:
            lever = float(np.linalg.norm(model.inertias[body].lever))
            at = int(body)
            while at != joint:
                lever += float(np.linalg.norm(model.jointPlacements[at].translation))
                if slides[at]:
                    lever += float(travel[model.joints[at].idx_q])
                at = int(model.parents[at])
            weight = float(model.inertias[body].mass) * strength
            if weight > 0.0:
                arm = 1.0 if slides[joint] else lever
                out[model.joints[joint].idx_v] += weight * arm
    return out


def _slides(robot: Robot) -> list[bool]:
    model = robot.model
    return [str(joint.shortname()).startswith("JointModelP") for joint in model.joints]


def effort_bounds(robot: Robot, limits: MotionLimits | None) -> tuple[Array, Array]:
    """Least and largest torques that a motion may use at any speed, shape (n,) each.

    Args:
        robot: The robot.
        limits: Limits beyond its own: the share of the torques, and torque over speed.
    """
    lower, upper = robot.limits.effort_lower, robot.limits.effort_upper
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    if limits is None:
        return lower, upper
    half = limits.effort_scale * half
    lower, upper = middle - half, middle + half
    for joint, curve in (limits.effort_curves or {}).items():
        i = robot.joint_names.index(joint)
        most = float(np.max(curve.effort))
        upper[i] = min(upper[i], most)
        lower[i] = max(lower[i], -most)
    return lower, upper


def energy_bounds(
    robot: Robot, limits: MotionLimits | None = None
) -> EnergyBounds | None:
    """Bounds on the work of the torques, where the inertia can be bounded from below.

    That is so for arms of two joints, whose inertia depends on the second one alone,
    and for arms with rotor inertia at every joint.

    Args:
        robot: The robot.
        limits: Limits beyond its own.
    """
    inverse = _inverse_bounds(robot)
    weight = gravity_bounds(robot)
    if inverse is None or not np.all(np.isfinite(weight)):
        return None
    S = robot.expansion_matrix
    weight = weight if S is None else weight @ np.abs(S)
    lower, upper = effort_bounds(robot, limits)
    most = np.maximum(np.abs(lower), np.abs(upper))
    # Dry friction takes energy out of the motion; it helps to brake.
    most = most + weight + robot.friction
    if robot.n <= 6:
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=robot.n)))
        torques = signs * most
        squares = np.einsum("si,kij,sj->ks", torques, inverse, torques)
    else:
        squares = np.einsum("i,kij,j->k", most, np.abs(inverse), most)
    root = np.sqrt(robot.damping)
    drag = np.linalg.eigvalsh(root[:, None] * inverse * root)
    return EnergyBounds(
        robot, inverse, float(np.sqrt(np.max(squares))), float(np.max(drag))
    )


def _inverse_bounds(robot: Robot) -> Array | None:
    model = robot.model
    if robot.expansion_matrix is not None:
        return None
    if robot.n == 2 and model.nv == 2:
        found = _two_joints(robot)
        if found is not None:
            return found
    if np.all(robot.armature > 0.0):
        return np.diag(1.0 / robot.armature)[None]
    return None


def _two_joints(robot: Robot) -> Array | None:
    """Bounds for an arm of two joints: no first joint changes its inertia."""
    low = float(robot.limits.position_lower[1])
    high = float(robot.limits.position_upper[1])
    if prismatic_joints(robot)[1]:
        if not np.isfinite(high - low):
            return None
        # A polynomial of degree 2, known from three values.
        at = np.array([low, 0.5 * (low + high), high])
        values = _inertia_over(robot, at)
        powers = np.linalg.solve(
            np.vander(at, increasing=True), values.reshape(3, 4)
        ).reshape(3, 2, 2)
        q = np.linspace(low, high, GRID)
        mass = np.einsum("kp,pij->kij", np.vander(q, 3, increasing=True), powers)
        reach = max(abs(low), abs(high))
        slope = np.abs(powers[1]) + 2.0 * reach * np.abs(powers[2])
        spacing = (high - low) / (GRID - 1)
    else:
        # A trigonometric polynomial of degree 2.
        at = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
        terms = np.fft.rfft(_inertia_over(robot, at), axis=0)[:3] / SAMPLES
        terms[1:] *= 2.0
        q = 2.0 * np.pi * np.arange(GRID) / GRID
        waves = np.exp(1j * np.outer(q, np.arange(3)))
        mass = np.real(np.einsum("kp,pij->kij", waves, terms))
        slope = np.abs(terms[1]) + 2.0 * np.abs(terms[2])
        spacing = 2.0 * np.pi / GRID
    # Between the instants it changes by no more than this in any direction.
    least = mass - 0.5 * spacing * float(np.linalg.norm(slope)) * np.eye(2)
    if np.min(np.linalg.eigvalsh(least)) <= 0.0:
        return None
    return np.asarray(np.linalg.inv(least))


def _inertia_over(robot: Robot, at: Array) -> Array:
    return inertia_at(robot, np.column_stack([np.zeros_like(at), at]))
