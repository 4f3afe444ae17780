"""Goals on a frame: its position, pose, direction, or a region for it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Annotated, TypeAlias

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, Converted, Record, array_or_nan, default, record
from tominpmp.checks import (
    POSE,
    Direction,
    FrameName,
    Point,
    PointOrNone,
    PoseLike,
    VectorLike,
    array,
    instance,
    optional,
    split_pose,
    text,
    vector,
    wrong,
)
from tominpmp.exceptions import ProblemError, SceneError
from tominpmp.goals.base import Goal, goal_tolerance, joint_row
from tominpmp.goals.direction import deviation
from tominpmp.goals.place import Ball, Label, Place
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot
from tominpmp.scene import is_rotation, rotation_matrix

Distance: TypeAlias = Annotated[float, partial(goal_tolerance, unit="m")]
Angle: TypeAlias = Annotated[float, partial(goal_tolerance, unit="rad", most=np.pi)]
VelocityOrNone: TypeAlias = Annotated[
    Converted[VectorLike | None, Array | None],
    optional(partial(vector, expected="three components [m/s]", size=3)),
]


def checked_pose(pose: object, name: str = "goal.pose") -> pin.SE3:
    """Copy a caller's pose.

    Args:
        pose: The pose.
        name: What it is called in messages.

    Raises:
        ProblemError: If it is none.
    """
    parts = split_pose(pose)
    position = array_or_nan(None if parts is None else parts[0])
    turn = array_or_nan(None if parts is None else parts[1])
    if parts is None or position.shape != (3,) or turn.shape not in ((3, 3), (4,)):
        raise wrong(pose, name, POSE)
    if not (np.all(np.isfinite(position)) and np.all(np.isfinite(turn))):
        raise ProblemError(f"{name} is not finite", field=name)
    if turn.shape == (4,):
        try:
            turn = rotation_matrix(turn)
        except SceneError as error:
            raise ProblemError(
                f"{name} has the quaternion {turn.tolist()}, expected one that is not "
                "zero",
                name,
            ) from error
    if not is_rotation(turn):
        raise ProblemError(
            f"the rotation of {name} is not a rotation matrix (orthonormal columns, "
            "determinant 1)",
            field=name,
        )
    return pin.SE3(np.array(turn), np.array(position))


Pose: TypeAlias = Annotated[Converted[PoseLike, pin.SE3], checked_pose]
PoseOrNone: TypeAlias = Annotated[
    Converted[PoseLike | None, pin.SE3 | None], optional(checked_pose)
]


class FrameGoal(Record, Goal):
    """Goal on a frame; what its placement has to be is left to the subclasses.

    Attributes:
        frame: Name of the frame.
        v: Final linear velocity of its origin in the world, shape (3,) [m/s]; None for
            an arm at rest.
    """

    frame: FrameName
    v: VelocityOrNone

    _owner = "goal."

    def validate(self, robot: Robot) -> None:
        """Check that the frame exists."""
        instance(robot, Robot, "robot").frame_id(self.frame)

    @property
    def frame_name(self) -> str:
        """The frame."""
        return self.frame

    def prefixed(self, prefix: str, robot: Robot) -> Goal:
        """The goal with the frame's name beside other robots."""
        name = text(prefix, "prefix") + self.frame
        return replace(self, frame=name)  # type: ignore[type-var]

    def _placed(
        self, kinematics: RobotKinematics, q: Array, *, local: bool = False
    ) -> tuple[pin.SE3, Array]:
        """Where the frame is at a configuration, and its Jacobian."""
        q = joint_row(kinematics, q, "q")
        jacobian = kinematics.jacobian(q, self.frame, local=local)
        return kinematics.placement(q, self.frame), jacobian

    def motion_residual(
        self, kinematics: RobotKinematics, q: Array, v: Array
    ) -> tuple[Array, Array, Array]:
        """Residual of the velocity, of the joints or of the frame's origin."""
        if self.v is None:
            return super().motion_residual(kinematics, q, v)
        v = joint_row(kinematics, v, "v")
        motion = kinematics.motion(q, v, self.frame)
        return motion.velocity - self.v, motion.by_q, motion.by_v

    def label(self, unit: str) -> Label:
        """Label of a value of the frame."""
        return Label(f"frame {self.frame}", unit)

    def motion_labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """What the velocities are, of the joints or of the frame."""
        if self.v is None:
            return super().motion_labels(kinematics)
        return (self.label("m/s"),) * 3

    @property
    def fixes_velocity(self) -> bool:
        """The final joint velocity is known if the arm ends at rest."""
        return self.v is None


@record
class PositionGoal(FrameGoal):
    """Bring the origin of a frame to a point, in any orientation.

    Attributes:
        frame: Name of the frame.
        position: Point in the world, shape (3,) [m].
        v: Final linear velocity there, shape (3,) [m/s]; None for an arm at rest.
        tolerance: Largest distance from the point [m].
    """

    frame: FrameName
    position: Point
    v: VelocityOrNone = default(None)
    tolerance: Distance = 0.0

    @property
    def target(self) -> Array:
        """The point."""
        return self.position

    def moved(self, by: Array) -> PositionGoal:
        """The goal with its point moved, by a vector, shape (3,) [m]."""
        return replace(self, position=self.position + displacement(by))

    @property
    def ball(self) -> Ball:
        """The point and what is near it."""
        return Ball(self.position, self.tolerance)

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Difference of the positions [m]."""
        place, jacobian = self._placed(kinematics, q)
        offset, by_q = place.translation - self.position, jacobian[:3]
        return Place.within(offset, by_q, self.tolerance, self.label("m"))


@record
class PoseGoal(FrameGoal):
    """Bring a frame to a pose.

    Attributes:
        frame: Name of the frame.
        pose: Placement frame_to_world: a ``pinocchio.SE3``, a 4x4 matrix, or a pair of
            a position and a rotation (matrix, quaternion xyzw, SciPy's ``Rotation``);
            kept as a ``pinocchio.SE3``.
        v: Final linear velocity of its origin, shape (3,) [m/s]; None for rest.
        tolerance: Largest distance of the origin from its place [m].
        angle_tolerance: Largest angle between the orientations, about any axis [rad].
    """

    frame: FrameName
    pose: Pose
    v: VelocityOrNone = default(None)
    tolerance: Distance = 0.0
    angle_tolerance: Angle = 0.0

    @property
    def target(self) -> pin.SE3:
        """The pose."""
        return self.pose

    def moved(self, by: Array) -> PoseGoal:
        """The goal with its pose moved, by a vector, shape (3,) [m]."""
        pose = pin.SE3(self.pose.rotation, self.pose.translation + displacement(by))
        return replace(self, pose=pose)

    @property
    def ball(self) -> Ball:
        """Where the pose is, and what is near it."""
        return Ball(np.array(self.pose.translation), self.tolerance)

    def angle_to_go(self, rotation: Array) -> float:
        """Angle to the pose, less its tolerance [rad]."""
        turn = np.linalg.norm(pin.log3(turned(rotation).T @ self.pose.rotation))
        return float(turn) - self.angle_tolerance

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Twist from the goal to the frame, in the frame; parted if it has a range."""
        place, jacobian = self._placed(kinematics, q, local=True)
        if self.tolerance == self.angle_tolerance == 0.0:
            error = self.pose.actInv(place)
            twist = np.asarray(pin.log6(error).vector)
            zero = np.zeros(6)
            labels = (self.label("m"),) * 3 + (self.label("rad"),) * 3
            by_q = np.asarray(pin.Jlog6(error) @ jacobian)
            return Place(twist, by_q, zero, zero, labels)
        offset = place.translation - self.pose.translation
        by_q = place.rotation @ jacobian[:3]
        position = Place.within(offset, by_q, self.tolerance, self.label("m"))
        turn, by_turn = rotation_vector(self.pose.rotation.T @ place.rotation)
        by_q = by_turn @ jacobian[3:]
        return position.joined(
            Place.within(turn, by_q, self.angle_tolerance, self.label("rad"))
        )


@record
class AxisGoal(FrameGoal):
    """Point an axis of a frame into a direction, turned about it in any way.

    Attributes:
        frame: Name of the frame.
        axis: Axis in the frame, shape (3,); of any length.
        direction: Direction in the world, shape (3,); of any length.
        position: Where to bring the frame's origin, in the world, shape (3,) [m]; None
            for anywhere.
        v: Final linear velocity of the origin, shape (3,) [m/s]; None for rest.
        tolerance: Largest distance of the origin from the position [m].
        angle_tolerance: Largest angle between axis and direction [rad].
    """

    frame: FrameName
    axis: Direction
    direction: Direction
    position: PointOrNone = default(None)
    v: VelocityOrNone = default(None)
    tolerance: Distance = 0.0
    angle_tolerance: Angle = 0.0

    @property
    def ball(self) -> Ball | None:
        """The position and what is near it."""
        return None if self.position is None else Ball(self.position, self.tolerance)

    def angle_to_go(self, rotation: Array) -> float:
        """Angle between axis and direction, less its tolerance [rad]."""
        cosine = float(self.direction @ turned(rotation) @ self.axis)
        return math.acos(min(max(cosine, -1.0), 1.0)) - self.angle_tolerance

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Deviation of the axis [rad], two numbers, then that of the origin [m]."""
        place, jacobian = self._placed(kinematics, q)
        axis = np.asarray(place.rotation @ self.axis)
        value, by_axis = deviation(axis, self.direction)
        # The axis turns with w x axis.
        by_q = np.cross(axis, by_axis) @ jacobian[3:]
        found = Place.within(value, by_q, self.angle_tolerance, self.label("rad"))
        if self.position is None:
            return found
        offset = place.translation - self.position
        return found.joined(
            Place.within(offset, jacobian[:3], self.tolerance, self.label("m"))
        )


def displacement(by: Array) -> Array:
    """Check a caller's displacement, shape (3,) [m]."""
    return array(by, "by", (3,), "components [m]")


def turned(rotation: Array) -> Array:
    """Check a caller's rotation matrix, shape (3, 3)."""
    return array(rotation, "rotation", (3, 3), "numbers a row of a matrix")


def rotation_vector(rotation: Array) -> tuple[Array, Array]:
    """Rotation vector [rad] and its derivative by a turn in the axes turned to."""
    return np.asarray(pin.log3(rotation)), np.asarray(pin.Jlog3(rotation))
