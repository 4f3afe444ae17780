"""A load between two fingers."""

from __future__ import annotations

from functools import partial
from typing import Annotated, TypeAlias

import numpy as np

from tominpmp.arrays import Array, default, record
from tominpmp.checks import Direction, Metres, Point, positive
from tominpmp.constraints.held_load import Coefficient, HeldLoad, Kilograms
from tominpmp.constraints.path import Linear
from tominpmp.robot.payload import InertiaOrNone

Newtons: TypeAlias = Annotated[float, partial(positive, unit="N")]


@record
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

    force: Newtons
    friction: Coefficient
    mass: Kilograms
    center: Point = default((0.0, 0.0, 0.0))
    axis: Direction = default((0.0, 1.0, 0.0))
    pad_radius: Metres = 0.01
    inertia: InertiaOrNone = default(None)

    quantity = "load of the grasp"
    unit = "N"
    falls = "slips out of the fingers"

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
