"""Base of all goals: what they are asked by those who plan, judge and draw."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.checks import JOINTS, array, instance, number, whole, wrong
from tominpmp.exceptions import ProblemError
from tominpmp.goals.place import Ball, GoalResidual, Label, Miss, Place, joint_labels
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot


class Goal(ABC):
    """What must hold at the end of a motion: a place to end at, and how to end there.

    The arm ends at rest unless a subclass says otherwise.
    """

    @abstractmethod
    def validate(self, robot: Robot) -> None:
        """Check the goal against the robot.

        Raises:
            ProblemError: If the goal cannot belong to the robot.
            FrameNotFound: If a frame is not part of it.
            JointNotFound: If a joint is not part of it.
        """

    @abstractmethod
    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """What is asked of a configuration of shape (n,), with bounds."""

    def moved(self, by: Array) -> Goal:
        """The goal somewhere else in the world.

        Args:
            by: The displacement, shape (3,) [m].

        Raises:
            ProblemError: If it is no place in the world.
        """
        raise wrong(self, "goal", "a position or a pose, which can be moved")

    # -- what a final state lacks ------------------------------------------------------

    def place_residual(
        self, kinematics: RobotKinematics, q: Array
    ) -> tuple[Array, Array]:
        """How far a configuration is from the goal, and the Jacobian of that.

        Args:
            kinematics: Of the robot.
            q: Configuration, shape (n,) [rad or m].

        Returns:
            Excess beyond the bounds, zero where the goal is reached, and its Jacobian,
            shapes (k,) and (k, n).
        """
        return self.place(kinematics, q).residual()

    def residual(self, kinematics: RobotKinematics, q: Array, v: Array) -> GoalResidual:
        """Evaluate the residual at a final state of shape (n,) each."""
        place = self.place(kinematics, q)
        speed, speed_q, speed_v = self.motion_residual(kinematics, q, v)
        return GoalResidual(
            np.concatenate([place.value, speed]),
            np.vstack([place.by_q, speed_q]),
            np.vstack([np.zeros((place.value.size, q.size)), speed_v]),
        )

    def motion_residual(
        self, kinematics: RobotKinematics, q: Array, v: Array
    ) -> tuple[Array, Array, Array]:
        """Residual of the velocity and its derivatives with respect to q and v."""
        v = joint_row(kinematics, v, "v")
        n = v.size
        return v - self.final_velocity(n), np.zeros((n, n)), np.eye(n)

    @property
    def fixes_velocity(self) -> bool:
        """Whether the final joint velocity is known beforehand."""
        return True

    def final_velocity(self, n: int) -> Array:
        """Final joint velocity if it is known beforehand, else zero, shape (n,)."""
        return np.zeros(whole(n, "n"))

    def speed_count(self, n: int) -> int:
        """How many numbers of the residual, the last ones, are about the velocity."""
        return n if self.fixes_velocity else 3

    def bounds(self, kinematics: RobotKinematics) -> tuple[Array, Array]:
        """Bounds within which the residual is where the goal is reached.

        Args:
            kinematics: Of the robot.

        Returns:
            Lower and upper bounds, shape (k,) each; zero but for goals with a
            tolerance.
        """
        n = robot_of(kinematics).n
        place = self.place(kinematics, np.zeros(n))
        speed = np.zeros(self.speed_count(n))
        return (
            np.concatenate([place.lower, speed]),
            np.concatenate([place.upper, speed]),
        )

    def excess(self, kinematics: RobotKinematics, q: Array, v: Array) -> Array:
        """How far the residual is outside its bounds, zero within, shape (k,)."""
        value = self.residual(kinematics, q, v).value
        lower, upper = self.bounds(kinematics)
        return value - np.clip(value, lower, upper)

    def misses(self, kinematics: RobotKinematics, q: Array, v: Array) -> list[Miss]:
        """Say of each number of the residual by how much it is outside its bounds.

        Args:
            kinematics: Of the robot.
            q: Final configuration, shape (n,) [rad or m].
            v: Final velocity, shape (n,).
        """
        amounts = np.abs(self.excess(kinematics, q, v)).tolist()
        labels = self.labels(kinematics)
        speeds = self.speed_count(kinematics.robot.n)
        return [
            Miss(label.name, amount, label.unit, i >= len(amounts) - speeds)
            for i, (amount, label) in enumerate(zip(amounts, labels, strict=True))
        ]

    def labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """What the numbers of the residual are: the place, then the velocities."""
        place = self.place(kinematics, np.zeros(robot_of(kinematics).n))
        return place.labels + self.motion_labels(kinematics)

    def motion_labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """What the velocities are."""
        return joint_labels(robot_of(kinematics), "/s")

    # -- what is known of the end beforehand -------------------------------------------

    @property
    def configuration(self) -> Array | None:
        """Final configuration, if it is given, shape (n,); None else."""
        return None

    def with_state(self, q: Array, v: Array) -> Goal:
        """The goal with another configuration and velocity, where it gives them."""
        return self

    def positions(self, robot: Robot) -> Array:
        """Where joints are to be, as near to within their limits as the goal lets them.

        Args:
            robot: The robot.

        Returns:
            Shape (n,) [rad or m]; NaN of joints that may be anywhere.
        """
        return np.full(instance(robot, Robot, "robot").n, np.nan)

    def joint_ranges(self, robot: Robot) -> tuple[Array, Array]:
        """Ranges that joints end within, shape (n,) each; infinite where none is said.

        Args:
            robot: The robot.
        """
        n = instance(robot, Robot, "robot").n
        return np.full(n, -np.inf), np.full(n, np.inf)

    @property
    def frame_name(self) -> str | None:
        """Name of the frame that it is about; None if it is about none."""
        return None

    @property
    def ball(self) -> Ball | None:
        """Ball that the frame's origin ends in; None where none is all that is said."""
        return None

    def nearest_point(self) -> Array | None:
        """Of all points where the frame may end the nearest to the world's origin.

        None if it may end anywhere.
        """
        return None if self.ball is None else self.ball.nearest_point()

    def distances(self, points: Array) -> Array | None:
        """Distances of points, shape (m, 3), from where the frame may end, shape (m,).

        None if it may end anywhere; negative inside at times.
        """
        if self.ball is None:
            return None
        points = array(points, "points", (None, 3), "coordinates [m]")
        apart = np.linalg.norm(points - self.ball.centre, axis=1)
        return np.asarray(apart - self.ball.radius)

    def angle_to_go(self, rotation: Array) -> float:
        """Least angle by which the frame has to turn from an orientation [rad].

        Args:
            rotation: Of the frame in the world, shape (3, 3).
        """
        return 0.0

    @property
    def target(self) -> pin.SE3 | Array | None:
        """What is to be drawn of it: a pose, or a point in the world, shape (3,)."""
        return None

    @property
    def ends_moving(self) -> bool:
        """Whether it asks for a velocity other than zero."""
        velocity = getattr(self, "v", None)
        return velocity is not None and bool(np.any(np.asarray(velocity) != 0.0))

    def resolved(self, robot: Robot, before: Array | None = None) -> Goal:
        """The goal with values by joint name put into the order of the robot.

        Args:
            robot: The robot.
            before: Where the joints are that are not named, shape (n,) [rad or m]; None
                if that is not known, and all have to be.
        """
        return self

    # -- goals of goals ----------------------------------------------------------------

    @property
    def stopped(self) -> Goal:
        """The goal itself, where it is one that is passed on the way; this one."""
        return self

    def nearest(self, kinematics: RobotKinematics, q: Array, v: Array) -> Goal:
        """The one of several goals that a final state misses by least; this one."""
        return self

    @property
    def alternatives(self) -> tuple[Goal, ...]:
        """Goals of which any will do; only this one unless it is a set of them."""
        return (self,)

    @property
    def members(self) -> tuple[Goal, ...]:
        """Goals that are all to be met; only this one unless it is a set of them."""
        return (self,)

    def prefixed(self, prefix: str, robot: Robot) -> Goal:
        """The goal in the names that joints and frames have beside other robots.

        Args:
            prefix: What stands before their own names: "left/".
            robot: The robot that the goal is for.

        Raises:
            ProblemError: If it cannot be met beside the goals of other robots.
        """
        raise ProblemError(
            f"goal is a {type(self).__name__}, expected a goal on joints or frames",
            "goal",
        )


def robot_of(kinematics: RobotKinematics) -> Robot:
    """The robot of a caller's kinematics.

    Raises:
        ProblemError: If it is none.
    """
    return instance(kinematics, RobotKinematics, "kinematics").robot


def joint_row(kinematics: RobotKinematics, value: Array, name: str) -> Array:
    """Check a caller's numbers, one for each joint of a robot, shape (n,).

    Raises:
        ProblemError: If they are none, or the kinematics.
    """
    return array(value, name, (robot_of(kinematics).n,), JOINTS)


def goal_tolerance(value: object, name: str, unit: str, most: float = np.inf) -> float:
    """Check a caller's tolerance.

    Args:
        value: What the caller gave.
        name: What it is, for the message.
        unit: Its unit.
        most: What it must be below.

    Raises:
        ProblemError: If it is negative, not finite or too large.
    """
    top = "" if np.isinf(most) else f" and < {most:.4g}"
    below = float(np.nextafter(most, 0.0))
    return number(value, name, f"a number >= 0{top} [{unit}]", least=0.0, most=below)
