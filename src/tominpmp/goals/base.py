"""What all goals have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, BoolArray, real_array, real_number
from tominpmp.exceptions import ProblemError, brief
from tominpmp.kinematics import RobotKinematics, prismatic_joints
from tominpmp.robot import Robot


class GoalResidual(NamedTuple):
    """Goal residual at a final state; within its bounds where the goal is reached.

    Attributes:
        value: Shape (k,): positions in m, angles in rad, velocities in m/s or rad/s,
            the velocities last.
        by_q: Derivative with respect to q, shape (k, n).
        by_v: Derivative with respect to v, shape (k, n).
    """

    value: Array
    by_q: Array
    by_v: Array


class Label(NamedTuple):
    """What a number of a residual is about.

    Attributes:
        name: "joint elbow", "frame tip".
        unit: Its unit.
    """

    name: str
    unit: str


class Miss(NamedTuple):
    """By how much a number of a residual is outside its bounds.

    Attributes:
        name: What misses: "joint elbow", "frame tip".
        amount: By how much, zero within the bounds.
        unit: Its unit.
        moving: Whether it is about the velocity, else about the place.
    """

    name: str
    amount: float
    unit: str
    moving: bool


class Place(NamedTuple):
    """What a goal asks of a final configuration.

    Attributes:
        value: Positions in m, angles in rad, shape (k,).
        by_q: Derivative with respect to q, shape (k, n).
        lower: Lower bounds of the values, shape (k,); they do not depend on q.
        upper: Upper bounds, shape (k,); equal to the lower ones for equations.
        labels: What the values are, k of them.
    """

    value: Array
    by_q: Array
    lower: Array
    upper: Array
    labels: tuple[Label, ...]

    @classmethod
    def within(cls, value: Array, by_q: Array, radius: float, label: Label) -> Place:
        """A vector that is to be no longer than a radius.

        Beside its length, which cuts off the corners, the components have bounds too:
        from afar a linear program needs all of them to see which way to go. The length
        is rounded off about zero, where it has no derivative, so that near the radius
        one unit more of it counts as one.

        Args:
            value: The vector, shape (k,).
            by_q: Derivative, shape (k, n).
            radius: Its largest length; zero for an equation.
            label: What the vector is.
        """
        box = np.full(value.size, radius)
        labels = (label,) * value.size
        if radius == 0.0:
            return cls(value, by_q, box, box, labels)
        length = float(np.sqrt(2.0 * (value @ value + radius**2)))
        return cls(
            np.append(value, length),
            np.vstack([by_q, 2.0 * value @ by_q / length]),
            np.append(-box, -np.inf),
            np.append(box, 2.0 * radius),
            (*labels, label),
        )

    def kept(self, which: BoolArray) -> Place:
        """Some of the values."""
        return Place(
            self.value[which],
            self.by_q[which],
            self.lower[which],
            self.upper[which],
            tuple(self.labels[i] for i in np.flatnonzero(which)),
        )

    def joined(self, other: Place) -> Place:
        """These values and others."""
        return Place(
            np.concatenate([self.value, other.value]),
            np.vstack([self.by_q, other.by_q]),
            np.concatenate([self.lower, other.lower]),
            np.concatenate([self.upper, other.upper]),
            self.labels + other.labels,
        )


class Goal(ABC):
    """What must hold at the end of a motion."""

    @abstractmethod
    def validate(self, robot: Robot) -> None:
        """Check the goal against the robot.

        Raises:
            ProblemError: If the goal cannot belong to the robot.
            FrameNotFound: If a frame is not part of it.
            JointNotFound: If a joint is not part of it.
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

    def bounds(self, kinematics: RobotKinematics) -> tuple[Array, Array]:
        """Bounds within which the residual is where the goal is reached.

        Args:
            kinematics: Of the robot.

        Returns:
            Lower and upper bounds, shape (k,) each; zero but for goals with a
            tolerance.
        """
        zero = np.zeros(kinematics.robot.n)
        value = self.residual(kinematics, zero, zero).value
        return np.zeros(value.size), np.zeros(value.size)

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
        speeds = kinematics.robot.n if self.fixes_velocity else 3
        return [
            Miss(label.name, amount, label.unit, i >= len(amounts) - speeds)
            for i, (amount, label) in enumerate(zip(amounts, labels, strict=True))
        ]

    def labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """What the numbers of the residual are, k of them."""
        return (Label("the arm", "rad or m"),) * self.bounds(kinematics)[0].size

    @property
    def configuration(self) -> Array | None:
        """Final configuration, if it is given, shape (n,); None else."""
        return None

    @property
    def frame_name(self) -> str | None:
        """Name of the frame that it is about; None if it is about none."""
        return None

    @property
    def target(self) -> pin.SE3 | Array | None:
        """What is to be drawn of it: a pose, or a point in the world, shape (3,)."""
        return None

    @property
    def ends_moving(self) -> bool:
        """Whether it asks for a velocity other than zero."""
        velocity = getattr(self, "v", None)
        return velocity is not None and bool(np.any(np.asarray(velocity) != 0.0))

    def nearest(self, kinematics: RobotKinematics, q: Array, v: Array) -> Goal:
        """The one of several goals that a final state misses by least; this one."""
        return self

    @property
    def alternatives(self) -> tuple[Goal, ...]:
        """Goals of which any will do; only this one unless it is a set of them."""
        return (self,)


class PlaceGoal(Goal):
    """Goal on where the arm ends; inverse kinematics finds a final configuration.

    The arm ends at rest unless a subclass says otherwise.
    """

    @abstractmethod
    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """What is asked of a configuration of shape (n,), with bounds."""

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
        place = self.place(kinematics, q)
        excess = place.value - np.clip(place.value, place.lower, place.upper)
        outside = (excess != 0.0) | (place.lower == place.upper)
        return excess, np.where(outside[:, None], place.by_q, 0.0)

    def residual(self, kinematics: RobotKinematics, q: Array, v: Array) -> GoalResidual:
        """Residual of place and velocity."""
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
        return v, np.zeros((v.size, v.size)), np.eye(v.size)

    @property
    def fixes_velocity(self) -> bool:
        """The arm ends at rest."""
        return True

    def final_velocity(self, n: int) -> Array:
        """Zero, shape (n,)."""
        return np.zeros(n)

    def bounds(self, kinematics: RobotKinematics) -> tuple[Array, Array]:
        """Bounds of place and velocity; the latter are zero."""
        n = kinematics.robot.n
        place = self.place(kinematics, np.zeros(n))
        speed = np.zeros(n if self.fixes_velocity else 3)
        return (
            np.concatenate([place.lower, speed]),
            np.concatenate([place.upper, speed]),
        )

    def labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """What the values of the place and the velocities are."""
        place = self.place(kinematics, np.zeros(kinematics.robot.n))
        return place.labels + self.motion_labels(kinematics)

    def motion_labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """What the velocities are."""
        return joint_labels(kinematics.robot, "/s")


def joint_labels(robot: Robot, per: str = "") -> tuple[Label, ...]:
    """Labels of values of all joints, which may be rates: per "/s"."""
    slides = prismatic_joints(robot)
    return tuple(
        Label(f"joint {name}", ("m" if slide else "rad") + per)
        for name, slide in zip(robot.joint_names, slides.tolist(), strict=True)
    )


def goal_vector(
    value: object,
    name: str,
    expected: str,
    size: int | None = None,
    *,
    infinite: bool = False,
) -> Array:
    """Check a caller's vector.

    Args:
        value: What the caller gave.
        name: What it is, for the message.
        expected: What it should be.
        size: How many numbers; None for any.
        infinite: Whether they may be infinite.

    Raises:
        ProblemError: If it is none.
    """
    try:
        array = real_array(value)
    except ValueError as error:
        raise ProblemError(
            f"{name} is {brief(value)}, expected {expected}", name
        ) from error
    if array.ndim != 1 or size not in (None, array.size):
        raise ProblemError(
            f"{name} has shape {array.shape}, expected {expected}", field=name
        )
    if np.any(np.isnan(array)) or not (infinite or np.all(np.isfinite(array))):
        which = "none of them NaN" if infinite else "all finite"
        raise ProblemError(
            f"{name} is {array.tolist()}, expected {expected}, {which}", name
        )
    return array


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
    try:
        number = real_number(value)
    except ValueError:
        number = np.nan
    if not 0.0 <= number < most:
        top = "" if np.isinf(most) else f" and < {most:.4g}"
        raise ProblemError(
            f"{name} is {brief(value)}, expected a number >= 0{top} [{unit}]", name
        )
    return number
