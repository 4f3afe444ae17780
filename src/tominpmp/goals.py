"""Goals: what must hold at the end of a motion (paper, equations 5 and 8).

A goal is data; its residual a(x(T)) and the derivatives are evaluated on kinematics. A
motion ends at rest unless a final velocity is given.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, frozen_array
from tominpmp.exceptions import ProblemError
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot


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


def _vector(value: ArrayLike, size: int, name: str, unit: str) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (size,):
        raise ProblemError(
            f"{name} has shape {array.shape}, expected {size} numbers [{unit}]",
            field=name,
        )
    if not np.all(np.isfinite(array)):
        raise ProblemError(f"{name} is {array.tolist()}, expected finite numbers", name)
    return frozen_array(array)


@dataclass(frozen=True, eq=False)
class JointGoal(Goal):
    """Reach a configuration.

    Attributes:
        q: Joint positions, shape (n,) [rad or m].
        v: Final joint velocities, shape (n,) [rad/s or m/s]; None for rest.
    """

    q: Array
    v: Array | None = None

    def __post_init__(self) -> None:
        """Copy the arrays; lengths are checked against the robot."""
        for name in ("q", "v"):
            value = getattr(self, name)
            if value is not None:
                size = np.asarray(value, dtype=np.float64).size
                object.__setattr__(
                    self, name, _vector(value, size, f"goal.{name}", "rad or m")
                )

    def validate(self, robot: Robot) -> None:
        """Check lengths against the number of joints."""
        _vector(self.q, robot.n, "goal.q", "rad or m")
        if self.v is not None:
            _vector(self.v, robot.n, "goal.v", "rad/s or m/s")

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
class PositionGoal(FrameGoal):
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
        object.__setattr__(
            self, "position", _vector(self.position, 3, "goal.position", "m")
        )
        if self.v is not None:
            object.__setattr__(self, "v", _vector(self.v, 3, "goal.v", "m/s"))

    def place_residual(
        self, kinematics: RobotKinematics, q: Array
    ) -> tuple[Array, Array]:
        """Difference of the positions [m], shapes (3,) and (3, n)."""
        place = kinematics.placement(q, self.frame)
        jacobian = kinematics.jacobian(q, self.frame)
        return place.translation - self.position, jacobian[:3]


@dataclass(frozen=True, eq=False)
class PoseGoal(FrameGoal):
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
        if not isinstance(self.pose, pin.SE3):
            raise ProblemError(
                f"goal.pose is a {type(self.pose).__name__}, expected a pinocchio.SE3",
                field="goal.pose",
            )
        if not np.all(np.isfinite(self.pose.homogeneous)):
            raise ProblemError("goal.pose is not finite", field="goal.pose")
        object.__setattr__(self, "pose", self.pose.copy())
        if self.v is not None:
            object.__setattr__(self, "v", _vector(self.v, 3, "goal.v", "m/s"))

    def place_residual(
        self, kinematics: RobotKinematics, q: Array
    ) -> tuple[Array, Array]:
        """Twist from the goal to the frame, in the frame, shapes (6,) and (6, n)."""
        place = kinematics.placement(q, self.frame)
        error = self.pose.actInv(place)
        jacobian = kinematics.jacobian(q, self.frame, local=True)
        return np.asarray(pin.log6(error).vector), pin.Jlog6(error) @ jacobian
