"""Keeping the orientation of a tool, or one of its axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, frozen_array
from tominpmp.checks import RotationLike, VectorLike
from tominpmp.constraints.upright import FrameAngle, KeepUpright
from tominpmp.exceptions import ProblemError, SceneError
from tominpmp.scene import rotation_matrix

NONE = np.zeros(0)


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

    def __post_init__(self) -> None:
        """Check and copy the values."""
        super().__post_init__()
        try:
            rotation = rotation_matrix(self.rotation)
        except SceneError as error:
            raise ProblemError(str(error), "rotation") from error
        object.__setattr__(self, "rotation", frozen_array(rotation))
        self._check_tolerance()

    def _turns(self, q: Array) -> Array:
        return np.asarray(self.rotation.T @ self.motions.placements(q).rotation)

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Angles [rad]."""
        return np.array([np.linalg.norm(pin.log3(turn)) for turn in self._turns(q)])

    def vector_rows(
        self, q: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Rotation vectors from the orientation to that of the frame [rad]."""
        turns = self._turns(q)
        angles = np.array([pin.log3(turn) for turn in turns])
        by_turn = np.array([pin.Jlog3(turn) for turn in turns])
        jacobian = self.motions.jacobians(q, local=True)[:, 3:]
        return angles, by_turn @ jacobian, NONE, NONE
