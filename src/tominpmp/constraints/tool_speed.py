"""Limits of the speed and of the acceleration of a tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.checks import positive
from tominpmp.constraints.frame import FrameRows
from tominpmp.constraints.quantity import Linear

NONE = np.zeros(0)


class FrameLimit(FrameRows):
    """A quantity of a frame below its field ``limit``."""

    limit: float

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        self._keep(limit=positive(self.limit, "limit", self.unit))

    @property
    def largest(self) -> float:
        """The limit."""
        return self.limit


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

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Velocities [m/s]."""
        return *self.motions.velocity_slopes(q, v), NONE


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

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Accelerations [m/s^2]."""
        return self.motions.acceleration_slopes(q, v, a)
