"""A load between two fingers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array
from tominpmp.checks import VectorLike, direction
from tominpmp.constraints.held_load import HeldLoad
from tominpmp.constraints.quantity import Linear
from tominpmp.goals.fields import above_zero, checks


@dataclass(frozen=True, eq=False)
class FirmGrasp(HeldLoad):
    """A load between two fingers does not slip.

    Both pads press with a force along an axis, and hold what friction lets them across
    it and about it: within an ellipsoid (the limit surface of Howe and Cutkosky, 1996)
    with the half axes 2 mu F of the force and 2 mu F r of the moment. Along the axis
    the fingers hold whatever is asked for.

    Attributes:
        frame: Name of the frame between the pads.
        force: Force F of each finger [N].
        friction: Coefficient mu of dry friction.
        mass: Mass of the load [kg].
        center: Centre of mass of the load in the frame, shape (3,) [m].
        axis: Axis along which the fingers close, in the frame, shape (3,); of any
            length.
        pad_radius: Effective radius r of the pads [m]: 2/3 of that of a round one.
        inertia: Inertia tensor about the centre of mass, in the axes of the frame,
            shape (3, 3) [kg m^2]; None for a point mass.

    Raises:
        ProblemError: If a value is none, or the axis zero.
    """

    frame: str
    force: float
    friction: float
    mass: float
    center: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    axis: Array = (0.0, 1.0, 0.0)  # type: ignore[assignment]
    pad_radius: float = 0.01
    inertia: Array | None = None

    quantity = "load of the grasp"
    unit = "N"
    falls = "slips out of the fingers"

    if TYPE_CHECKING:

        def __init__(
            self,
            frame: str,
            force: float,
            friction: float,
            mass: float,
            center: VectorLike = ...,
            axis: VectorLike = ...,
            pad_radius: float = ...,
            inertia: ArrayLike | None = ...,
            *,
            during: tuple[float, float] | None = ...,
        ) -> None: ...

    _checks = checks(
        force=above_zero("N"),
        friction=above_zero("1"),
        pad_radius=above_zero("m"),
        axis=direction,
    )

    @property
    def largest(self) -> float:
        """What both pads hold [N]."""
        return 2.0 * self.friction * self.force

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Forces across the axis, and moments about it over the radius [N]."""
        w, by = self.wrench_slopes(q, v, a)
        rows = self._across()
        by_q, by_v, by_a = (rows @ part for part in by)
        return w @ rows.T, by_q, by_v, by_a

    def reason(self, w: Array) -> str:
        """Why it does not hold a wrench, in a clause."""
        return f"they hold no more than {self.largest:.3g} N"

    def _across(self) -> Array:
        """What friction has to hold of a wrench, shape (4, 6)."""
        rows = np.zeros((4, 6))
        rows[:3, :3] = np.eye(3) - np.outer(self.axis, self.axis)
        rows[3, 3:] = self.axis / self.pad_radius
        return rows

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Forces that friction has to hold [N]."""
        across = self.wrenches(q, v, a) @ self._across().T
        return np.asarray(np.linalg.norm(across, axis=1))
