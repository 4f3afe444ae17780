"""Base of all goals: their interface for planning, judging and drawing."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.checks import JOINTS, array, instance, number, whole, wrong
from tominpmp.exceptions import ProblemError
from tominpmp.goals.place import Ball, GoalResidual, Label, Miss, Place, joint_labels
from tominpmp.goals.turns import MOST_WAYS
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot.robot import Robot


class Goal(ABC):
    """Conditions at the end of a motion: a place, and a velocity there.

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
        """Conditions on a configuration of shape (n,), with bounds."""

    def moved(self, by: Array) -> Goal:
        """The goal displaced in the world.

        Args:
            by: The displacement, shape (3,) [m].

        Raises:
            ProblemError: If the goal has no place in the world.
        """
        raise wrong(self, "goal", "a position or a pose, which can be moved")

    # -- residuals of a final state ----------------------------------------------------

    def place_residual(
        self, kinematics: RobotKinematics, q: Array
    ) -> tuple[Array, Array]:
        """Deviation of a configuration from the goal, and its Jacobian.

        Args:
            kinematics: Kinematics of the robot.
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
        """Number of velocities in the residual, its last numbers."""
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
        return np.append(place.lower, speed), np.append(place.upper, speed)

    def excess(self, kinematics: RobotKinematics, q: Array, v: Array) -> Array:
        """Excess of the residual over its bounds, zero within, shape (k,).

        Of a set of goals that of the nearest goal.
        """
        goal = self.nearest(kinematics, q, v)
        value = goal.residual(kinematics, q, v).value
        return value - np.clip(value, *goal.bounds(kinematics))

    def misses(self, kinematics: RobotKinematics, q: Array, v: Array) -> list[Miss]:
        """Excess of each number of the residual over its bounds, with its label.

        Args:
            kinematics: Of the robot.
            q: Final configuration, shape (n,) [rad or m].
            v: Final velocity, shape (n,).
        """
        goal = self.nearest(kinematics, q, v)
        amounts = np.abs(goal.excess(kinematics, q, v)).tolist()
        labels, speeds = goal.labels(kinematics), goal.speed_count(q.size)
        return [
            Miss(label.name, amount, label.unit, i >= len(amounts) - speeds)
            for i, (amount, label) in enumerate(zip(amounts, labels, strict=True))
        ]

    def labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """Labels of the numbers of the residual: of the place, then of velocities."""
        place = self.place(kinematics, np.zeros(robot_of(kinematics).n))
        return place.labels + self.motion_labels(kinematics)

    def motion_labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """Labels of the numbers of the residual that are velocities, its last ones."""
        return joint_labels(robot_of(kinematics), "/s")

    # -- the end of the motion as far as the goal determines it ------------------------

    @property
    def configuration(self) -> Array | None:
        """Final configuration, if the goal gives it, shape (n,); else None."""
        return None

    def with_state(self, q: Array, v: Array) -> Goal:
        """The goal with another configuration and velocity, where it gives them."""
        return self

    def positions(self, robot: Robot) -> Array:
        """Positions of the joints, as near to their limits as the goal allows.

        Args:
            robot: The robot.

        Returns:
            Shape (n,) [rad or m]; NaN for joints that may be anywhere.
        """
        return np.full(instance(robot, Robot, "robot").n, np.nan)

    def joint_ranges(self, robot: Robot) -> tuple[Array, Array]:
        """Ranges of the final positions of joints, shape (n,) each; infinite if free.

        Args:
            robot: The robot.
        """
        n = instance(robot, Robot, "robot").n
        return np.full(n, -np.inf), np.full(n, np.inf)

    @property
    def frame_name(self) -> str | None:
        """Name of the frame of the goal; None without a frame."""
        return None

    @property
    def ball(self) -> Ball | None:
        """Ball in which the frame's origin ends; None for other regions."""
        return None

    def nearest_point(self) -> Array | None:
        """Nearest point to the origin of the world at which the frame may end.

        None if it may end anywhere.
        """
        return None if self.ball is None else self.ball.nearest_point()

    def distances(self, points: Array) -> Array | None:
        """Distances of points, shape (m, 3), from the region of the frame, shape (m,).

        None if the frame may end anywhere; possibly negative inside the region.
        """
        if self.ball is None:
            return None
        points = array(points, "points", (None, 3), "coordinates [m]")
        apart = np.linalg.norm(points - self.ball.centre, axis=1)
        return np.asarray(apart - self.ball.radius)

    def angle_to_go(self, rotation: Array) -> float:
        """Least angle by which the frame has to turn from an orientation [rad].

        Args:
            rotation: Rotation of the frame in the world, shape (3, 3).
        """
        return 0.0

    @property
    def target(self) -> pin.SE3 | Array | None:
        """Mark of the goal in pictures: a pose, or a point in the world, shape (3,)."""
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
            before: Positions of the joints that are not named, shape (n,) [rad or m];
                None if unknown, where all joints have to be named.
        """
        return self

    def wrapped(self, robot: Robot, q: Array, v: Array, most: int = MOST_WAYS) -> Goal:
        """The goal with the turns of joints that are angles, as seen from a start.

        Args:
            robot: The robot.
            q: Where it starts, or was last known to be, shape (n,) [rad or m].
            v: Velocities at the start, shape (n,).
            most: Largest number of alternatives to make of one goal.

        Raises:
            JointNotFound: If a joint that is to be an angle is none that turns.
        """
        return self

    def turns(self, robot: Robot) -> dict[str, int]:
        """Whole turns that were added to the numbers given for joints, by joint."""
        return {}

    # -- goals of goals ----------------------------------------------------------------

    @property
    def stopped(self) -> Goal:
        """The goal of a passed goal; this goal otherwise."""
        return self

    def nearest(self, kinematics: RobotKinematics, q: Array, v: Array) -> Goal:
        """The nearest goal of a set to a final state; this goal otherwise."""
        return self

    @property
    def alternatives(self) -> tuple[Goal, ...]:
        """Alternative goals of a set; only this goal otherwise."""
        return (self,)

    @property
    def turning(self) -> bool:
        """Whether its alternatives are turns of angles."""
        return False

    @property
    def choices(self) -> tuple[Goal, ...]:
        """Goals of a set, each with all its turns; the alternatives otherwise."""
        return self.alternatives

    @property
    def members(self) -> tuple[Goal, ...]:
        """Goals of a set that are all to be met; only this goal otherwise."""
        return (self,)

    def prefixed(self, prefix: str, robot: Robot) -> Goal:
        """The goal with the names that joints and frames have in a combined robot.

        Args:
            prefix: Prefix of the own names: "left/".
            robot: The robot of the goal.

        Raises:
            ProblemError: If it cannot be combined with goals of other robots.
        """
        raise ProblemError(
            f"goal is a {type(self).__name__}, expected a goal on joints or frames",
            "goal",
        )


def robot_of(kinematics: RobotKinematics) -> Robot:
    """The robot of a caller's kinematics.

    Raises:
        ProblemError: If the argument has another type.
    """
    return instance(kinematics, RobotKinematics, "kinematics").robot


def joint_row(kinematics: RobotKinematics, value: Array, name: str) -> Array:
    """Check a caller's numbers, one for each joint of a robot, shape (n,).

    Raises:
        ProblemError: If the numbers, or the kinematics, are invalid.
    """
    return array(value, name, (robot_of(kinematics).n,), JOINTS)


def goal_tolerance(value: object, name: str, unit: str, most: float = np.inf) -> float:
    """Check a caller's tolerance.

    Args:
        value: Value from the caller.
        name: Name in the message.
        unit: Its unit.
        most: Exclusive upper bound.

    Raises:
        ProblemError: If it is negative, not finite or too large.
    """
    top = "" if np.isinf(most) else f" and < {most:.4g}"
    below = float(np.nextafter(most, 0.0))
    return number(value, name, f"a number >= 0{top} [{unit}]", least=0.0, most=below)
