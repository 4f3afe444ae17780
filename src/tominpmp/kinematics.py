"""Where frames of a robot are and how they move, with derivatives."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, BoolArray
from tominpmp.robot import Robot

# Lengths that scale others [m]: of an arm without any, and the farthest that a joint is
# taken to slide, as rails of kilometres or without ends do.
LEAST_LENGTH, LONGEST_TRAVEL = 1e-3, 10.0


class FrameMotion(NamedTuple):
    """Velocity of a frame's origin, with derivatives.

    Attributes:
        velocity: Linear velocity in the world [m/s], shape (3,).
        by_q: Derivative with respect to q, shape (3, n).
        by_v: Derivative with respect to v (the Jacobian), shape (3, n).
    """

    velocity: Array
    by_q: Array
    by_v: Array


class RobotKinematics:
    """Frame placements and Jacobians of a robot.

    Attributes:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._data = robot.model.createData()  # scratch of the algorithms

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without the scratch data."""
        return type(self), (self.robot,)

    def placement(self, q: Array, frame: str) -> pin.SE3:
        """Placement frame_to_world.

        Args:
            q: Positions, shape (n,) [rad or m].
            frame: Name of the frame.

        Raises:
            FrameNotFound: If there is no such frame.
        """
        index = self.robot.frame_id(frame)
        model, data = self.robot.model, self._data
        pin.forwardKinematics(model, data, self.robot.expand(q))
        return pin.updateFramePlacement(model, data, index).copy()

    def jacobian(self, q: Array, frame: str, *, local: bool = False) -> Array:
        """Jacobian of a frame: linear part above angular part.

        Args:
            q: Positions, shape (n,).
            frame: Name of the frame.
            local: Whether in the axes of the frame, else in those of the world.

        Returns:
            Shape (6, n).
        """
        reference = (
            pin.ReferenceFrame.LOCAL
            if local
            else pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        jacobian = pin.computeFrameJacobian(
            self.robot.model,
            self._data,
            self.robot.expand(q),
            self.robot.frame_id(frame),
            reference,
        )
        # Pinocchio drops the second dimension of arms with a single joint.
        jacobian = np.reshape(jacobian, (6, -1))
        return self.robot.reduce_tangent(jacobian)

    def motion(self, q: Array, v: Array, frame: str) -> FrameMotion:
        """Linear velocity of a frame's origin, with derivatives.

        Args:
            q: Positions, shape (n,).
            v: Velocities, shape (n,).
            frame: Name of the frame.
        """
        robot, data = self.robot, self._data
        v_model = robot.expand_tangent(v)
        pin.computeForwardKinematicsDerivatives(
            robot.model, data, robot.expand(q), v_model, np.zeros(robot.model.nv)
        )
        index = robot.frame_id(frame)
        by_q, by_v = pin.getFrameVelocityDerivatives(
            robot.model, data, index, pin.ReferenceFrame.LOCAL
        )
        # Pinocchio drops the second dimension of arms with a single joint.
        by_q, by_v = np.reshape(by_q, (6, -1)), np.reshape(by_v, (6, -1))
        rotation = pin.updateFramePlacement(robot.model, data, index).rotation
        velocity = by_v[:3] @ v_model
        # d(R v) = R (dv + w x v), as the axes of the frame turn with q.
        turned = by_q[:3] - pin.skew(velocity) @ by_v[3:]
        return FrameMotion(
            np.asarray(rotation @ velocity),
            robot.reduce_tangent(rotation @ turned),
            robot.reduce_tangent(rotation @ by_v[:3]),
        )

    @property
    def length(self) -> float:
        """Length of the arm, which scales lengths, finite and above zero [m]."""
        return max(self.reach(travel=LONGEST_TRAVEL), LEAST_LENGTH)

    def reach(self, frame: str | None = None, *, travel: float = np.inf) -> float:
        """Upper bound on the distance of a frame from the base, at any q [m].

        The sum of the offsets along the chain, plus the travel of prismatic joints;
        used to scale lengths and to prove that a position is out of reach.

        Args:
            frame: Name of the frame; None for the one that reaches farthest.
            travel: Farthest that a prismatic joint is taken to slide [m].

        Raises:
            FrameNotFound: If there is no such frame.
        """
        model = self.robot.model
        span = np.zeros(model.njoints)
        lower, upper = model.lowerPositionLimit, model.upperPositionLimit
        for joint in range(1, model.njoints):
            offset = float(np.linalg.norm(model.jointPlacements[joint].translation))
            if _slides(model, joint):
                index = model.joints[joint].idx_q
                offset += float(min(max(abs(lower[index]), abs(upper[index])), travel))
            span[joint] = span[model.parents[joint]] + offset
        far = [
            float(span[item.parentJoint] + np.linalg.norm(item.placement.translation))
            for item in model.frames
        ]
        return max(far) if frame is None else far[self.robot.frame_id(frame)]


def prismatic_joints(robot: Robot) -> BoolArray:
    """Which of the joints of a robot slide instead of turning, shape (n,)."""
    model = robot.model
    return np.array([_slides(model, model.getJointId(j)) for j in robot.joint_names])


def _slides(model: pin.Model, joint: int) -> bool:
    kind = str(model.joints[joint].shortname())
    return kind.startswith("JointModelP")
