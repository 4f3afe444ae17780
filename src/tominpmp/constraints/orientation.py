"""Keeping the orientation of a tool, or one of its axes within a cone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, frozen_array
from tominpmp.checks import RotationLike, VectorLike
from tominpmp.checks import direction as checked_direction
from tominpmp.constraints.frame import FrameRows
from tominpmp.constraints.quantity import Linear
from tominpmp.exceptions import ProblemError, SceneError
from tominpmp.goals.direction import deviations
from tominpmp.goals.fields import above_zero, checks
from tominpmp.scene import rotation_matrix

NONE = np.zeros(0)
# Narrower cones are measured by this angle, so that rows stay of order one [rad].
LEAST_SCALE = 0.05


class FrameAngle(FrameRows):
    """An angle of a frame below its field ``tolerance``."""

    tolerance: float

    order = 0
    unit = "rad"

    _checks = checks(tolerance=above_zero(unit, most=np.pi))

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

    _checks = checks(axis=checked_direction, direction=checked_direction)

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Angles [rad]."""
        turned = self.motions.placements(q).rotation @ self.axis
        sine = np.linalg.norm(np.cross(turned, self.direction), axis=1)
        return np.asarray(np.arctan2(sine, turned @ self.direction))

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Deviations of the axis as two angles [rad]."""
        turned = self.motions.placements(q).rotation @ self.axis
        found, by_axis = deviations(turned, self.direction)
        jacobian = self.motions.jacobians(q)[:, 3:]
        # The axis turns with w x axis.
        by_turn = np.cross(turned[:, None, :], by_axis)
        return found, by_turn @ jacobian, NONE, NONE


@dataclass(frozen=True, eq=False)
class AxisFixed(KeepUpright):
    """An axis of a frame keeps a direction, at all times; the frame may spin about it.

    A drill, a nozzle, a sander: :class:`~tominpmp.KeepUpright` with a narrow cone.

    Attributes:
        frame: Name of the frame.
        axis: Axis in the frame, shape (3,); of any length.
        direction: Direction in the world, shape (3,); of any length.
        tolerance: Largest angle between them [rad].

    Raises:
        ProblemError: If a vector is zero, or the tolerance no angle above zero.
    """

    tolerance: float = 0.01

    quantity = "deviation of the axis"

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


def _checked_rotation(value: RotationLike, name: str) -> Array:
    try:
        return frozen_array(rotation_matrix(value))
    except SceneError as error:
        raise ProblemError(str(error), name) from error


@dataclass(frozen=True, eq=False)
class KeepOrientation(FrameAngle):
    """A frame keeps an orientation, at all times.

    Attributes:
        frame: Name of the frame.
        rotation: Orientation frame_to_world, a matrix, shape (3, 3), or a quaternion
            xyzw, shape (4,).
        tolerance: Largest angle of the rotation between them [rad].

    Raises:
        ProblemError: If the rotation is none, or the tolerance no angle above zero.
    """

    frame: str
    rotation: Array = (0.0, 0.0, 0.0, 1.0)  # type: ignore[assignment]
    tolerance: float = 0.01

    quantity = "turn"

    if TYPE_CHECKING:

        def __init__(
            self,
            frame: str,
            rotation: RotationLike | None = ...,
            tolerance: float = ...,
            *,
            during: tuple[float, float] | None = ...,
        ) -> None: ...

    _checks = checks(rotation=_checked_rotation)

    def _turns(self, q: Array) -> Array:
        return np.asarray(self.rotation.T @ self.motions.placements(q).rotation)

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Angles [rad]."""
        return np.array([np.linalg.norm(pin.log3(turn)) for turn in self._turns(q)])

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Rotation vectors from the orientation to that of the frame [rad]."""
        turns = self._turns(q)
        angles = np.array([pin.log3(turn) for turn in turns])
        by_turn = np.array([pin.Jlog3(turn) for turn in turns])
        jacobian = self.motions.jacobians(q, local=True)[:, 3:]
        return angles, by_turn @ jacobian, NONE, NONE
