"""A limit of the acceleration of a tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.path import FrameLimit


@dataclass(frozen=True, eq=False)
class ToolAcceleration(FrameLimit):
    """The origin of a frame accelerates no more than a limit, at all times.

    Attributes:
        frame: Name of the frame.
        limit: Largest acceleration of its origin in the world [m/s^2].

    Raises:
        ProblemError: If the limit is no positive number.
    """

    frame: str
    limit: float

    quantity = "acceleration"
    order = 2
    unit = "m/s^2"

    def measure(self, q: Array, v: Array, a: Array) -> float:
        """The acceleration [m/s^2]."""
        return float(np.linalg.norm(self.kinematics.acceleration(q, v, a, self.frame)))

    def vector(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array, Array]:
        """The acceleration [m/s^2]."""
        return self.kinematics.accelerated_motion(q, v, a, self.frame)
