"""Placements, velocities and accelerations of frames of a robot, with derivatives.

:class:`RobotKinematics` evaluates one state at a time, :class:`FrameMotions` many: rows
are states, as in :class:`~tominpmp.dynamics.RobotDynamics`. Pinocchio is called state
by state; everything after it is vectorised over the states.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, BoolArray
from tominpmp.checks import JOINTS, array
from tominpmp.motion_limits import POSITION, LimitKind

if TYPE_CHECKING:
    from tominpmp.robot.robot import Robot

# Bounds of the length by which other lengths are scaled [m]: the least length of an
# arm, and the longest travel of a sliding joint, as rails may be kilometres long or
# endless.
LEAST_LENGTH, LONGEST_TRAVEL = 1e-3, 10.0

LOCAL = pin.ReferenceFrame.LOCAL
WORLD = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class RobotKinematics:
    """Frame placements and Jacobians of a robot.

    Attributes:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot

    def placement(self, q: Array, frame: str) -> pin.SE3:
        """Placement frame_to_world.

        Args:
            q: Positions, shape (n,) [rad or m].
            frame: Name of the frame.

        Raises:
            FrameNotFound: If there is no such frame.
        """
        index = self.robot.frame_id(frame)
        model, data = self.robot._model_and_data
        pin.forwardKinematics(model, data, self.robot.expand(q))
        return pin.updateFramePlacement(model, data, index).copy()

    def jacobian(self, q: Array, frame: str, *, local: bool = False) -> Array:
        """Jacobian of a frame: linear part above angular part.

        Args:
            q: Positions, shape (n,).
            frame: Name of the frame.
            local: Whether the axes are those of the frame; otherwise those of the
                world.

        Returns:
            Shape (6, n).
        """
        robot, axes = self.robot, LOCAL if local else WORLD
        index, row = robot.frame_id(frame), robot.expand(q)
        jacobian = pin.computeFrameJacobian(*robot._model_and_data, row, index, axes)
        # Pinocchio drops the second dimension of arms with a single joint.
        return robot.reduce_tangent(np.reshape(jacobian, (6, -1)))

    @property
    def length(self) -> float:
        """Characteristic length of the arm, finite and positive [m]; scales lengths."""
        return max(self.reach(travel=LONGEST_TRAVEL), LEAST_LENGTH)

    def reach(self, frame: str | None = None, *, travel: float = np.inf) -> float:
        """Upper bound on the distance of a frame from the origin of the world [m].

        It holds for all q: the sum of the offsets along the chain, from that origin on,
        plus the travel of prismatic joints; used to scale lengths and to prove that a
        position is out of reach.

        Args:
            frame: Name of the frame; None for the frame with the largest reach.
            travel: Upper limit of the travel of a prismatic joint [m].

        Raises:
            FrameNotFound: If there is no such frame.
        """
        model = self.robot.model
        span = np.zeros(model.njoints)
        lower, upper = model.lowerPositionLimit, model.upperPositionLimit
        for joint in range(1, model.njoints):
            offset = float(np.linalg.norm(model.jointPlacements[joint].translation))
            if _prismatic(model, joint):
                index = model.joints[joint].idx_q
                offset += float(min(max(abs(lower[index]), abs(upper[index])), travel))
            span[joint] = span[model.parents[joint]] + offset
        far = [
            float(span[item.parentJoint] + np.linalg.norm(item.placement.translation))
            for item in model.frames
        ]
        return max(far) if frame is None else far[self.robot.frame_id(frame)]


def last_joint(robot: Robot) -> int:
    """Index of the joint with the most joints between it and the base."""
    model = robot.model
    depth = [len(model.supports[joint]) for joint in range(model.njoints)]
    return max(range(model.njoints), key=lambda joint: (depth[joint], joint))


def prismatic_joints(robot: Robot) -> BoolArray:
    """Which of the joints of a robot are prismatic, shape (n,)."""
    model = robot.model
    return np.array([_prismatic(model, model.getJointId(j)) for j in robot.joint_names])


def units_of(robot: Robot, kind: LimitKind = POSITION) -> list[str]:
    """Units of the joints of a robot: of positions, or of another kind of limit."""
    return [kind.units[int(slides)] for slides in prismatic_joints(robot)]


def endless_joints(robot: Robot) -> BoolArray:
    """Which joints are continuous, so that full turns change nothing, shape (n,).

    Joints that others follow by a ratio (mimic joints) do not count as continuous.
    """
    limits, links = robot.limits, robot.expansion_matrix
    alone = np.ones(robot.n, dtype=bool)
    if links is not None:
        alone = np.count_nonzero(links, axis=0) == 1
    free = np.isinf(limits.position_lower) & np.isinf(limits.position_upper)
    return np.asarray(free & alone & ~prismatic_joints(robot))


def _prismatic(model: pin.Model, joint: int) -> bool:
    return str(model.joints[joint].shortname()).startswith("JointModelP")


class Placements(NamedTuple):
    """Placements of a frame in the world.

    Attributes:
        rotation: Orientations frame_to_world, shape (m, 3, 3).
        origin: Its origin in the world, shape (m, 3) [m].
    """

    rotation: Array
    origin: Array


class FrameMotions:
    """Placements and motions of a frame of a robot.

    Args:
        robot: The robot.
        frame: Name of the frame.

    Raises:
        FrameNotFound: If there is no such frame.
    """

    def __init__(self, robot: Robot, frame: str) -> None:
        self.robot, self.frame = robot, frame
        self._index = robot.frame_id(frame)

    def placements(self, q: Array) -> Placements:
        """Placements of the frame at positions, shape (m, n) [rad or m]."""
        (model, data), index = self.robot._model_and_data, self._index
        (rows,) = self._expanded(q)
        found = np.empty((len(rows), 4, 4))
        for k, row in enumerate(rows):
            pin.forwardKinematics(model, data, row)
            found[k] = pin.updateFramePlacement(model, data, index).homogeneous
        return Placements(found[:, :3, :3], found[:, :3, 3])

    def jacobians(self, q: Array, *, local: bool = False) -> Array:
        """Jacobians at positions: linear parts above angular ones, shape (m, 6, n).

        Args:
            q: Positions, shape (m, n).
            local: Whether the axes are those of the frame; otherwise those of the
                world.
        """
        (model, data), index = self.robot._model_and_data, self._index
        axes, nv = LOCAL if local else WORLD, self.robot.model.nv
        (rows,) = self._expanded(q)
        found = np.empty((len(rows), 6, nv))
        for k, row in enumerate(rows):
            jacobian = pin.computeFrameJacobian(model, data, row, index, axes)
            # Pinocchio drops the second dimension of arms with a single joint.
            found[k] = jacobian.reshape(6, nv)
        return self.robot.reduce_tangent(found)

    def velocities(self, q: Array, v: Array) -> Array:
        """Velocities of its origin in the world, shape (m, 3) [m/s]."""
        return self._of_origin(pin.getFrameVelocity, q, v=v)

    def velocity_slopes(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Velocities of its origin in the world, and their derivatives by q and v.

        Returns:
            Shapes (m, 3), (m, 3, n) and (m, 3, n).
        """
        q = array(q, "q", (None, self.robot.n), JOINTS)
        by_q, *_, by_v = self.slopes(q, v, np.zeros_like(q))
        return self.velocities(q, v), by_q, by_v

    def accelerations(self, q: Array, v: Array, a: Array) -> Array:
        """Accelerations of its origin in the world, shape (m, 3) [m/s^2]."""
        return self._of_origin(pin.getFrameClassicalAcceleration, q, v=v, a=a)

    def _of_origin(
        self, quantity: Callable[..., pin.Motion], q: Array, **rates: Array
    ) -> Array:
        """Linear part of a quantity of Pinocchio in the world, shape (m, 3)."""
        (model, data), index = self.robot._model_and_data, self._index
        parts = self._expanded(q, **rates)
        found = np.empty((len(parts[0]), 3))
        for k, state in enumerate(zip(*parts, strict=True)):
            pin.forwardKinematics(model, data, *state)
            found[k] = quantity(model, data, index, WORLD).linear
        return found

    def slopes(self, q: Array, v: Array, a: Array) -> Array:
        """Derivatives of the motion of its origin in the world.

        Args:
            q: Positions, shape (m, n).
            v: Velocities, shape (m, n).
            a: Accelerations, shape (m, n).

        Returns:
            Derivatives of velocities by q, of accelerations by q and v, and of
            velocities by v, which are those of accelerations by a; shape (4, m, 3, n).
        """
        model, data = self.robot._model_and_data
        frame = model.frames[self._index]
        place = frame.parentJoint, frame.placement, WORLD
        states = self._expanded(q, v=v, a=a)
        found = np.empty((4, len(states[0]), 3, model.nv))
        for k, state in enumerate(zip(*states, strict=True)):
            pin.computeForwardKinematicsDerivatives(model, data, *state)
            by = pin.getPointClassicAccelerationDerivatives(model, data, *place)
            # Pinocchio drops the second dimension of arms with a single joint.
            found[:, k] = np.reshape(by, found[:, k].shape)
        return self.robot.reduce_tangent(found)

    def _expanded(self, q: Array, **rates: Array) -> tuple[Array, ...]:
        """Check rows of states, and expand them to all joints of the model."""
        robot = self.robot
        q = array(q, "q", (None, robot.n), JOINTS)
        rows = [array(x, name, q.shape, JOINTS) for name, x in rates.items()]
        return robot.expand(q), *map(robot.expand_tangent, rows)


def times(matrices: Array, rows: Array) -> Array:
    """Products of matrices and vectors, shapes (m, k, l) or (k, l), and (m, l)."""
    return np.asarray((matrices @ rows[:, :, None])[:, :, 0])
