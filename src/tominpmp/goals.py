"""Goals: what must hold at the end of a motion (paper, equations 5 and 8).

A goal is data; its residual a(x(T)) and the derivatives are evaluated on kinematics. A
motion ends at rest unless a final velocity is given.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, Record, real_array
from tominpmp.exceptions import ProblemError
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot
from tominpmp.scene import is_rotation


class GoalResidual(NamedTuple):
    """Goal residual at a final state; zero where the goal is reached.

    Attributes:
        value: Shape (k,): positions in m, angles in rad, velocities in m/s or rad/s.
        by_q: Derivative with respect to q, shape (k, n).
        by_v: Derivative with respect to v, shape (k, n).
    """

    value: Array
    by_q: Array
    by_v: Array


class Goal(ABC):
    """What must hold at the end of a motion."""

    @abstractmethod
    def validate(self, robot: Robot) -> None:
        """Check the goal against the robot.

        Raises:
            ProblemError: If the goal cannot belong to the robot.
            FrameNotFound: If a frame is not part of it.
        """

    @abstractmethod
    def residual(self, kinematics: RobotKinematics, q: Array, v: Array) -> GoalResidual:
        """Evaluate the residual at a final state of shape (n,) each."""

    @property
    @abstractmethod
    def fixes_velocity(self) -> bool:
        """Whether the final joint velocity is known beforehand."""

    @abstractmethod
    def final_velocity(self, n: int) -> Array:
        """Final joint velocity if it is known beforehand, else zero, shape (n,)."""


def _vector(value: object, name: str, expected: str, size: int | None = None) -> Array:
    """Check a caller's vector; without a size any will do."""
    try:
        array = real_array(value)
    except ValueError as error:
        raise ProblemError(f"{name} is {value!r}, expected {expected}", name) from error
    if array.ndim != 1 or size not in (None, array.size):
        raise ProblemError(
            f"{name} has shape {array.shape}, expected {expected}", field=name
        )
    if not np.all(np.isfinite(array)):
        raise ProblemError(
            f"{name} is {array.tolist()}, expected {expected}, all finite", name
        )
    return array


def _check_frame_name(frame: object) -> None:
    if not isinstance(frame, str) or not frame:
        raise ProblemError(
            f"goal.frame is {frame!r}, expected the name of a frame", "goal.frame"
        )


@dataclass(frozen=True, eq=False)
class JointGoal(Record, Goal):
    """Reach a configuration.

    Attributes:
        q: Joint positions, shape (n,) [rad or m].
        v: Final joint velocities, shape (n,) [rad/s or m/s]; None for rest.
    """

    q: Array
    v: Array | None = None

    def __post_init__(self) -> None:
        """Copy the arrays; their lengths are checked against the robot."""
        expected = "one number for each joint [rad or m]"
        object.__setattr__(self, "q", _vector(self.q, "goal.q", expected))
        if self.v is not None:
            expected = "one number for each joint [rad/s or m/s]"
            object.__setattr__(self, "v", _vector(self.v, "goal.v", expected))

    def validate(self, robot: Robot) -> None:
        """Check lengths against the number of joints."""
        for name, value in (("goal.q", self.q), ("goal.v", self.v)):
            if value is not None and value.size != robot.n:
                raise ProblemError(
                    f"{name} has {value.size} numbers, expected {robot.n}, one for "
                    f"each of: {', '.join(robot.joint_names)}",
                    field=name,
                )

    def residual(self, kinematics: RobotKinematics, q: Array, v: Array) -> GoalResidual:
        """Difference of positions and velocities to the goal, shape (2n,)."""
        n = q.size
        eye, zero = np.eye(n), np.zeros((n, n))
        return GoalResidual(
            np.concatenate([q - self.q, v - self.final_velocity(n)]),
            np.vstack([eye, zero]),
            np.vstack([zero, eye]),
        )

    @property
    def fixes_velocity(self) -> bool:
        """The final joint velocity is given."""
        return True

    def final_velocity(self, n: int) -> Array:
        """Final joint velocity, shape (n,)."""
        return np.zeros(n) if self.v is None else self.v


class FrameGoal(Goal):
    """Goal on a frame; the residual of its placement is left to the subclasses.

    Attributes:
        frame: Name of the frame.
        v: Final linear velocity of its origin in the world, shape (3,) [m/s]; None for
            an arm at rest.
    """

    frame: str
    v: Array | None

    def _check_velocity(self) -> None:
        if self.v is not None:
            v = _vector(self.v, "goal.v", "three components [m/s]", 3)
            object.__setattr__(self, "v", v)

    def validate(self, robot: Robot) -> None:
        """Check that the frame exists."""
        robot.frame_id(self.frame)

    @abstractmethod
    def place_residual(
        self, kinematics: RobotKinematics, q: Array
    ) -> tuple[Array, Array]:
        """Residual of the placement and its Jacobian, shapes (k,) and (k, n)."""

    def residual(self, kinematics: RobotKinematics, q: Array, v: Array) -> GoalResidual:
        """Residual of placement and velocity."""
        n = q.size
        value, by_q = self.place_residual(kinematics, q)
        if self.v is None:
            speed, speed_q, speed_v = v, np.zeros((n, n)), np.eye(n)
        else:
            motion = kinematics.motion(q, v, self.frame)
            speed, speed_q, speed_v = (
                motion.velocity - self.v,
                motion.by_q,
                motion.by_v,
            )
        return GoalResidual(
            np.concatenate([value, speed]),
            np.vstack([by_q, speed_q]),
            np.vstack([np.zeros((value.size, n)), speed_v]),
        )

    @property
    def fixes_velocity(self) -> bool:
        """The final joint velocity is known if the arm ends at rest."""
        return self.v is None

    def final_velocity(self, n: int) -> Array:
        """Zero, shape (n,)."""
        return np.zeros(n)


@dataclass(frozen=True, eq=False)
class PositionGoal(Record, FrameGoal):
    """Bring the origin of a frame to a point, in any orientation.

    Attributes:
        frame: Name of the frame.
        position: Point in the world, shape (3,) [m].
        v: Final linear velocity there, shape (3,) [m/s]; None for an arm at rest.
    """

    frame: str
    position: Array
    v: Array | None = None

    def __post_init__(self) -> None:
        """Check and copy the arrays."""
        _check_frame_name(self.frame)
        position = _vector(self.position, "goal.position", "three coordinates [m]", 3)
        object.__setattr__(self, "position", position)
        self._check_velocity()

    def place_residual(
        self, kinematics: RobotKinematics, q: Array
    ) -> tuple[Array, Array]:
        """Difference of the positions [m], shapes (3,) and (3, n)."""
        place = kinematics.placement(q, self.frame)
        jacobian = kinematics.jacobian(q, self.frame)
        return place.translation - self.position, jacobian[:3]


@dataclass(frozen=True, eq=False)
class PoseGoal(Record, FrameGoal):
    """Bring a frame to a pose.

    Attributes:
        frame: Name of the frame.
        pose: Placement frame_to_world.
        v: Final linear velocity of its origin, shape (3,) [m/s]; None for rest.
    """

    frame: str
    pose: pin.SE3
    v: Array | None = None

    def __post_init__(self) -> None:
        """Check the pose and copy the arrays."""
        _check_frame_name(self.frame)
        if not isinstance(self.pose, pin.SE3):
            raise ProblemError(
                f"goal.pose is a {type(self.pose).__name__}, expected a pinocchio.SE3",
                field="goal.pose",
            )
        if not np.all(np.isfinite(self.pose.homogeneous)):
            raise ProblemError("goal.pose is not finite", field="goal.pose")
        if not is_rotation(self.pose.rotation):
            raise ProblemError(
                "the rotation of goal.pose is not a rotation matrix (orthonormal "
                "columns, determinant 1)",
                field="goal.pose",
            )
        object.__setattr__(self, "pose", self.pose.copy())
        self._check_velocity()

    def _values(self) -> tuple[Any, ...]:
        pose = tuple(self.pose.homogeneous.ravel().tolist())
        v = None if self.v is None else tuple(self.v.tolist())
        return self.frame, pose, v

    def place_residual(
        self, kinematics: RobotKinematics, q: Array
    ) -> tuple[Array, Array]:
        """Twist from the goal to the frame, in the frame, shapes (6,) and (6, n)."""
        place = kinematics.placement(q, self.frame)
        error = self.pose.actInv(place)
        jacobian = kinematics.jacobian(q, self.frame, local=True)
        return np.asarray(pin.log6(error).vector), pin.Jlog6(error) @ jacobian
