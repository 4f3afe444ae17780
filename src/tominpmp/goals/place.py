"""Residuals of goals at final states: values, bounds and labels."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.kinematics import RobotKinematics, prismatic_joints, units_of

if TYPE_CHECKING:
    from tominpmp.robot.robot import Robot


class GoalResidual(NamedTuple):
    """Goal residual at a final state; within its bounds where the goal is reached.

    Attributes:
        value: Residual components, shape (k,): positions in m, angles in rad, and last
            velocities in m/s or rad/s.
        by_q: Jacobian with respect to q, shape (k, n).
        by_v: Jacobian with respect to v, shape (k, n).
    """

    value: Array
    by_q: Array
    by_v: Array


class Label(NamedTuple):
    """Label of a residual component.

    Attributes:
        name: Joint or frame that it belongs to: "joint elbow", "frame tip".
        unit: Unit of the component.
    """

    name: str
    unit: str


class Miss(NamedTuple):
    """Excess of a residual component over its bounds.

    Attributes:
        name: Joint or frame that the component belongs to: "joint elbow", "frame tip".
        amount: The excess, zero within the bounds.
        unit: Unit of the component.
        moving: Whether the component is a velocity; otherwise it is a position or an
            angle.
    """

    name: str
    amount: float
    unit: str
    moving: bool


class Place(NamedTuple):
    """Conditions of a goal on a final configuration: bounded values.

    Attributes:
        value: Positions in m, angles in rad, shape (k,).
        by_q: Jacobian with respect to q, shape (k, n).
        lower: Lower bounds of the values, shape (k,); they do not depend on q.
        upper: Upper bounds, shape (k,); equal to the lower bounds for equations.
        labels: Labels of the k values.
    """

    value: Array
    by_q: Array
    lower: Array
    upper: Array
    labels: tuple[Label, ...]

    @classmethod
    def within(cls, value: Array, by_q: Array, radius: float, label: Label) -> Place:
        """Conditions that the length of a vector does not exceed a radius.

        The components are bounded, too, in addition to the length, which cuts off the
        corners of their box: far from the goal a linear program needs all components
        for its direction of descent. The length is smoothed about zero, where it is not
        differentiable, and scaled so that its slope at the radius is one.

        Args:
            value: The vector, shape (k,).
            by_q: Jacobian of the vector, shape (k, n).
            radius: Largest length of the vector; zero for an equation.
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
        """Excess of the values over their bounds, zero within them, shape (k,)."""
        return self.value - np.clip(self.value, self.lower, self.upper)

    @property
    def lengths(self) -> BoolArray:
        """Whether each value is a length; otherwise it is an angle, shape (k,)."""
        return np.array([label.unit == "m" for label in self.labels], dtype=bool)

    def residual(self) -> tuple[Array, Array]:
        """The excess, shape (k,), and its Jacobian with respect to q, shape (k, n)."""
        excess = self.excess
        outside = (excess != 0.0) | (self.lower == self.upper)
        return excess, np.where(outside[:, None], self.by_q, 0.0)

    def selected(self, mask: BoolArray) -> Place:
        """The conditions on the values of a mask, shape (k,)."""
        labels = tuple(self.labels[i] for i in np.flatnonzero(mask))
        return Place._make([*(part[mask] for part in self[:4]), labels])

    def joined(self, other: Place) -> Place:
        """These conditions, followed by other conditions."""
        pairs = zip(self[:4], other[:4], strict=True)
        labels = self.labels + other.labels
        return Place._make([*map(np.concatenate, pairs), labels])


class Scales(NamedTuple):
    """Scales that make lengths comparable with angles in a search for configurations.

    A prismatic joint moves about as far as the goal is away, whatever its travel. Its
    scale is the reach of the arm without the travel of prismatic joints, or the
    distance of the goal if it is larger, or the travel of the joint if it is smaller.

    Attributes:
        joints: Displacement of each joint that counts as 1 rad, shape (n,): 1 for
            revolute joints, a length for prismatic joints [m].
        lengths: Position error that counts as 1 rad [m]: one metre, or the larger of
            reach and distance if it is shorter.
    """

    joints: Array
    lengths: float

    @classmethod
    def of(cls, kinematics: RobotKinematics, start: Place) -> Scales:
        """Scales of a search that starts at a configuration.

        Args:
            kinematics: Kinematics of the robot.
            start: Conditions of the goal at the first configuration of the search.
        """
        missing = float(np.max(np.abs(start.excess[start.lengths]), initial=0.0))
        length = max(kinematics.reach(travel=0.0), missing) or 1.0
        robot = kinematics.robot
        travel = robot.limits.position_upper - robot.limits.position_lower
        slides = prismatic_joints(robot)
        joints = np.where(slides, np.minimum(length, travel), 1.0)
        return cls(joints, min(length, 1.0))


class Ball(NamedTuple):
    """A ball in the world frame.

    Attributes:
        centre: Centre, shape (3,) [m].
        radius: Radius [m].
    """

    centre: Array
    radius: float

    def nearest_point(self) -> Array:
        """Point of the ball that is nearest to the world's origin, shape (3,) [m]."""
        distance = math.hypot(*self.centre)  # does not overflow
        if distance <= self.radius:
            return np.zeros(3)
        return np.asarray(self.centre * (1.0 - self.radius / distance))


def joint_labels(robot: Robot, per: str = "") -> tuple[Label, ...]:
    """Labels of values of all joints; "/s" is appended to the units of rates."""
    return tuple(
        Label(f"joint {name}", unit + per)
        for name, unit in zip(robot.joint_names, units_of(robot), strict=True)
    )
