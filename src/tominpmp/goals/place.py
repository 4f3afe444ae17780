"""Numbers of a goal at a final state: values, bounds and labels."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.kinematics import RobotKinematics, prismatic_joints

if TYPE_CHECKING:
    from tominpmp.robot.robot import Robot


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
    """Label of a number of a residual.

    Attributes:
        name: "joint elbow", "frame tip".
        unit: Its unit.
    """

    name: str
    unit: str


class Miss(NamedTuple):
    """Excess of a number of a residual over its bounds.

    Attributes:
        name: Its subject: "joint elbow", "frame tip".
        amount: The excess, zero within the bounds.
        unit: Its unit.
        moving: Whether it is a velocity, else a place.
    """

    name: str
    amount: float
    unit: str
    moving: bool


class Place(NamedTuple):
    """Conditions of a goal on a final configuration.

    Attributes:
        value: Positions in m, angles in rad, shape (k,).
        by_q: Derivative with respect to q, shape (k, n).
        lower: Lower bounds of the values, shape (k,); they do not depend on q.
        upper: Upper bounds, shape (k,); equal to the lower ones for equations.
        labels: Labels of the values, k of them.
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
            label: Label of the vector.
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

    @property
    def excess(self) -> Array:
        """Excess of the values over the bounds, zero within, shape (k,)."""
        return self.value - np.clip(self.value, self.lower, self.upper)

    @property
    def lengths(self) -> BoolArray:
        """Whether each value is a length, not an angle, shape (k,)."""
        return np.array([label.unit == "m" for label in self.labels], dtype=bool)

    def residual(self) -> tuple[Array, Array]:
        """The excess, and its derivative with respect to q, shape (k, n)."""
        excess = self.excess
        outside = (excess != 0.0) | (self.lower == self.upper)
        return excess, np.where(outside[:, None], self.by_q, 0.0)

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


class Scales(NamedTuple):
    """Scales of a search for configurations that reach a goal, equivalent to 1 rad.

    Sliding joints move about as far as the goal is away, whatever their travel. Their
    scale is the length of the arm without them, or the distance of the goal if that is
    larger, or their travel if that is smaller.

    Attributes:
        joints: Displacements of the joints, shape (n,): 1, or a length [m].
        lengths: An error in position: a metre, or for shorter arms their length [m].
    """

    joints: Array
    lengths: float

    @classmethod
    def of(cls, kinematics: RobotKinematics, start: Place) -> Scales:
        """Scales of a search.

        Args:
            kinematics: Kinematics of the robot.
            start: Conditions at the first configuration of the search.
        """
        missing = float(np.max(np.abs(start.excess[start.lengths]), initial=0.0))
        length = max(kinematics.reach(travel=0.0), missing) or 1.0
        robot = kinematics.robot
        travel = robot.limits.position_upper - robot.limits.position_lower
        slides = prismatic_joints(robot)
        joints = np.where(slides, np.minimum(length, travel), 1.0)
        return cls(joints, min(length, 1.0))


class Ball(NamedTuple):
    """A ball in the world.

    Attributes:
        centre: Shape (3,) [m].
        radius: [m].
    """

    centre: Array
    radius: float

    def nearest_point(self) -> Array:
        """Its point that is nearest to the origin of the world, shape (3,)."""
        distance = math.hypot(*self.centre)  # does not overflow
        if distance <= self.radius:
            return np.zeros(3)
        return np.asarray(self.centre * (1.0 - self.radius / distance))


def joint_labels(robot: Robot, per: str = "") -> tuple[Label, ...]:
    """Labels of values of all joints, which may be rates: per "/s"."""
    slides = prismatic_joints(robot)
    return tuple(
        Label(f"joint {name}", ("m" if slide else "rad") + per)
        for name, slide in zip(robot.joint_names, slides.tolist(), strict=True)
    )
