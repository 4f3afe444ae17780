"""Constraint on a load that stands on a tray, or hangs on a suction cup."""

from __future__ import annotations

from functools import cached_property, partial
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Converted, array_or_nan, default, is_single, record
from tominpmp.checks import Point, non_negative, positive, wrong
from tominpmp.constraints.held_load import Coefficient, HeldLoad, Kilograms
from tominpmp.constraints.path import Linear, curvature_root
from tominpmp.robot.payload import InertiaOrNone

# Radius of the rounding of a friction cone at its tip, where a load is weightless, as a
# share of the forces at rest: the fastest motions let loads fall almost freely for some
# time, and programs fail at the tip. The rounded cone is inside the cone.
TIP = 3e-3
# Rows that select from a wrench the force across z, the moment across z, and the force
# along z.
_ACROSS, _ABOUT, _PRESSING = np.eye(6)[:2], np.eye(6)[3:5], np.eye(6)[2]


def _checked_support(given: ArrayLike, name: str) -> float | Array:
    """Check a radius, or the corners of a convex polygon; these counter-clockwise."""
    if is_single(given):
        return positive(given, name, "m")
    corners = array_or_nan(given)
    shaped = corners.ndim == 2 and corners.shape[0] > 2 and corners.shape[1] == 2
    if shaped and np.all(np.isfinite(corners)):
        along = np.roll(corners, -1, axis=0) - corners
        after = np.roll(along, -1, axis=0)
        turns = along[:, 0] * after[:, 1] - along[:, 1] * after[:, 0]
        # The edges of a star turn to one side, too, but more than once in all.
        angles = np.arctan2(turns, np.sum(along * after, axis=1))
        if np.all(turns * turns[0] > 0.0) and abs(angles.sum()) < 3.0 * np.pi:
            return corners[:: int(np.sign(turns[0]))]  # read-only as the corners
    expected = "three or more corners (x, y) of a convex polygon, in order [m]"
    raise wrong(given, name, expected)


SupportOrNone: TypeAlias = Annotated[
    Converted[ArrayLike | float | None, Array | float | None],
    _checked_support,
]
Pull: TypeAlias = Annotated[float, partial(non_negative, unit="N")]


@record
class StableContact(HeldLoad):
    """A load that stands on a frame, or hangs on a suction cup there, stays in place.

    The contact is flat, in the plane of x and y of the frame with the load on the side
    of z, and gives forces within the friction cone whose centre of pressure is inside
    the support: |f_xy| <= mu (f_z + adhesion), and no moment about an edge tips the
    load. Torsion about z is not limited. The arm may tilt the tray, which is faster
    than keeping it level (the waiter's problem).

    Attributes:
        frame: Name of the frame, its z away from the contact.
        center: Centre of mass of the load in the frame, shape (3,) [m].
        friction: Coefficient mu of dry friction.
        support: Corners of the support polygon in x and y of the frame, convex, shape
            (k, 2) [m]; or the radius of a round support; None for a load that never
            tips.
        mass: Mass of the load [kg]; matters only with adhesion or an inertia tensor.
        inertia: Inertia tensor about the centre of mass, in the axes of the frame,
            shape (3, 3) [kg m^2]; None for a point mass.
        adhesion: Largest pull of a suction cup or magnet [N], at the middle of the
            support.

    Raises:
        ProblemError: If a value is not a number in its range, or the support is not a
            convex polygon.
    """

    center: Point
    friction: Coefficient
    support: SupportOrNone = default(None)
    mass: Kilograms = 1.0
    inertia: InertiaOrNone = default(None)
    adhesion: Pull = 0.0

    quantity = "lack of grip"
    unit = "of the weight"
    largest = 0.0
    scale = 1.0
    falls = "slips or tips"

    @property
    def count(self) -> int:
        """Number of values: one for slipping, and one for each edge."""
        return len(self._cones) + len(self._edges[1])

    @cached_property
    def _cones(self) -> list[tuple[Array, float]]:
        """Cones of admissible wrenches, for friction and for a round support.

        Each cone is a matrix, shape (3, 6), that maps a wrench to a vector of two
        components and an upper bound on its length [N], and the rounding of the tip
        [N].
        """
        mu, tip = self.friction, TIP * self.weight
        cones = [(np.vstack([_ACROSS, mu * _PRESSING]), mu * tip)]
        if isinstance(self.support, float):
            # The centre of pressure (-m_y, m_x) / f_z is within a circle.
            cones.append((np.vstack([_ABOUT / self.support, _PRESSING]), tip))
        return cones

    @cached_property
    def _edges(self) -> tuple[Array, Array]:
        """Moments about the edges of a support polygon, which would tip the load.

        Returns:
            Matrix from wrenches to the moments, shape (k, 6), and the distance of each
            edge from the middle of the support, shape (k,) [m].
        """
        if not isinstance(self.support, np.ndarray):
            return np.zeros((0, 6)), np.zeros(0)
        corners = self.support  # counter-clockwise
        along = np.roll(corners, -1, axis=0) - corners
        inward = np.column_stack([-along[:, 1], along[:, 0]])
        inward /= np.linalg.norm(inward, axis=1)[:, None]
        offset = np.sum(inward * corners, axis=1)
        # The centre of pressure is (-m_y, m_x) / f_z; inside, inward @ p >= offset.
        rows = np.zeros((len(corners), 6))
        rows[:, 2] = offset
        rows[:, 3], rows[:, 4] = -inward[:, 1], inward[:, 0]
        return rows, inward @ corners.mean(axis=0) - offset

    def _within(self, w: Array, rows: Array) -> Array:
        """Wrenches plus the pull of a cup, in the coordinates of a cone, (m, 3)."""
        return np.asarray((w + self.adhesion * _PRESSING) @ rows.T)

    def _missing(self, w: Array) -> tuple[Array, Array]:
        """Missing grip of a load [N], and its derivatives by wrenches.

        Returns:
            Shapes (m, count) and (m, count, 6).
        """
        found = [_cone(self._within(w, rows), rows, tip) for rows, tip in self._cones]
        rows, arms = self._edges
        scale = np.maximum(arms, 1e-6)
        slope = np.broadcast_to(rows / scale[:, None], (len(w), *rows.shape))
        found.append(((w @ rows.T - self.adhesion * arms) / scale, slope))
        values, slopes = zip(*found, strict=True)
        return np.concatenate(values, axis=1), np.concatenate(slopes, axis=1)

    def term_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Missing grip of the load as a share of its weight, with derivatives."""
        w, by = self.wrench_slopes(q, v, a)
        values, by_wrench = self._missing(w)
        return values / self.weight, *(by_wrench @ by / self.weight)

    def value_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Missing grip of the load as a share of its weight, by value."""
        return self._missing(self.wrenches(q, v, a))[0] / self.weight

    @property
    def bends(self) -> bool:
        """True: the values of cones are convex functions of the wrench."""
        return True

    def bend_rows(self, q: Array, v: Array, a: Array) -> tuple[Array, ...] | None:
        """Derivatives of vectors for the second-order change of the cone values."""
        w, by = self.wrench_slopes(q, v, a)
        root = np.zeros((len(w), self.count, 3, 6))
        for k, (rows, tip) in enumerate(self._cones):
            y = self._within(w, rows)
            root[:, k] = curvature_root(y, tip / np.sqrt(2.0)) @ rows
        root /= np.sqrt(self.weight)
        return tuple(root @ by[:, :, None])

    def reason(self, w: Array) -> str:
        """Clause that explains why the contact cannot transmit a wrench."""
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
        """Largest missing grip of the load as a share of its weight, at least zero."""
        w = self.wrenches(q, v, a)
        missing = [np.zeros(len(w)), *self._missing(w)[0].T[len(self._cones) :]]
        for rows, _ in self._cones:
            y = self._within(w, rows)
            missing.append(np.hypot(y[:, 0], y[:, 1]) - y[:, 2])
        return np.asarray(np.max(missing, axis=0) / self.weight)


def _cone(y: Array, rows: Array, tip: float) -> tuple[Array, Array]:
    """Excess of wrenches over a cone that is rounded at its tip.

    sqrt(2 x^2 + 2 L^2 + e^2) - 2 L is positive where x > L, and has the sign of x - L
    up to a small error where L is much larger than e.

    Args:
        y: Vectors of two components, of length x, and their bounds L, shape (m, 3) [N].
        rows: Derivatives of vector and bound by the wrench, shape (3, 6).
        tip: Rounding e of the tip [N].

    Returns:
        Values, shape (m, 1) [N], and their derivatives by wrenches, shape (m, 1, 6).
    """
    size = np.sqrt(2.0 * np.sum(y**2, axis=1) + tip**2)[:, None]
    slope = 2.0 * (y / np.maximum(size, 1e-300)) @ rows - 2.0 * rows[2]
    return size - 2.0 * y[:, 2:], slope[:, None, :]
