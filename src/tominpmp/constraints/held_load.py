"""Loads that must not slip, tip or fall off: on a tray, a suction cup, in a gripper.

The wrench that holds a load follows from its motion: with its spatial inertia Y, the
spatial velocity v and acceleration a of the frame that it moves with, and gravity,

    w = Y (a - g) + v x* Y v

in the axes of the frame: the body force of the recursive Newton-Euler algorithm
(Featherstone 2008, equation 5.9), with which Pinocchio evaluates it. A contact or a
grasp can transmit only a limited set of wrenches.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from functools import cached_property, partial
from typing import Annotated, TypeAlias

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, default, record
from tominpmp.checks import Direction, Metres, Point, number, positive
from tominpmp.constraints.path import FrameRows, Linear
from tominpmp.robot.payload import InertiaOrNone

STANDARD_GRAVITY = 9.81


Kilograms: TypeAlias = Annotated[float, partial(positive, unit="kg")]
Coefficient: TypeAlias = Annotated[float, partial(positive, unit="1")]
Newtons: TypeAlias = Annotated[float, partial(positive, unit="N")]


class HeldLoad(FrameRows):
    """A constraint on a load that moves with a frame."""

    mass: Kilograms
    center: Point
    inertia: InertiaOrNone

    order = 2
    curable = True

    @property
    def weight(self) -> float:
        """Weight of the load on earth [N]."""
        return self.mass * STANDARD_GRAVITY

    @cached_property
    def _loaded(self) -> tuple[pin.Model, list[int], list[int]]:
        """The joints that carry the frame, and the load on a free joint at the frame.

        The force of the free joint is the wrench that holds the load. Other joints are
        left out: Pinocchio's derivatives need joints of a branch in succession.

        Returns:
            The model, and the indices of positions and velocities of the joints that
            carry the frame in the model of the robot.
        """
        model, arm = pin.Model(), self.kinematics.robot.model
        model.gravity = arm.gravity
        frame, last = arm.frames[self.kinematics.robot.frame_id(self.frame)], 0
        of_q, of_v = list[int](), list[int]()
        for index in list(arm.supports[frame.parentJoint])[1:]:
            joint, place = arm.joints[index], arm.jointPlacements[index]
            last = model.addJoint(last, joint, place, arm.names[index])
            of_q += range(joint.idx_q, joint.idx_q + joint.nq)
            of_v += range(joint.idx_v, joint.idx_v + joint.nv)
        free = pin.JointModelFreeFlyer()
        last = model.addJoint(last, free, frame.placement, "held load")
        tensor = np.zeros((3, 3)) if self.inertia is None else self.inertia
        body = pin.Inertia(self.mass, self.center, tensor)
        model.appendBodyToJoint(last, body, pin.SE3.Identity())
        return model, of_q, of_v

    def wrenches(self, q: Array, v: Array, a: Array) -> Array:
        """Wrenches of :meth:`wrench_slopes`, without derivatives, shape (m, 6)."""
        model, _, _ = self._loaded
        data = model.createData()
        each = [pin.rnea(model, data, *state)[-6:] for state in self._states(q, v, a)]
        return np.reshape(each, (-1, 6))

    def _states(self, q: Array, v: Array, a: Array) -> Iterator[tuple[Array, ...]]:
        """States of the joints of :meth:`_loaded`; the load moves with the frame."""
        robot, (_, of_q, of_v) = self.kinematics.robot, self._loaded
        places = np.pad(robot.expand(q)[:, of_q], [(0, 0), (0, 7)])
        places[:, -1] = 1.0  # of the unit quaternion
        rows = (robot.expand_tangent(x)[:, of_v] for x in (v, a))
        rates = (np.pad(row, [(0, 0), (0, 6)]) for row in rows)
        return zip(places, *rates, strict=True)

    def wrench_slopes(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Wrenches that the motion requires, in the axes of the frame at its origin.

        Args:
            q: Positions, shape (m, n).
            v: Velocities, shape (m, n).
            a: Accelerations, shape (m, n).

        Returns:
            Forces before moments, shape (m, 6) [N, N m], and their derivatives by q, v
            and a, shape (3, m, 6, n).
        """
        robot, (model, _, of_v) = self.kinematics.robot, self._loaded
        data, m = model.createData(), len(q)
        wrenches, slopes = np.empty((m, 6)), np.zeros((3, m, 6, robot.model.nv))
        for k, state in enumerate(self._states(q, v, a)):
            pin.computeRNEADerivatives(model, data, *state)
            wrenches[k] = data.tau[-6:]
            by = data.dtau_dq, data.dtau_dv, data.M.T
            slopes[:, k][..., of_v] = [part[-6:, :-6] for part in by]
        return wrenches, robot.reduce_tangent(slopes)

    def lack(self, q: Array, v: Array, slack: float) -> str:
        """Violation at rest, as a clause; empty if the load is held, or the arm moves.

        While the arm moves, the accelerations are not known.
        """
        if np.any(v):
            return ""
        size = self.measure(q, v, np.zeros_like(q))
        if size - self.largest <= number(slack, "slack") * max(self.scale, 1.0):
            return ""
        rest = np.zeros((1, q.size))
        why = self.reason(self.wrenches(q[None], rest, rest)[0])
        return (
            f"the {self.name} is {size:.3g} {self.unit} at rest: the load "
            f"{self.falls}, as {why}"
        )

    falls: str = "is not held"

    @abstractmethod
    def reason(self, w: Array) -> str:
        """Clause that explains why a wrench, shape (6,), cannot be transmitted."""


@record
class FirmGrasp(HeldLoad):
    """A load between two fingers does not slip.

    Both pads press with a force along an axis; friction limits the force across the
    axis and the moment about it to an ellipsoid (the limit surface of Howe and
    Cutkosky, 1996) with the semi-axes 2 mu F for forces and 2 mu F r for the moment.
    Along the axis the fingers can hold any force.

    Attributes:
        frame: Name of the frame between the pads.
        force: Force F of each finger [N].
        friction: Coefficient mu of dry friction.
        mass: Mass of the load [kg].
        center: Centre of mass of the load in the frame, shape (3,) [m].
        axis: Axis along which the fingers close, in the frame, shape (3,); of any
            length.
        pad_radius: Effective radius r of the pads [m], which is 2/3 of the radius of a
            round pad.
        inertia: Inertia tensor about the centre of mass, in the axes of the frame,
            shape (3, 3) [kg m^2]; None for a point mass.

    Raises:
        ProblemError: If a value is not a positive number, or a vector is invalid.
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
        """Largest friction force of both pads [N]."""
        return 2.0 * self.friction * self.force

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Forces across the axis, and moments about it divided by the radius [N]."""
        w, by = self.wrench_slopes(q, v, a)
        rows = self._across()
        return w @ rows.T, *(rows @ by)

    def reason(self, w: Array) -> str:
        """Clause that explains why the grasp cannot transmit a wrench."""
        return f"they hold no more than {self.largest:.3g} N"

    def _across(self) -> Array:
        """Matrix from a wrench to the forces that friction must transmit, (4, 6)."""
        rows = np.zeros((4, 6))
        rows[:3, :3] = np.eye(3) - np.outer(self.axis, self.axis)
        rows[3, 3:] = self.axis / self.pad_radius
        return rows

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Magnitudes of the forces that friction must transmit [N]."""
        across = self.wrenches(q, v, a) @ self._across().T
        return np.asarray(np.linalg.norm(across, axis=1))
