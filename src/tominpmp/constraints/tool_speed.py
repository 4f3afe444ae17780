"""A limit of the speed of a tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.path import FrameLimit

NONE = np.zeros(0)


@dataclass(frozen=True, eq=False)
class ToolSpeed(FrameLimit):
    """The origin of a frame moves no faster than a limit, at all times.

    Attributes:
        frame: Name of the frame.
        limit: Largest speed of its origin in the world [m/s].

    Raises:
        ProblemError: If the limit is no positive number.
    """

    frame: str
    limit: float

    quantity = "speed"
    order = 1
    curable = True
    unit = "m/s"

    @property
    def top_speed(self) -> tuple[str, float]:
        """The frame and the limit."""
        return self.frame, self.limit

    def measure(self, q: Array, v: Array, a: Array) -> float:
        """The speed [m/s]."""
        return float(np.linalg.norm(self.kinematics.velocity(q, v, self.frame)))

    def vector(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array, Array]:
        """The velocity [m/s]."""
        return *self.kinematics.motion(q, v, self.frame), NONE
