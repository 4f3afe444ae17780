"""A limit of the speed of a tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.frame import FrameLimit

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
    def top_speed(self) -> tuple[str, float] | None:
        """The frame and the limit; None where it holds during a part of the motion."""
        return (self.frame, self.limit) if self.during is None else None

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Speeds [m/s]."""
        return np.asarray(np.linalg.norm(self.motions.velocities(q, v), axis=1))

    def vector_rows(
        self, q: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Velocities [m/s]."""
        return *self.motions.velocity_slopes(q, v), NONE
