"""A limit of the acceleration of a tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.frame import FrameLimit


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

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Accelerations [m/s^2]."""
        found = self.motions.accelerations(q, v, a)
        return np.asarray(np.linalg.norm(found, axis=1))

    def vector_rows(
        self, q: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Accelerations [m/s^2]."""
        return self.motions.acceleration_slopes(q, v, a)
