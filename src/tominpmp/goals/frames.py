"""Goals on a frame: its position, its pose, the direction of an axis, or a region."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Converted, Record, default, is_single, record
from tominpmp.checks import (
    Corner,
    Direction,
    FrameName,
    Point,
    PointOrNone,
    PoseLike,
    VectorLike,
    array,
    instance,
    non_negative,
    text,
    vector,
    wrong,
)
from tominpmp.exceptions import ProblemError
from tominpmp.goals.base import Goal, joint_row
from tominpmp.goals.direction import across, deviations
from tominpmp.goals.place import Ball, Label, Place
from tominpmp.kinematics import FrameMotions, RobotKinematics
from tominpmp.robot.robot import Robot
from tominpmp.scene.rotations import checked_pose

Distance: TypeAlias = Annotated[float, partial(non_negative, unit="m")]
Angle: TypeAlias = Annotated[float, partial(non_negative, unit="rad", below=np.pi)]
VelocityOrNone: TypeAlias = Annotated[
    Converted[VectorLike | None, Array | None],
    partial(vector, expected="three components [m/s]", size=3),
]

ANGLES = "an angle >= 0 or three angles [rad]"
# Step to which the numbers of goals are rounded when goals are compared [rad or m].
SAME_PLACE = 1e-6


Pose: TypeAlias = Annotated[Converted[PoseLike, pin.SE3], checked_pose]
PoseOrNone: TypeAlias = Annotated[
    Converted[PoseLike | None, pin.SE3 | None], checked_pose
]


class FrameGoal(Record, Goal):
    """Goal on a frame; subclasses define the conditions on its placement.

    Attributes:
        frame: Name of the frame.
        v: Final linear velocity of the frame's origin in the world, shape (3,) [m/s];
            None for an arm at rest.
    """

    frame: FrameName
    v: VelocityOrNone

    _owner = "goal."

    def validate(self, robot: Robot) -> None:
        """Check that the frame exists."""
        instance(robot, Robot, "robot").frame_id(self.frame)

    @property
    def frame_name(self) -> str:
        """Name of the frame."""
        return self.frame

    def prefixed(self, prefix: str, robot: Robot) -> Goal:
        """The goal with the name that its frame has in a combined robot."""
        name = text(prefix, "prefix") + self.frame
        return replace(self, frame=name)  # type: ignore[type-var]

    def _placed(
        self, kinematics: RobotKinematics, q: Array, *, local: bool = False
    ) -> tuple[pin.SE3, Array]:
        """Placement of the frame at a configuration, and the frame Jacobian."""
        q = joint_row(kinematics, q, "q")
        jacobian = kinematics.jacobian(q, self.frame, local=local)
        return kinematics.placement(q, self.frame), jacobian

    def motion_residual(
        self, kinematics: RobotKinematics, q: Array, v: Array
    ) -> tuple[Array, Array, Array]:
        """Velocity part of the residual: of the joints, or of the frame's origin."""
        if self.v is None:
            return super().motion_residual(kinematics, q, v)
        v = joint_row(kinematics, v, "v")
        motions = FrameMotions(kinematics.robot, self.frame)
        slopes = motions.velocity_slopes(q[None], v[None])
        velocity, by_q, by_v = (part[0] for part in slopes)
        return velocity - self.v, by_q, by_v

    def label(self, unit: str) -> Label:
        """Label of a residual component of the frame."""
        return Label(f"frame {self.frame}", unit)

    def motion_labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """Labels of the velocity components, of the joints or of the frame."""
        if self.v is None:
            return super().motion_labels(kinematics)
        return (self.label("m/s"),) * 3

    @property
    def fixes_velocity(self) -> bool:
        """The final joint velocity is known if the arm ends at rest."""
        return self.v is None and super().fixes_velocity


@record
class PositionGoal(FrameGoal):
    """Bring the origin of a frame to a point, in any orientation.

    Attributes:
        frame: Name of the frame.
        position: Point in the world, shape (3,) [m].
        v: Final linear velocity of the frame's origin, shape (3,) [m/s]; None for an
            arm at rest.
        tolerance: Largest distance from the point [m].
    """

    frame: FrameName
    position: Point
    v: VelocityOrNone = default(None)
    tolerance: Distance = 0.0

    @property
    def target(self) -> Array:
        """The point, shape (3,) [m]."""
        return self.position

    def moved(self, by: Array) -> PositionGoal:
        """The goal with its point displaced by a vector, shape (3,) [m]."""
        return replace(self, position=self.position + _displacement(by))

    @property
    def ball(self) -> Ball:
        """Ball of the tolerance about the point."""
        return Ball(self.position, self.tolerance)

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Offset of the frame's origin from the point [m], and its bounds."""
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
            stored as a ``pinocchio.SE3``.
        v: Final linear velocity of the frame's origin, shape (3,) [m/s]; None for an
            arm at rest.
        tolerance: Largest distance of the frame's origin from the origin of the pose
            [m].
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
        """The goal with its pose displaced by a vector, shape (3,) [m]."""
        pose = pin.SE3(self.pose.rotation, self.pose.translation + _displacement(by))
        return replace(self, pose=pose)

    @property
    def ball(self) -> Ball:
        """Ball of the tolerance about the origin of the pose."""
        return Ball(np.array(self.pose.translation), self.tolerance)

    def angle_to_go(self, rotation: Array) -> float:
        """Angle to the orientation of the pose, minus its tolerance [rad]."""
        turn = np.linalg.norm(pin.log3(_matrix(rotation).T @ self.pose.rotation))
        return float(turn) - self.angle_tolerance

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Conditions on the pose of the frame.

        Without tolerances the values are the twist from the goal to the frame, in the
        axes of the frame; otherwise offset and rotation vector with separate bounds.
        """
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
        turn, by_turn = _rotation_vector(self.pose.rotation.T @ place.rotation)
        by_q = by_turn @ jacobian[3:]
        return position.joined(
            Place.within(turn, by_q, self.angle_tolerance, self.label("rad"))
        )


@record
class AxisGoal(FrameGoal):
    """Point an axis of a frame in a direction, with any rotation about the axis.

    Attributes:
        frame: Name of the frame.
        axis: Axis in the frame, shape (3,); of any length.
        direction: Direction in the world, shape (3,); of any length.
        position: Point for the frame's origin in the world, shape (3,) [m]; None leaves
            the position free.
        v: Final linear velocity of the frame's origin, shape (3,) [m/s]; None for an
            arm at rest.
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
        """Ball of the tolerance about the position; None without a position."""
        return None if self.position is None else Ball(self.position, self.tolerance)

    def angle_to_go(self, rotation: Array) -> float:
        """Angle between axis and direction, minus its tolerance [rad]."""
        cosine = float(self.direction @ _matrix(rotation) @ self.axis)
        return math.acos(min(max(cosine, -1.0), 1.0)) - self.angle_tolerance

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Deviation of the axis, two components [rad], and offset of the origin [m]."""
        place, jacobian = self._placed(kinematics, q)
        axis = np.asarray(place.rotation @ self.axis)
        value, by_axis = (x[0] for x in deviations(axis[None], self.direction))
        # The rate of the axis is the cross product of angular velocity and axis.
        by_q = by_axis @ pin.skew(axis).T @ jacobian[3:]
        tilt = Place.within(value, by_q, self.angle_tolerance, self.label("rad"))
        if self.position is None:
            return tilt
        offset = place.translation - self.position
        return tilt.joined(
            Place.within(offset, jacobian[:3], self.tolerance, self.label("m"))
        )


def _checked_angles(value: Any, name: str) -> float | Array:
    """Check a caller's angle tolerances: one for all axes, or one for each axis."""
    single = is_single(value)
    row, size = ([value], 1) if single else (value, 3)
    angles = vector(row, name, ANGLES, size, most=np.inf)
    if np.any(angles < 0.0):
        raise wrong(value, name, ANGLES)
    angles = vector(np.minimum(angles, np.pi), name, ANGLES)
    return float(angles[0]) if single else angles


Angles: TypeAlias = Annotated[Converted[ArrayLike, float | Array], _checked_angles]


class BoxRegion(Record):
    """A box for the origin of a frame: its corners and its placement in the world."""

    lower: Corner
    upper: Corner
    pose: PoseOrNone

    def __post_init__(self) -> None:
        """Check the corners."""
        super().__post_init__()
        for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
            if low > high or low == np.inf or high == -np.inf:
                name = self._owner
                raise ProblemError(
                    f"{name}lower is {low:g} and {name}upper {high:g} along {axis}, "
                    "expected the lower corner below the upper corner",
                    f"{name}lower",
                )

    @property
    def _box(self) -> pin.SE3:
        """Placement of the box in the world."""
        return pin.SE3.Identity() if self.pose is None else self.pose

    def _local(self, points: Array) -> Array:
        """Coordinates of world points in the frame of the box, shape (m, 3) [m]."""
        return np.asarray((points - self._box.translation) @ self._box.rotation)

    def _apart(self, points: Array) -> Array:
        """Distances of points (m, 3) from the box, zero inside, shape (m,) [m]."""
        local = self._local(points)
        out = local - np.clip(local, self.lower, self.upper)
        return np.asarray(np.linalg.norm(out, axis=1))


@record
class RegionGoal(FrameGoal, BoxRegion):
    """Bring the origin of a frame into a box, in any orientation or a range of them.

    The goal combines MoveIt's position constraint with a box and its orientation
    constraint with tolerances about three axes.

    Attributes:
        frame: Name of the frame.
        lower: Lower corner of the box, along the axes of the pose, shape (3,) [m];
            minus infinity where the box is unbounded.
        upper: Upper corner of the box, shape (3,) [m]; infinity where it is unbounded.
        pose: Placement box_to_world; None for the placement of the world frame.
        angle_tolerance: Largest component of the rotation vector from the axes of the
            pose to the axes of the frame, one number for all axes or shape (3,) [rad];
            pi for any angle.
        v: Final linear velocity of the frame's origin, shape (3,) [m/s]; None for an
            arm at rest.
    """

    frame: FrameName
    lower: Corner
    upper: Corner
    pose: PoseOrNone = default(None)
    angle_tolerance: Angles = default(np.pi)
    v: VelocityOrNone = default(None)

    def __post_init__(self) -> None:
        """Check and copy the values."""
        super().__post_init__()
        bounded = np.any(np.isfinite([self.lower, self.upper]))
        if not (bounded or np.any(self._angles < np.pi)):
            raise ProblemError(
                "goal: the box is infinite and any orientation is allowed: the goal "
                "has no condition",
                "goal",
            )

    @property
    def _angles(self) -> Array:
        """Angle tolerance of each axis, shape (3,) [rad]; pi for any angle."""
        return np.broadcast_to(self.angle_tolerance, 3)

    def nearest_point(self) -> Array:
        """Point of the box that is nearest to the world's origin, shape (3,) [m]."""
        origin = np.asarray(self._box.actInv(np.zeros(3)))
        return np.asarray(self._box.act(np.clip(origin, self.lower, self.upper)))

    def distances(self, points: Array) -> Array:
        """Distances of points (m, 3) from the box, zero inside, shape (m,) [m]."""
        return self._apart(array(points, "points", (None, 3), "coordinates [m]"))

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Position in the frame of the box [m], and rotation vector from it [rad]."""
        pose = self._box
        in_world, jacobian = self._placed(kinematics, q, local=True)
        place = pose.actInv(in_world)
        position = Place(
            np.asarray(place.translation),
            place.rotation @ jacobian[:3],
            self.lower,
            self.upper,
            (self.label("m"),) * 3,
        ).selected(np.isfinite(self.lower) | np.isfinite(self.upper))
        bounded = self._angles < np.pi
        if not np.any(bounded):
            return position
        turn, by_turn = _rotation_vector(np.asarray(place.rotation))
        by_q, labels = by_turn @ jacobian[3:], (self.label("rad"),) * 3
        rotation = Place(turn, by_q, -self._angles, self._angles, labels)
        return position.joined(rotation.selected(bounded))


def _displacement(by: Array) -> Array:
    """Check a caller's displacement, shape (3,) [m]."""
    return array(by, "by", (3,), "components [m]")


def _matrix(rotation: Array) -> Array:
    """Check a caller's rotation matrix, shape (3, 3)."""
    return array(rotation, "rotation", (3, 3), "numbers a row of a matrix")


def _rotation_vector(rotation: Array) -> tuple[Array, Array]:
    """Rotation vector, (3,) [rad], and its Jacobian about the rotated axes, (3, 3)."""
    return np.asarray(pin.log3(rotation)), np.asarray(pin.Jlog3(rotation))


class FrameTarget(NamedTuple):
    """Target of a frame, without tolerances.

    Attributes:
        place: Position, shape (3,) [m]; zero where the goal leaves it free.
        turn: Orientation, shape (3, 3); for an axis goal the axis in the frame in the
            first row, and the direction in the world in the second row; zero for a
            point.
        counts: Matrix that selects the components of a rotation and a displacement on
            which the goal has conditions, shape (6, 6).
        posed: Whether the goal fixes the whole orientation.
    """

    place: Array
    turn: Array
    counts: Array
    posed: bool


def frame_target(goal: Goal) -> FrameTarget | None:
    """Target of a goal on a pose, an axis or a point; None for other goals."""
    counts, turn, place = np.zeros((6, 6)), np.zeros((3, 3)), np.zeros(3)
    if isinstance(goal, PoseGoal):
        counts[:3, :3], turn = np.eye(3), np.array(goal.pose.rotation)
    elif isinstance(goal, AxisGoal):
        counts[:2, :3] = across(np.array(goal.direction))
        turn[0], turn[1] = goal.axis, goal.direction
    elif not isinstance(goal, PositionGoal):
        return None
    if goal.ball is not None:
        counts[3:, 3:], place = np.eye(3), np.array(goal.ball.centre)
    return FrameTarget(place, turn, counts, isinstance(goal, PoseGoal))


def place_of(goal: Goal) -> object:
    """Hashable key of a goal's target, equal for goals that differ by rounding."""
    target, numbers = frame_target(goal), goal.configuration
    if target is not None:
        numbers = np.concatenate([np.ravel(part) for part in target])
    if numbers is None:
        return goal
    return goal.frame_name, tuple(np.round(numbers / SAME_PLACE).tolist())
