"""Constraints on the orientation of a tool, or on the direction of one of its axes."""

from __future__ import annotations

from functools import partial
from typing import Annotated, TypeAlias

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, default, record
from tominpmp.checks import Direction, positive
from tominpmp.constraints.path import EMPTY, FrameRows, Linear
from tominpmp.goals.direction import deviations
from tominpmp.scene.obstacles import Turn

PositiveAngle: TypeAlias = Annotated[float, partial(positive, unit="rad", most=np.pi)]


class FrameAngle(FrameRows):
    """Base class: an angle of a frame stays below the field ``tolerance``."""

    tolerance: PositiveAngle

    bound = "tolerance"
    least_scale = 0.05
    unit = "rad"


@record
class KeepUpright(FrameAngle):
    """An axis of a frame stays within a cone about a direction, at all times.

    The frame may turn about the axis in any way.

    Attributes:
        frame: Name of the frame.
        axis: Axis in the frame, shape (3,); of any length.
        direction: Direction in the world, shape (3,); of any length.
        tolerance: Largest angle between them [rad].

    Raises:
        ProblemError: If a vector is zero, or the tolerance is not positive.
    """

    axis: Direction = default((0.0, 0.0, 1.0))
    direction: Direction = default((0.0, 0.0, 1.0))
    tolerance: PositiveAngle = 0.1

    quantity = "tilt"

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
        return found, by_turn @ jacobian, EMPTY, EMPTY


@record
class AxisFixed(KeepUpright):
    """An axis of a frame keeps a direction, at all times; the frame may spin about it.

    For a drill, a nozzle or a sander: :class:`~tominpmp.KeepUpright` with a narrow
    cone.

    Attributes:
        frame: Name of the frame.
        axis: Axis in the frame, shape (3,); of any length.
        direction: Direction in the world, shape (3,); of any length.
        tolerance: Largest angle between them [rad].

    Raises:
        ProblemError: If a vector is zero, or the tolerance is not positive.
    """

    tolerance: PositiveAngle = 0.01

    quantity = "deviation of the axis"


@record
class KeepOrientation(FrameAngle):
    """A frame keeps an orientation, at all times.

    Attributes:
        frame: Name of the frame.
        rotation: Orientation frame_to_world, a matrix, shape (3, 3), or a quaternion
            xyzw, shape (4,); None for the axes of the world.
        tolerance: Largest angle of the rotation between the two orientations [rad].

    Raises:
        ProblemError: If the rotation is invalid, or the tolerance is not positive.
    """

    rotation: Turn = default((0.0, 0.0, 0.0, 1.0))
    tolerance: PositiveAngle = 0.01

    quantity = "turn"

    def _turns(self, q: Array) -> Array:
        """Rotations of the frame relative to the orientation, shape (m, 3, 3)."""
        return np.asarray(self.rotation.T @ self.motions.placements(q).rotation)

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Angles [rad]."""
        return np.array([np.linalg.norm(pin.log3(turn)) for turn in self._turns(q)])

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Rotation vectors from the orientation to the frame's orientation [rad]."""
        turns = self._turns(q)
        angles = np.array([pin.log3(turn) for turn in turns])
        by_turn = np.array([pin.Jlog3(turn) for turn in turns])
        jacobian = self.motions.jacobians(q, local=True)[:, 3:]
        return angles, by_turn @ jacobian, EMPTY, EMPTY
