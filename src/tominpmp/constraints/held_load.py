"""Loads that must not slip, tip or fall off: on a tray, a suction cup, in a gripper.

The wrench that holds a load is what its motion asks for: with its spatial inertia Y,
the spatial velocity v and acceleration a of the frame that it moves with, and gravity,

    w = Y (a - g) + v x* Y v

in the axes of the frame (the body force of the recursive Newton-Euler algorithm,
Featherstone 2008, equation 5.9). Whatever holds it can give some wrenches only.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import partial
from typing import Annotated, TypeAlias

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.checks import Point, number, positive
from tominpmp.constraints.path import FrameRows
from tominpmp.kinematics import SpatialStates, skew
from tominpmp.robot.payload import InertiaOrNone

STANDARD_GRAVITY = 9.81


Kilograms: TypeAlias = Annotated[float, partial(positive, unit="kg")]
Coefficient: TypeAlias = Annotated[float, partial(positive, unit="1")]


class HeldLoad(FrameRows):
    """A load that moves with a frame."""

    mass: Kilograms
    center: Point
    inertia: InertiaOrNone

    order = 2
    curable = True

    @property
    def weight(self) -> float:
        """Weight of the load on earth [N]."""
        return self.mass * STANDARD_GRAVITY

    def _body(self) -> Array:
        """Spatial inertia at the frame, shape (6, 6)."""
        tensor = np.zeros((3, 3)) if self.inertia is None else self.inertia
        return np.asarray(pin.Inertia(self.mass, self.center, tensor).matrix())

    def wrenches(self, q: Array, v: Array, a: Array) -> Array:
        """Those of :meth:`wrench_slopes` without derivatives, shape (m, 6)."""
        return self._wrenches(self.motions.spatial(q, v, a))

    def _wrenches(self, state: SpatialStates) -> Array:
        """Y (a - g) + v x* Y v, shape (m, 6)."""
        body = self._body()
        felt = state.acceleration.copy()
        felt[:, :3] -= self._fall(state)
        return felt @ body.T + _crossed(state.velocity, state.velocity @ body.T)

    def _fall(self, state: SpatialStates) -> Array:
        """Gravity in the axes of the frame, shape (m, 3) [m/s^2]."""
        gravity = np.asarray(self.kinematics.robot.model.gravity.linear)
        return np.asarray(gravity @ state.rotation)

    def wrench_slopes(
        self, q: Array, v: Array, a: Array
    ) -> tuple[Array, tuple[Array, Array, Array]]:
        """Wrenches that the motion asks for, in the axes of the frame at its origin.

        Args:
            q: Positions, shape (m, n).
            v: Velocities, shape (m, n).
            a: Accelerations, shape (m, n).

        Returns:
            Forces before moments, shape (m, 6) [N, N m], and their derivatives by q, v
            and a, shape (m, 6, n) each.
        """
        body = self._body()
        state, by = self.motions.spatial_slopes(q, v, a)
        # v x* f is linear in both.
        turn = _force_cross(state.velocity) @ body
        turn += _crossed_by(state.velocity @ body.T)
        felt_q = by.a_q.copy()
        # Gravity turns in the frame.
        felt_q[:, :3] -= skew(self._fall(state)) @ by.v_v[:, 3:]
        return self._wrenches(state), (
            body @ felt_q + turn @ by.v_q,
            body @ by.a_v + turn @ by.v_v,
            body @ by.v_v,
        )

    def lack(self, q: Array, v: Array, slack: float) -> str:
        """What is wrong at rest; nothing if the load is held there."""
        if np.any(v):
            return ""  # accelerations are not known
        size = self.measure(q, v, np.zeros_like(q))
        if size - self.largest <= number(slack, "slack") * max(self.scale, 1.0):
            return ""
        none = np.zeros((1, q.size))
        why = self.reason(self.wrenches(q[None], none, none)[0])
        return (
            f"the {self.name} is {size:.3g} {self.unit} at rest: the load "
            f"{self.falls}, even at rest, as {why}"
        )

    falls: str = "is not held"

    @abstractmethod
    def reason(self, w: Array) -> str:
        """Why it does not hold a wrench, shape (6,), in a clause."""


def _crossed(motion: Array, force: Array) -> Array:
    """Products v x* f of spatial velocities and forces, shape (m, 6)."""
    turned = np.cross(motion[:, 3:], force[:, :3])
    about = np.cross(motion[:, 3:], force[:, 3:]) + np.cross(
        motion[:, :3], force[:, :3]
    )
    return np.concatenate([turned, about], axis=1)


def _force_cross(motion: Array) -> Array:
    """The matrices of f -> v x* f for spatial velocities, shape (m, 6, 6)."""
    out = np.zeros((len(motion), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = skew(motion[:, 3:])
    out[:, 3:, :3] = skew(motion[:, :3])
    return out


def _crossed_by(force: Array) -> Array:
    """Matrices of v -> v x* f for spatial forces, shape (m, 6, 6)."""
    out = np.zeros((len(force), 6, 6))
    out[:, :3, 3:] = out[:, 3:, :3] = -skew(force[:, :3])
    out[:, 3:, 3:] = -skew(force[:, 3:])
    return out
