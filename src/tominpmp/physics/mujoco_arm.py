"""A robot as a model of MuJoCo, made from what Pinocchio knows of it.

Bodies, axes, inertias, rotors and friction are written down anew; nothing of the
algorithms is shared. Contacts and limits of joints are left out: what is asked is
whether torques move the arm as they are said to.
"""

from __future__ import annotations

from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from tominpmp.arrays import Array
from tominpmp.collision.placements import Placements
from tominpmp.exceptions import ProblemError, optional
from tominpmp.robot.robot import Robot

# Where viscous friction slows a joint within a step, its integration is implicit.
STIFF = 0.5
# What stands for an inertia until it is put in: one that MuJoCo cannot simplify.
PLACEHOLDER = {
    "pos": "0.11 0.12 0.13",
    "quat": "0.8 0.36 0.48 0",
    "mass": "1",
    "diaginertia": "1 1.1 1.2",
}


class MujocoArm:
    """A robot in MuJoCo.

    Attributes:
        robot: The robot.
        model: MuJoCo's model, one body for each joint.
        data: Its state.

    Raises:
        ProblemError: If joints follow others, which MuJoCo knows as soft ties only.
        MissingDependency: If MuJoCo is not installed.
    """

    def __init__(self, robot: Robot) -> None:
        with optional("mujoco", "mujoco", "replay in MuJoCo"):
            import mujoco

            self.mujoco: Any = mujoco
        if robot.model.nv != robot.n:
            raise ProblemError(
                "robot has joints that follow others (mimic), expected one whose "
                "joints all move freely: lock those that lead",
                "robot",
            )
        self.robot = robot
        self.model = self.mujoco.MjModel.from_xml_string(_mjcf(robot))
        # Where the joints of the robot are among those of the models.
        order = [int(robot.model.getJointId(name)) - 1 for name in robot.joint_names]
        self._order = np.array(order)
        for joint in range(1, robot.model.njoints):
            self._set_inertia(joint, robot.model.inertias[joint])
        self.data = self.mujoco.MjData(self.model)
        self.mujoco.mj_setConst(self.model, self.data)

    def _set_inertia(self, body: int, inertia: pin.Inertia) -> None:
        """Write mass and moments past the compiler, which refuses some of them."""
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
            point: Where, in the axes of the joint, shape (3,) [m].
        """
        own = self.robot.model.inertias[joint]
        added = pin.Inertia(mass, np.asarray(point, dtype=np.float64), np.zeros((3, 3)))
        self._set_inertia(joint, own + added)
        self.mujoco.mj_setConst(self.model, self.data)

    def add_friction(self, friction: Array) -> None:
        """Add dry friction to the joints, shape (n,) [N m or N]."""
        self.model.dof_frictionloss[self._order] += friction

    def set_state(self, q: Array, v: Array) -> None:
        """Put the arm somewhere."""
        self.data.qpos[self._order], self.data.qvel[self._order] = q, v
        self.data.time = 0.0

    @property
    def q(self) -> Array:
        """Positions, shape (n,) [rad or m]."""
        return np.array(self.data.qpos[self._order])

    @property
    def v(self) -> Array:
        """Velocities, shape (n,)."""
        return np.array(self.data.qvel[self._order])

    def inverse(self, q: Array, v: Array, a: Array) -> Array:
        """Torque for a motion at one instant, all shapes (n,)."""
        self.set_state(q, v)
        self.data.qacc[self._order] = a
        self.mujoco.mj_inverse(self.model, self.data)
        return np.array(self.data.qfrc_inverse[self._order])

    def masses(self, q: Array) -> Array:
        """Inertia that each joint sees at a configuration, shape (n,)."""
        self.set_state(q, np.zeros(self.robot.n))
        self.mujoco.mj_forward(self.model, self.data)
        full = np.zeros((self.robot.n, self.robot.n))
        for row, unit in zip(full, np.eye(self.robot.n), strict=True):
            self.mujoco.mj_mulM(self.model, self.data, row, unit)
        return np.array(np.diag(full)[self._order])

    def gains(self, q: Array, bandwidth: float) -> tuple[Array, Array]:
        """Gains of position and velocity that bring errors to zero so fast [1/s].

        Args:
            q: Configurations, of which the one of the largest inertia counts, (m, n).
            bandwidth: How fast [1/s]: both poles of each joint are there.

        Returns:
            Stiffnesses and dampings, shape (n,) each.
        """
        masses = np.array([self.masses(row) for row in q]).max(axis=0)
        return bandwidth**2 * masses, 2.0 * bandwidth * masses

    def choose_integrator(self, step: float, q: Array) -> str:
        """Fourth order, unless friction is stiff; returns its name."""
        kinds = self.mujoco.mjtIntegrator
        damping = np.array(self.model.dof_damping[self._order])
        stiff = bool(np.any(damping * step > STIFF * self.masses(q)))
        chosen = kinds.mjINT_IMPLICITFAST if stiff else kinds.mjINT_RK4
        self.model.opt.integrator = chosen
        return "implicit" if stiff else "Runge-Kutta 4"

    def step(self, torque: Array, seconds: float) -> None:
        """Move on under a constant torque."""
        self.model.opt.timestep = seconds
        self.data.qfrc_applied[self._order] = torque
        self.mujoco.mj_step(self.model, self.data)


def _mjcf(robot: Robot) -> str:
    """The robot in MuJoCo's language, without shapes; inertias are put in later."""
    model = robot.model
    root = Element("mujoco", model=robot.name)
    SubElement(root, "compiler", angle="radian", autolimits="false")
    option = SubElement(root, "option", gravity=_numbers(robot.gravity))
    SubElement(option, "flag", contact="disable")
    bodies = {0: SubElement(root, "worldbody")}
    placements = Placements(model)
    for joint in range(1, model.njoints):
        place = model.jointPlacements[joint]
        slide, turn, _ = placements.axes(joint)
        kind = {"type": "hinge", "axis": _numbers(turn)}
        if not np.any(turn):
            kind = {"type": "slide", "axis": _numbers(slide)}
        turned = np.roll(Rotation.from_matrix(place.rotation).as_quat(), 1)
        body = SubElement(
            bodies[int(model.parents[joint])],
            "body",
            name=f"body{joint}",
            pos=_numbers(place.translation),
            quat=_numbers(turned),
        )
        SubElement(body, "inertial", PLACEHOLDER)
        i = robot.joint_names.index(str(model.names[joint]))
        SubElement(
            body,
            "joint",
            kind,
            name=f"joint{joint}",
            armature=repr(float(robot.armature[i])),
            damping=repr(float(robot.damping[i])),
            frictionloss=repr(float(robot.friction[i])),
        )
        bodies[joint] = body
    return tostring(root, encoding="unicode")


def _numbers(values: Any) -> str:
    return " ".join(repr(float(x)) for x in values)
