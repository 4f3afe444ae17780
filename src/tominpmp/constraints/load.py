"""Loads that must not slip, tip or fall off: on a tray, a suction cup, in a gripper.

The wrench that holds a load is what its motion asks for: with its spatial inertia Y,
the spatial velocity v and acceleration a of the frame that it moves with, and gravity,

    w = Y (a - g) + v x* Y v

in the axes of the frame (the body force of the recursive Newton-Euler algorithm,
Featherstone 2008, equation 5.9). Whatever holds it can give some wrenches only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, frozen_array, is_single
from tominpmp.constraints.path import FrameConstraint, frame_name, positive
from tominpmp.exceptions import ProblemError, brief
from tominpmp.goals.base import goal_vector
from tominpmp.inputs import VectorLike
from tominpmp.payload import checked_inertia

STANDARD_GRAVITY = 9.81
# Corners of the polygon that stands for a round contact.
ROUND_CORNERS = 24
POINT = "three coordinates [m]"


class HeldLoad(FrameConstraint):
    """A load that moves with a frame."""

    frame: str
    mass: float
    center: Array
    inertia: Array | None

    order = 2
    curable = True

    def _check_load(self) -> None:
        """Check and copy what the load is.

        Raises:
            ProblemError: If anything is wrong.
        """
        frame_name(self.frame)
        object.__setattr__(self, "mass", positive(self.mass, "mass", "kg"))
        center = goal_vector(self.center, "center", POINT, 3)
        object.__setattr__(self, "center", frozen_array(center))
        if self.inertia is not None:
            tensor = checked_inertia(self.inertia, "inertia")
            object.__setattr__(self, "inertia", frozen_array(tensor))

    @property
    def weight(self) -> float:
        """Weight of the load on earth [N]."""
        return self.mass * STANDARD_GRAVITY

    def _body(self) -> Array:
        """Spatial inertia at the frame, shape (6, 6)."""
        tensor = np.zeros((3, 3)) if self.inertia is None else self.inertia
        return np.asarray(pin.Inertia(self.mass, self.center, tensor).matrix())

    def wrench_alone(self, q: Array, v: Array, a: Array) -> Array:
        """That of :meth:`wrench` without derivatives, shape (6,)."""
        kinematics, body = self.kinematics, self._body()
        rotation, speed, felt = kinematics.spatial_state(q, v, a, self.frame)
        felt[:3] -= rotation.T @ kinematics.robot.model.gravity.linear
        return np.asarray(body @ felt + _force_cross(speed) @ (body @ speed))

    def wrench(
        self, q: Array, v: Array, a: Array
    ) -> tuple[Array, tuple[Array, Array, Array]]:
        """Wrench that the motion asks for, in the axes of the frame and at its origin.

        Args:
            q: Positions, shape (n,).
            v: Velocities, shape (n,).
            a: Accelerations, shape (n,).

        Returns:
            Force above moment, shape (6,) [N, N m], and its derivatives by q, v and a,
            shape (6, n) each.
        """
        body = self._body()
        motion = self.kinematics.spatial_motion(q, v, a, self.frame)
        gravity = self.kinematics.robot.model.gravity.linear
        fall = np.asarray(motion.rotation.T @ gravity)
        felt = motion.acceleration.copy()
        felt[:3] -= fall
        momentum = body @ motion.velocity
        w = body @ felt + _force_cross(motion.velocity) @ momentum
        # v x* f is linear in both.
        turn = _force_cross(motion.velocity) @ body + _crossed_by(momentum)
        felt_q = motion.a_q.copy()
        felt_q[:3] -= pin.skew(fall) @ motion.v_v[3:]  # gravity turns in the frame
        return w, (
            body @ felt_q + turn @ motion.v_q,
            body @ motion.a_v + turn @ motion.v_v,
            body @ motion.v_v,
        )

    def lack(self, q: Array, v: Array, slack: float) -> str:
        """What is wrong at rest; nothing if the load is held there."""
        if np.any(v):
            return ""  # accelerations are not known
        over = self.measure(q, v, np.zeros_like(q)) - self.largest
        if over <= slack * max(self.scale, 1.0):
            return ""
        return f"the load on {self.subject} {self.falls}, even at rest"

    falls: str = "is not held"


@dataclass(frozen=True, eq=False)
class StableContact(HeldLoad):
    """A load that stands on a frame, or hangs on a suction cup there, stays in place.

    The contact is flat, in the plane of x and y of the frame with the load on the side
    of z, and gives forces within the friction cone whose centre of pressure is inside
    the support: |f_xy| <= mu (f_z + adhesion), and no moment about an edge tips the
    load. Torsion about z is let pass. The arm may tilt the tray: that is faster than
    keeping it level (the waiter's problem).

    Attributes:
        frame: Name of the frame, its z away from the contact.
        center: Centre of mass of the load in the frame, shape (3,) [m].
        friction: Coefficient mu of dry friction.
        support: Corners of the support polygon in x and y of the frame, convex, shape
            (k, 2) [m]; or the radius of a round one; None for one that never tips.
        mass: Mass of the load [kg]; matters where there is adhesion.
        inertia: Inertia tensor about the centre of mass, in the axes of the frame,
            shape (3, 3) [kg m^2]; None for a point mass.
        adhesion: Largest pull of a suction cup or magnet [N], at the middle of the
            support.

    Raises:
        ProblemError: If a value is none, or the support no convex polygon.
    """

    frame: str
    center: Array
    friction: float
    support: Array | float | None = None
    mass: float = 1.0
    inertia: Array | None = None
    adhesion: float = 0.0

    quantity = "lack of grip"
    unit = "of the weight"
    largest = 0.0
    scale = 1.0
    falls = "slips or tips"

    if TYPE_CHECKING:

        def __init__(
            self,
            frame: str,
            center: VectorLike,
            friction: float,
            support: ArrayLike | float | None = ...,
            mass: float = ...,
            inertia: ArrayLike | None = ...,
            adhesion: float = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        """Check and copy the values."""
        self._check_load()
        object.__setattr__(self, "friction", positive(self.friction, "friction", "1"))
        pull = self.adhesion
        if pull != 0.0:
            pull = positive(pull, "adhesion", "N")
        object.__setattr__(self, "adhesion", float(pull))
        if is_single(self.support) and self.support is not None:
            radius = positive(self.support, "support", "m")
            object.__setattr__(self, "support", radius)
        elif self.support is not None:
            object.__setattr__(self, "support", frozen_array(_polygon(self.support)))
        object.__setattr__(self, "_edges", _edges_of(self.corners))

    @property
    def corners(self) -> Array:
        """Corners of the support, shape (k, 2) [m]; none where it never tips."""
        if self.support is None:
            return np.zeros((0, 2))
        if isinstance(self.support, float):
            turn = 2.0 * np.pi * np.arange(ROUND_CORNERS) / ROUND_CORNERS
            return self.support * np.column_stack([np.cos(turn), np.sin(turn)])
        return self.support

    @property
    def count(self) -> int:
        """One for slipping, and one for each edge."""
        return 1 + len(self.corners)

    @property
    def _moments(self) -> tuple[Array, Array]:
        found: tuple[Array, Array] = self.__dict__["_edges"]
        return found

    def terms(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array, Array]:
        """What is missing to hold the load, in shares of its weight."""
        w, by = self.wrench(q, v, a)
        weight, mu = self.weight, self.friction
        force, most = w[:2], mu * (w[2] + self.adhesion)
        size = float(np.sqrt(2.0 * (force @ force + most**2)))
        along = np.zeros(6)
        along[:2] = 2.0 * force / max(size, 1e-300)
        along[2] = (2.0 * most / max(size, 1e-300) - 2.0) * mu
        rows, room = self._moments
        length = weight * np.maximum(room, 1e-6)
        by_wrench = np.vstack([along / weight, rows / length[:, None]])
        by_q, by_v, by_a = (by_wrench @ part for part in by)
        return self._rows_of(w), by_q, by_v, by_a

    def values(self, q: Array, v: Array, a: Array) -> Array:
        """The same without derivatives."""
        return self._rows_of(self.wrench_alone(q, v, a))

    def _rows_of(self, w: Array) -> Array:
        most = self.friction * (w[2] + self.adhesion)
        size = float(np.sqrt(2.0 * (w[:2] @ w[:2] + most**2)))
        return np.append(size - 2.0 * most, self._tipping(w)) / self.weight

    def _tipping(self, w: Array) -> Array:
        """How far each edge is from holding the moment about it [N], shape (k,)."""
        rows, room = self._moments
        return np.asarray((rows @ w - self.adhesion * room) / np.maximum(room, 1e-6))

    def measure(self, q: Array, v: Array, a: Array) -> float:
        """What is missing to hold the load, in shares of its weight, at least zero."""
        w = self.wrench_alone(q, v, a)
        slips = float(np.hypot(w[0], w[1])) - self.friction * (w[2] + self.adhesion)
        tips = float(np.max(self._tipping(w), initial=0.0))
        return float(max(0.0, slips, tips) / self.weight)


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
        ) -> None: ...

    def __post_init__(self) -> None:
        """Check and copy the values."""
        self._check_load()
        for name, unit in (("force", "N"), ("friction", "1"), ("pad_radius", "m")):
            number = positive(getattr(self, name), name, unit)
            object.__setattr__(self, name, number)
        axis = goal_vector(self.axis, "axis", "three numbers, not all zero", 3)
        size = float(np.linalg.norm(axis))
        if not size > 0.0:
            raise ProblemError(
                f"axis is {axis.tolist()}, expected three numbers, not all zero", "axis"
            )
        object.__setattr__(self, "axis", frozen_array(axis / size))

    @property
    def largest(self) -> float:
        """What both pads hold [N]."""
        return 2.0 * self.friction * self.force

    def vector(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array, Array]:
        """Force across the axis, and moment about it over the radius [N]."""
        w, by = self.wrench(q, v, a)
        rows = self._across()
        by_q, by_v, by_a = (rows @ part for part in by)
        return rows @ w, by_q, by_v, by_a

    def _across(self) -> Array:
        """What friction has to hold of a wrench, shape (4, 6)."""
        rows = np.zeros((4, 6))
        rows[:3, :3] = np.eye(3) - np.outer(self.axis, self.axis)
        rows[3, 3:] = self.axis / self.pad_radius
        return rows

    def measure(self, q: Array, v: Array, a: Array) -> float:
        """Force that friction has to hold [N]."""
        return float(np.linalg.norm(self._across() @ self.wrench_alone(q, v, a)))


def _edges_of(corners: Array) -> tuple[Array, Array]:
    """Moments about the edges of a support that tip a load.

    Args:
        corners: Counter-clockwise, shape (k, 2) [m].

    Returns:
        Matrix from wrenches to the moments, shape (k, 6), and the distances of the
        edges from the middle of the support, shape (k,) [m].
    """
    along = np.roll(corners, -1, axis=0) - corners
    inward = np.column_stack([-along[:, 1], along[:, 0]])
    inward /= np.maximum(np.linalg.norm(inward, axis=1), 1e-300)[:, None]
    offset = np.sum(inward * corners, axis=1)
    # The centre of pressure is (-m_y, m_x) / f_z; inside it is in.p >= offset.
    rows = np.zeros((len(corners), 6))
    rows[:, 2] = offset
    rows[:, 3], rows[:, 4] = -inward[:, 1], inward[:, 0]
    middle = corners.mean(axis=0) if len(corners) else np.zeros(2)
    return rows, inward @ middle - offset


def _polygon(given: object) -> Array:
    """Check corners of a convex polygon; counter-clockwise, shape (k, 2)."""
    try:
        corners = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        corners = np.zeros(0)
    expected = "expected three or more corners (x, y) of a convex polygon, in order [m]"
    shaped = corners.ndim == 2 and corners.shape[0] > 2 and corners.shape[1] == 2
    if shaped and np.all(np.isfinite(corners)):
        along = np.roll(corners, -1, axis=0) - corners
        after = np.roll(along, -1, axis=0)
        turns = along[:, 0] * after[:, 1] - along[:, 1] * after[:, 0]
        if np.all(turns > 0.0):
            return corners
        if np.all(turns < 0.0):
            return corners[::-1].copy()
    raise ProblemError(f"support is {brief(given)}, {expected}", "support")


def _force_cross(motion: Array) -> Array:
    """Matrix of v x* for a spatial velocity, linear part first, shape (6, 6)."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = pin.skew(motion[3:])
    out[3:, :3] = pin.skew(motion[:3])
    return out


def _crossed_by(force: Array) -> Array:
    """Matrix of v -> v x* f for a spatial force, linear part first, shape (6, 6)."""
    out = np.zeros((6, 6))
    out[:3, 3:] = out[3:, :3] = -pin.skew(force[:3])
    out[3:, 3:] = -pin.skew(force[3:])
    return out
