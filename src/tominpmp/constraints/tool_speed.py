"""A limit of the speed of a tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.path import PathConstraint, frame_name, positive
from tominpmp.robot import Robot

NONE = np.zeros(0)


@dataclass(frozen=True, eq=False)
class ToolSpeed(PathConstraint):
    """The origin of a frame moves no faster than a limit, at all times.

    Attributes:
        frame: Name of the frame.
        limit: Largest speed of its origin in the world [m/s].

    Raises:
        ProblemError: If the limit is no positive number.
    """

    frame: str
    limit: float

    order = 1
    curable = True
    unit = "m/s"

    def __post_init__(self) -> None:
        """Check the values."""
        frame_name(self.frame)
        object.__setattr__(self, "limit", positive(self.limit, "limit", self.unit))

    @property
    def name(self) -> str:
        """Speed, and of what."""
        return f"speed of {self.subject}"

    @property
    def subject(self) -> str:
        """The frame."""
        return f"frame {self.frame}"

    @property
    def largest(self) -> float:
        """The limit."""
        return self.limit

    def validate(self, robot: Robot) -> None:
        """Check that the robot has the frame."""
        robot.frame_id(self.frame)

    def measure(self, q: Array, v: Array, a: Array) -> float:
        """The speed [m/s]."""
        return float(np.linalg.norm(self.kinematics.velocity(q, v, self.frame)))

    def vector(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array, Array]:
        """The velocity [m/s]."""
        return *self.kinematics.motion(q, v, self.frame), NONE
