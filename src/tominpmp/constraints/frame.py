"""Constraints on a frame of the robot."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from tominpmp.arrays import Array, record
from tominpmp.checks import FrameName, instance
from tominpmp.constraints.path import PathConstraint
from tominpmp.constraints.quantity import Linear, Quantity, one_row
from tominpmp.kinematics import FrameMotions
from tominpmp.robot import Robot


@record
class FrameRows(PathConstraint):
    """A constraint on a frame of the robot, evaluated at many states at once.

    Subclasses give :meth:`measure_rows` and :meth:`vector_rows`, or else
    :meth:`value_rows` and :meth:`term_rows`.

    Attributes:
        frame: Name of the frame.
    """

    frame: FrameName
    quantity: ClassVar[str]

    @property
    def name(self) -> str:
        """The quantity, and of what."""
        return f"{self.quantity} of {self.subject}"

    @property
    def subject(self) -> str:
        """The frame."""
        return f"frame {self.frame}"

    def validate(self, robot: Robot) -> None:
        """Check that the robot has the frame."""
        instance(robot, Robot, "robot").frame_id(self.frame)

    @property
    def motions(self) -> FrameMotions:
        """Placements and motions of the frame."""
        found = self.__dict__.get("_motions")
        if found is None:
            found = FrameMotions(self.kinematics.robot, self.frame)
            self.__dict__["_motions"] = found
        assert isinstance(found, FrameMotions)  # noqa: S101
        return found

    def measure(self, q: Array, v: Array, a: Array) -> float:
        """The quantity at one state."""
        return float(self.measure_rows(*one_row(q, v, a))[0])

    def vector(self, q: Array, v: Array, a: Array) -> Linear:
        """The vector at one state."""
        if type(self).vector_rows is Quantity.vector_rows:
            return super().vector(q, v, a)
        vector, *by = self.vector_rows(*one_row(q, v, a))
        by_q, by_v, by_a = (part[0] if part.size else np.zeros(0) for part in by)
        return vector[0], by_q, by_v, by_a
