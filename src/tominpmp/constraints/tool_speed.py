"""Limits of the speed and of the acceleration of a tool."""

from __future__ import annotations

from functools import partial
from typing import Annotated, TypeAlias

import numpy as np

from tominpmp.arrays import Array, record
from tominpmp.checks import positive
from tominpmp.constraints.path import EMPTY, FrameRows, Linear

Speed: TypeAlias = Annotated[float, partial(positive, unit="m/s", most=100.0)]
Acceleration: TypeAlias = Annotated[float, partial(positive, unit="m/s^2")]


@record
class ToolSpeed(FrameRows):
    """The origin of a frame moves no faster than a limit, at all times.

    Attributes:
        frame: Name of the frame.
        limit: Largest speed of its origin in the world [m/s], at most 100.

    Raises:
        ProblemError: If the limit is not positive.
    """

    limit: Speed

    quantity = "speed"
    bound = "limit"
    order = 1
    curable = True
    unit = "m/s"

    @property
    def top_speed(self) -> tuple[str, float] | None:
        """The frame and the limit; None if it does not hold for the whole motion."""
        return (self.frame, self.limit) if self.during is None else None

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Speeds [m/s]."""
        return np.asarray(np.linalg.norm(self.motions.velocities(q, v), axis=1))

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Velocities [m/s]."""
        return *self.motions.velocity_slopes(q, v), EMPTY


@record
class ToolAcceleration(FrameRows):
    """The origin of a frame accelerates no more than a limit, at all times.

    Attributes:
        frame: Name of the frame.
        limit: Largest acceleration of its origin in the world [m/s^2].

    Raises:
        ProblemError: If the limit is not positive.
    """

    limit: Acceleration

    quantity = "acceleration"
    bound = "limit"
    order = 2
    curable = True
    unit = "m/s^2"

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Accelerations [m/s^2]."""
        return np.asarray(np.linalg.norm(self.motions.accelerations(q, v, a), axis=1))

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Accelerations [m/s^2]."""
        _, by_q, by_v, by_a = self.motions.slopes(q, v, a)
        return self.motions.accelerations(q, v, a), by_q, by_v, by_a
