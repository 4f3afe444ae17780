"""Keeping an axis of a tool within a cone: a cup that is not to be spilled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import Array
from tominpmp.checks import VectorLike, direction, positive
from tominpmp.constraints.frame import FrameRows
from tominpmp.goals.direction import deviations

NONE = np.zeros(0)
# Narrower cones are measured by this angle, so that rows stay of order one [rad].
LEAST_SCALE = 0.05


class FrameAngle(FrameRows):
    """An angle of a frame below its field ``tolerance``."""

    tolerance: float

    order = 0
    unit = "rad"

    def _check_tolerance(self) -> None:
        """Check the tolerance.

        Raises:
            ProblemError: If it is no angle above zero.
        """
        angle = positive(self.tolerance, "tolerance", self.unit, most=np.pi)
        object.__setattr__(self, "tolerance", angle)

    @property
    def largest(self) -> float:
        """The tolerance."""
        return self.tolerance

    @property
    def scale(self) -> float:
        """The tolerance, or a small angle if it is less."""
        return max(self.tolerance, LEAST_SCALE)


@dataclass(frozen=True, eq=False)
class KeepUpright(FrameAngle):
    """An axis of a frame stays within a cone about a direction, at all times.

    The frame may turn about the axis in any way.

    Attributes:
        frame: Name of the frame.
        axis: Axis in the frame, shape (3,); of any length.
        direction: Direction in the world, shape (3,); of any length.
        tolerance: Largest angle between them [rad].

    Raises:
        ProblemError: If a vector is zero, or the tolerance no angle above zero.
    """

    frame: str
    axis: Array = (0.0, 0.0, 1.0)  # type: ignore[assignment]
    direction: Array = (0.0, 0.0, 1.0)  # type: ignore[assignment]
    tolerance: float = 0.1

    quantity = "tilt"

    if TYPE_CHECKING:

        def __init__(
            self,
            frame: str,
            axis: VectorLike = ...,
            direction: VectorLike = ...,
            tolerance: float = ...,
            *,
            during: tuple[float, float] | None = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        """Check and copy the values."""
        super().__post_init__()
        for name in ("axis", "direction"):
            value = direction(getattr(self, name), name)
            object.__setattr__(self, name, value)
        self._check_tolerance()

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Angles [rad]."""
        turned = self.motions.placements(q).rotation @ self.axis
        sine = np.linalg.norm(np.cross(turned, self.direction), axis=1)
        return np.asarray(np.arctan2(sine, turned @ self.direction))

    def vector_rows(
        self, q: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Deviations of the axis as two angles [rad]."""
        turned = self.motions.placements(q).rotation @ self.axis
        found, by_axis = deviations(turned, self.direction)
        jacobian = self.motions.jacobians(q)[:, 3:]
        # The axis turns with w x axis.
        by_turn = np.cross(turned[:, None, :], by_axis)
        return found, by_turn @ jacobian, NONE, NONE
