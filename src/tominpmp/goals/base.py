"""Base class of goals: the interface that planning, verification and pictures use."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, BoolArray
from tominpmp.checks import JOINTS, array, instance, whole, wrong
from tominpmp.exceptions import ProblemError
from tominpmp.goals.place import Ball, GoalResidual, Label, Miss, Place, joint_labels
from tominpmp.goals.turns import MOST_WAYS
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot.robot import Robot


class Goal(ABC):
    """Conditions on the final state of a motion: on configuration and velocity.

    The arm ends at rest unless a subclass defines another final velocity.
    """

    # Whether the goal is a via point: its conditions hold at any velocity.
    _passing: ClassVar[bool] = False

    @abstractmethod
    def validate(self, robot: Robot) -> None:
        """Check the goal against the robot.

        Raises:
            ProblemError: If the goal does not fit the robot.
            FrameNotFound: If a frame is not part of the robot.
            JointNotFound: If a joint is not part of the robot.
        """

    @abstractmethod
    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Values that the goal bounds at a configuration of shape (n,)."""

    def moved(self, by: Array) -> Goal:
        """The goal displaced in the world.

        Args:
            by: The displacement, shape (3,) [m].

        Raises:
            ProblemError: If the goal is not a position or a pose in the world.
        """
        raise wrong(self, "goal", "a position or a pose, which can be moved")

    # -- residuals of a final state ----------------------------------------------------

    def place_residual(
        self, kinematics: RobotKinematics, q: Array
    ) -> tuple[Array, Array]:
        """Deviation of a configuration from the goal, and the Jacobian of it.

        Args:
            kinematics: Kinematics of the robot.
            q: Configuration, shape (n,) [rad or m].

        Returns:
            Excess over the bounds, zero where the goal is reached, shape (k,), and its
            Jacobian, shape (k, n).
        """
        return self.place(kinematics, q).residual()

    def residual(self, kinematics: RobotKinematics, q: Array, v: Array) -> GoalResidual:
        """Evaluate the goal residual at a final state, q and v of shape (n,) each."""
        place = self.place(kinematics, q)
        # A subclass may have a velocity residual of its own, which a via point ignores.
        speeds = self.speed_count(q.size)
        motion = self.motion_residual(kinematics, q, v)
        speed, speed_q, speed_v = (part[:speeds] for part in motion)
        return GoalResidual(
            np.concatenate([place.value, speed]),
            np.vstack([place.by_q, speed_q]),
            np.vstack([np.zeros((place.value.size, q.size)), speed_v]),
        )

    def motion_residual(
        self, kinematics: RobotKinematics, q: Array, v: Array
    ) -> tuple[Array, Array, Array]:
        """Velocity part of the residual, and its derivatives with respect to q, v."""
        v = joint_row(kinematics, v, "v")
        n = v.size
        return v - self.final_velocity(n), np.zeros((n, n)), np.eye(n)

    @property
    def fixes_velocity(self) -> bool:
        """Whether the final joint velocity is known beforehand."""
        return not self._passing

    def final_velocity(self, n: int) -> Array:
        """Final joint velocity if it is known beforehand, else zero, shape (n,)."""
        return np.zeros(whole(n, "n"))

    def speed_count(self, n: int) -> int:
        """Number of velocity components, which come last in the residual."""
        if self._passing:
            return 0
        return n if self.fixes_velocity else 3

    def bounds(self, kinematics: RobotKinematics) -> tuple[Array, Array]:
        """Bounds of the residual: the goal is reached where they hold.

        Args:
            kinematics: Kinematics of the robot.

        Returns:
            Lower and upper bounds, shape (k,) each; zero unless the goal has a
            tolerance.
        """
        n = robot_of(kinematics).n
        place = self.place(kinematics, np.zeros(n))
        speed = np.zeros(self.speed_count(n))
        return np.append(place.lower, speed), np.append(place.upper, speed)

    def excess(self, kinematics: RobotKinematics, q: Array, v: Array) -> Array:
        """Excess of the residual over its bounds, zero within them, shape (k,).

        For a set of alternative goals, it is the excess of the nearest goal.
        """
        goal = self.nearest(kinematics, q, v)
        value = goal.residual(kinematics, q, v).value
        return value - np.clip(value, *goal.bounds(kinematics))

    def misses(self, kinematics: RobotKinematics, q: Array, v: Array) -> list[Miss]:
        """Excess of each residual component over its bounds, with its label.

        Args:
            kinematics: Kinematics of the robot.
            q: Final configuration, shape (n,) [rad or m].
            v: Final velocity, shape (n,) [rad/s or m/s].
        """
        goal = self.nearest(kinematics, q, v)
        amounts = np.abs(goal.excess(kinematics, q, v)).tolist()
        labels, speeds = goal.labels(kinematics), goal.speed_count(q.size)
        return [
            Miss(label.name, amount, label.unit, i >= len(amounts) - speeds)
            for i, (amount, label) in enumerate(zip(amounts, labels, strict=True))
        ]

    def labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """Labels of the residual components: first positions, then velocities."""
        place = self.place(kinematics, np.zeros(robot_of(kinematics).n))
        speeds = self.speed_count(robot_of(kinematics).n)
        return place.labels + self.motion_labels(kinematics)[:speeds]

    def motion_labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """Labels of the velocity components, which come last in the residual."""
        return joint_labels(robot_of(kinematics), "/s")

    # -- the final state as far as the goal determines it ------------------------------

    @property
    def configuration(self) -> Array | None:
        """Final configuration, shape (n,); None if the goal does not fix it."""
        return None

    def with_state(self, q: Array, v: Array) -> Goal:
        """The goal with another final state; unchanged if it does not fix the state."""
        return self

    def positions(self, robot: Robot) -> Array:
        """Joint positions that the goal allows and that violate limits least.

        A position outside its limits shows that the goal cannot be reached.

        Args:
            robot: The robot.

        Returns:
            Shape (n,) [rad or m]; NaN for joints that the goal leaves free.
        """
        return np.full(instance(robot, Robot, "robot").n, np.nan)

    def joint_ranges(self, robot: Robot) -> tuple[Array, Array]:
        """Ranges of the final joint positions, (n,) each [rad or m]; infinite if free.

        Args:
            robot: The robot.
        """
        n = instance(robot, Robot, "robot").n
        return np.full(n, -np.inf), np.full(n, np.inf)

    @property
    def frame_name(self) -> str | None:
        """Name of the goal's frame; None for a goal without a frame."""
        return None

    @property
    def ball(self) -> Ball | None:
        """Ball in which the origin of the frame ends; None for other regions."""
        return None

    def nearest_point(self) -> Array | None:
        """Point nearest to the world's origin at which the frame may end.

        None if the frame may end anywhere.
        """
        return None if self.ball is None else self.ball.nearest_point()

    def distances(self, points: Array) -> Array | None:
        """Distances of points, shape (m, 3), from the region of the frame, (m,) [m].

        None if the frame may end anywhere; negative or zero inside the region.
        """
        if self.ball is None:
            return None
        points = array(points, "points", (None, 3), "coordinates [m]")
        apart = np.linalg.norm(points - self.ball.centre, axis=1)
        return np.asarray(apart - self.ball.radius)

    def angle_to_go(self, rotation: Array) -> float:
        """Least angle by which the frame has to rotate to meet the goal [rad].

        It is negative inside a tolerance.

        Args:
            rotation: Orientation of the frame in the world, shape (3, 3).
        """
        return 0.0

    @property
    def target(self) -> pin.SE3 | Array | None:
        """Marker of the goal in pictures: a pose, or a point, shape (3,) [m]."""
        return None

    @property
    def ends_moving(self) -> bool:
        """Whether the goal asks for a final velocity other than zero."""
        velocity = getattr(self, "v", None)
        return velocity is not None and bool(np.any(np.asarray(velocity) != 0.0))

    def resolved(self, robot: Robot, before: Array | None = None) -> Goal:
        """The goal with values by joint name put into the order of the robot.

        Args:
            robot: The robot.
            before: Positions of joints that the goal does not name, shape (n,) [rad or
                m]; None if they are unknown, and the goal has to name all joints.
        """
        return self

    def wrapped(self, robot: Robot, q: Array, v: Array, most: int = MOST_WAYS) -> Goal:
        """The goal with equivalent joint angles near a start as its alternatives.

        Args:
            robot: The robot.
            q: Start configuration, or the last known one, shape (n,) [rad or m].
            v: Joint velocities at the start, shape (n,) [rad/s or m/s].
            most: Largest number of alternatives of the goal.

        Raises:
            JointNotFound: If a joint declared an angle is not a revolute joint.
        """
        return self

    def angles(self, robot: Robot) -> BoolArray:
        """Joints that may reach the goal after any number of turns, shape (n,)."""
        return np.zeros(instance(robot, Robot, "robot").n, dtype=bool)

    def turns(self, robot: Robot) -> dict[str, int]:
        """Whole turns that were added to the caller's joint positions, by joint."""
        return {}

    # -- goals that consist of goals ---------------------------------------------------

    @property
    def stopped(self) -> Goal:
        """The goal of a via point, at which the arm stops; this goal otherwise."""
        return self._with_passing(False) if self._passing else self

    def _with_passing(self, passing: bool) -> Goal:
        """The goal as a via point, or as a goal at which the arm stops."""
        other = copy.copy(self)
        vars(other).pop("alternatives", None)  # which stop, or pass, as this goal does
        vars(other)["_passing"] = passing
        return other

    def nearest(self, kinematics: RobotKinematics, q: Array, v: Array) -> Goal:
        """The alternative nearest to a final state; this goal without alternatives."""
        return self

    @property
    def alternatives(self) -> tuple[Goal, ...]:
        """Alternative goals of a set; only this goal otherwise."""
        return (self,)

    @property
    def turning(self) -> bool:
        """Whether the alternatives are equivalent joint angles, whole turns apart."""
        return False

    @property
    def choices(self) -> tuple[Goal, ...]:
        """Goals of a set, each with all its turns; the alternatives otherwise."""
        return self.alternatives

    @property
    def members(self) -> tuple[Goal, ...]:
        """Goals of a set that have to be reached together; only this goal otherwise."""
        return (self,)

    def prefixed(self, prefix: str, robot: Robot) -> Goal:
        """The goal with the names that joints and frames have in a combined robot.

        Args:
            prefix: Prefix of the robot's names: "left/".
            robot: The robot of the goal.

        Raises:
            ProblemError: If the goal cannot be combined with goals of other robots.
        """
        raise ProblemError(
            f"goal is of type {type(self).__name__}, expected one on joints or frames",
            "goal",
        )


def robot_of(kinematics: RobotKinematics) -> Robot:
    """The robot of a caller's kinematics.

    Raises:
        ProblemError: If the argument has another type.
    """
    return instance(kinematics, RobotKinematics, "kinematics").robot


def joint_row(kinematics: RobotKinematics, value: Array, name: str) -> Array:
    """Check a caller's joint vector, shape (n,).

    Raises:
        ProblemError: If the numbers, or the kinematics, are invalid.
    """
    return array(value, name, (robot_of(kinematics).n,), JOINTS)
