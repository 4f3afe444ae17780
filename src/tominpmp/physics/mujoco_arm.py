"""A robot as a model of MuJoCo, made from its Pinocchio model.

Bodies, axes, inertias, rotors and friction are handed over; no algorithm is shared.
Contacts and joint limits are left out: the simulation checks only whether the torques
move the arm along the motion.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from tominpmp.arrays import Array
from tominpmp.collision.placements import JointPlacements
from tominpmp.description.mjcf import imported_mujoco
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError
from tominpmp.robot.robot import Robot

# Ratio of damping times step to inertia beyond which the integration is implicit.
STIFF = 0.5
# Inertia of a body until it is replaced: one that MuJoCo does not simplify.
PLACEHOLDER = {
    "explicitinertial": True,
    "ipos": (0.11, 0.12, 0.13),
    "iquat": (0.8, 0.36, 0.48, 0.0),
    "mass": 1.0,
    "inertia": (1.0, 1.1, 1.2),
}


class MujocoArm:
    """A robot in MuJoCo.

    Attributes:
        robot: The robot.
        model: MuJoCo's model, one body for each joint.
        data: State of the simulation.

    Raises:
        ProblemError: If the robot has mimic joints, which MuJoCo has as soft
            constraints only.
        MissingDependency: If MuJoCo is not installed.
    """

    def __init__(self, robot: Robot) -> None:
        self.mujoco = imported_mujoco("replay in MuJoCo")
        if robot.model.nv != robot.n:
            raise ProblemError(
                "robot has joints that follow others (mimic), expected a robot whose "
                "joints are all independent: lock the joints that they follow",
                "robot",
            )
        self.robot = robot
        self.model = self._bodies()
        self.model.opt.gravity[:] = robot.gravity
        # Indices of the robot's joints in both models, which may have another order.
        order = [int(robot.model.getJointId(name)) - 1 for name in robot.joint_names]
        self._order = np.array(order)
        self.model.dof_armature[self._order] = robot.armature
        self.model.dof_damping[self._order] = robot.damping
        self.model.dof_frictionloss[self._order] = robot.friction
        # Dry friction is as hard as possible, and stops a joint in 4 ms: with MuJoCo's
        # defaults that of a light link is too small below some radians per second.
        self.model.dof_solimp[:, :2] = 0.9999
        self.model.dof_solref[:, 0] = 0.004
        for joint in range(1, robot.model.njoints):
            self._set_inertia(joint, robot.model.inertias[joint])
        self.data = self.mujoco.MjData(self.model)
        self.mujoco.mj_setConst(self.model, self.data)

    def _bodies(self) -> Any:
        """MuJoCo's model of the joints, with placeholders of inertias."""
        model, kinds = self.robot.model, self.mujoco.mjtJoint
        spec = self.mujoco.MjSpec()
        placements, bodies = JointPlacements(model), [spec.worldbody]
        for joint in range(1, model.njoints):
            place, above = model.jointPlacements[joint], bodies[model.parents[joint]]
            quaternion = np.roll(Rotation.from_matrix(place.rotation).as_quat(), 1)
            body = above.add_body(pos=place.translation, quat=quaternion, **PLACEHOLDER)
            slide, turn = placements.slide[joint], placements.turn[joint]
            kind = kinds.mjJNT_HINGE if np.any(turn) else kinds.mjJNT_SLIDE
            body.add_joint(type=kind, axis=slide + turn)  # one of both axes is zero
            bodies.append(body)
        return spec.compile()

    def _set_inertia(self, body: int, inertia: pin.Inertia) -> None:
        """Set mass and moments after compilation, which refuses some values."""
        moments, axes = np.linalg.eigh(inertia.inertia)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        model = self.model
        model.body_mass[body] = inertia.mass
        model.body_ipos[body] = inertia.lever
        model.body_inertia[body] = moments
        model.body_iquat[body] = np.roll(Rotation.from_matrix(axes).as_quat(), 1)

    def load(self, mass: float, joint: int, point: Array) -> None:
        """Add a point mass to a body.

        Args:
            mass: Mass [kg].
            joint: Joint of the model that moves the body.
            point: Position in the axes of the joint, shape (3,) [m].
        """
        added = pin.Inertia(mass, np.asarray(point, dtype=np.float64), np.zeros((3, 3)))
        self._set_inertia(joint, self.robot.model.inertias[joint] + added)
        self.mujoco.mj_setConst(self.model, self.data)

    def add_friction(self, friction: Array) -> None:
        """Add dry friction to the joints, shape (n,) [N m or N]."""
        self.model.dof_frictionloss[self._order] += friction

    def set_state(self, q: Array, v: Array) -> None:
        """Set positions and velocities, shape (n,) each."""
        self.data.qpos[self._order], self.data.qvel[self._order] = q, v

    @property
    def state(self) -> tuple[Array, Array]:
        """Positions and velocities, shape (n,) each [rad or m, rad/s or m/s]."""
        return self.data.qpos[self._order], self.data.qvel[self._order]

    def inverse(self, q: Array, v: Array, a: Array) -> Array:
        """Inverse dynamics: torques at one instant, all shapes (n,) [N m or N]."""
        self.set_state(q, v)
        self.data.qacc[self._order] = a
        self.mujoco.mj_inverse(self.model, self.data)
        return np.array(self.data.qfrc_inverse[self._order])

    def gains(self, q: Array, bandwidth: float) -> tuple[Array, Array]:
        """Gains of position and velocity for a bandwidth of the feedback.

        Args:
            q: Configurations, of which the largest inertia of each joint counts,
                shape (m, n) [rad or m].
            bandwidth: Bandwidth [1/s]: minus the double pole of each joint.

        Returns:
            Stiffnesses and dampings, shape (n,) each.
        """
        masses = _masses(self.robot, q).max(axis=0)
        return bandwidth**2 * masses, 2.0 * bandwidth * masses

    def choose_integrator(self, step: float, q: Array) -> str:
        """Choose Runge-Kutta 4, or implicit if friction is stiff; return its name."""
        kinds = self.mujoco.mjtIntegrator
        damping = self.model.dof_damping[self._order]
        stiff = np.any(damping * step > STIFF * _masses(self.robot, q[None]))
        chosen = kinds.mjINT_IMPLICITFAST if stiff else kinds.mjINT_RK4
        self.model.opt.integrator = chosen
        return "implicit" if stiff else "Runge-Kutta 4"

    def step(self, torque: Array, seconds: float) -> None:
        """Simulate one step with constant torques, shape (n,) [N m or N]."""
        self.model.opt.timestep = seconds
        self.data.qfrc_applied[self._order] = torque
        self.mujoco.mj_step(self.model, self.data)


def _masses(robot: Robot, q: Array) -> Array:
    """Diagonals of mass matrices at configurations, shape (m, n) [kg m^2 or kg]."""
    return np.diagonal(RobotDynamics(robot).mass(q), axis1=1, axis2=2)
