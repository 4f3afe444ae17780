"""Loads that must not slip, tip or fall off: on a tray, a suction cup, in a gripper.

The wrench that holds a load is what its motion asks for: with its spatial inertia Y,
the spatial velocity v and acceleration a of the frame that it moves with, and gravity,

    w = Y (a - g) + v x* Y v

in the axes of the frame (the body force of the recursive Newton-Euler algorithm,
Featherstone 2008, equation 5.9). Whatever holds it can give some wrenches only.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, frozen_array, is_single
from tominpmp.constraints.path import FrameRows, frame_name, positive
from tominpmp.exceptions import ProblemError, brief
from tominpmp.frame_motions import SpatialStates, skew
from tominpmp.goals.base import goal_vector
from tominpmp.inputs import VectorLike
from tominpmp.payload import checked_inertia

STANDARD_GRAVITY = 9.81
POINT = "three coordinates [m]"
# Force across z, moment across z, and force along z, of a wrench.
_ACROSS, _ABOUT, _PRESSING = np.eye(6)[:2], np.eye(6)[3:5], np.eye(6)[2]


class HeldLoad(FrameRows):
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
        if size - self.largest <= slack * max(self.scale, 1.0):
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
        super().__post_init__()
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
            corners = frozen_array(_polygon(self.support))
            object.__setattr__(self, "support", corners)
            object.__setattr__(self, "_edges", _edges_of(corners))

    @property
    def count(self) -> int:
        """One for slipping, and one for each edge."""
        if self.support is None or isinstance(self.support, float):
            return 1 if self.support is None else 2
        return 1 + len(self.support)

    @property
    def _moments(self) -> tuple[Array, Array]:
        found: tuple[Array, Array] = self.__dict__["_edges"]
        return found

    def term_rows(
        self, q: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array, Array]:
        """What is missing to hold the load, in shares of its weight."""
        w, by = self.wrench_slopes(q, v, a)
        every = [self._slipping(w), *self._tipping(w)]
        by_wrench = np.concatenate([slope for _, slope in every], axis=1)
        values = np.concatenate([value for value, _ in every], axis=1)
        by_q, by_v, by_a = (by_wrench @ part / self.weight for part in by)
        return values / self.weight, by_q, by_v, by_a

    def value_rows(self, q: Array, v: Array, a: Array) -> Array:
        """The same without derivatives."""
        w = self.wrenches(q, v, a)
        every = [self._slipping(w), *self._tipping(w)]
        return np.concatenate([value for value, _ in every], axis=1) / self.weight

    def _slipping(self, w: Array) -> tuple[Array, Array]:
        """Force across the contact beyond what friction holds, rounded off [N]."""
        pull, mu = self.adhesion, self.friction
        return _cone(w[:, :2], mu * (w[:, 2] + pull), _ACROSS, mu * _PRESSING)

    def _tipping(self, w: Array) -> list[tuple[Array, Array]]:
        """How far the contact is from holding the moments about its edges [N]."""
        if self.support is None:
            return []
        if isinstance(self.support, float):
            # The centre of pressure (-m_y, m_x) / f_z is within a circle.
            moment = w[:, 3:5] / self.support
            most = w[:, 2] + self.adhesion
            return [_cone(moment, most, _ABOUT / self.support, _PRESSING)]
        rows, room = self._moments
        scale = np.maximum(room, 1e-6)
        value = (w @ rows.T - self.adhesion * room) / scale
        slope = np.broadcast_to(rows / scale[:, None], (len(w), *rows.shape))
        return [(value, slope)]

    def reason(self, w: Array) -> str:
        """Why it does not hold a wrench, in a clause."""
        force, pull = float(np.hypot(w[0], w[1])), self.adhesion
        if force > self.friction * (w[2] + pull):
            lean = np.degrees(np.arctan2(force, w[2]))
            if pull:
                return (
                    f"{force:.3g} N draw it across the contact, which friction "
                    f"{self.friction:g} holds up to "
                    f"{max(self.friction * (w[2] + pull), 0.0):.3g} N"
                )
            most = np.degrees(np.arctan(self.friction))
            return (
                f"its contact leans by {lean:.3g} deg, and friction {self.friction:g} "
                f"holds it up to {most:.3g} deg"
            )
        return "it presses beyond the edge of its support"

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """What is missing to hold the load, in shares of its weight, at least zero."""
        w = self.wrenches(q, v, a)
        slips = np.hypot(w[:, 0], w[:, 1]) - self.friction * (w[:, 2] + self.adhesion)
        missing = [np.maximum(slips, 0.0)]
        if isinstance(self.support, float):
            moment = np.hypot(w[:, 3], w[:, 4]) / self.support
            missing.append(moment - (w[:, 2] + self.adhesion))
        else:
            missing += [value.max(axis=1) for value, _ in self._tipping(w)]
        return np.asarray(np.max(missing, axis=0) / self.weight)


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
        super().__post_init__()
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

    def vector_rows(
        self, q: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array, Array]:
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


def _cone(
    part: Array, most: Array, by_part: Array, by_most: Array
) -> tuple[Array, Array]:
    """How far parts of wrenches are beyond a cone, rounded off about its tip.

    sqrt(2 x^2 + 2 L^2) - 2 L has the sign of x - L where L > 0, and is positive else.

    Args:
        part: What is to be no longer than a length, shape (m, 2) [N].
        most: The length L, shape (m,) [N].
        by_part: Derivative of the part by the wrench, shape (2, 6).
        by_most: Derivative of the length by it, shape (6,).

    Returns:
        Values, shape (m, 1) [N], and their derivatives by wrenches, shape (m, 1, 6).
    """
    size = np.sqrt(2.0 * (np.sum(part**2, axis=1) + most**2))
    safe = np.maximum(size, 1e-300)
    slope = 2.0 * (part / safe[:, None]) @ by_part
    slope += (2.0 * most / safe - 2.0)[:, None] * by_most
    return (size - 2.0 * most)[:, None], slope[:, None, :]


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
