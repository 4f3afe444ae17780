"""The limits of a motion, one a row, with the room and the multiplier of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.certificate.perturbations import Instants, Linearised

# What is no limit of the problem: how far a linear program is believed.
TRUST = "trust region"
GOAL = "goal"


@dataclass(frozen=True, eq=False)
class LimitRows:
    """Limits of a motion, one a row.

    Attributes:
        kind: "effort", "velocity", "clearance", ..., shape (m,).
        at: Where the rows stand.
        subject: Joint of each, or pair, shape (m,).
        below: What is left to the lower side, negative: infinite where there is none,
            positive where the motion breaks it, shape (m,).
        above: What is left to the upper side, positive, likewise.
        y: Multipliers, as shares of the duration, positive where the upper side holds,
            shape (m,).
        unit: A unit of each row in units of its limit: the reach for clearances [m],
            shape (m,).
        by_torque: Derivatives by the torque of the joint [1/(N m) or 1/N], shape (m,).
        mean: Whether each is the mean of both ends of its interval, shape (m,).
        component: Which value of its constraint each is, shape (m,).
        slopes: Derivatives by the state there, shape (m, 2 n); zero of torques.
        change: How the limited quantities change; left out of unknowns, which are
            columns of the program.
    """

    kind: NDArray[np.str_]
    at: Instants
    subject: IntArray
    below: Array
    above: Array
    y: Array
    unit: Array
    by_torque: Array
    mean: BoolArray
    component: IntArray
    slopes: Array
    change: Linearised

    @classmethod
    def of_kind(
        cls,
        kind: str | NDArray[np.str_],
        at: Instants,
        subject: IntArray,
        room: tuple[Array, Array],
        slopes: Array,
        change: Linearised,
        *,
        unit: Array | float = 1.0,
        by_torque: Array | float = 0.0,
        mean: bool = False,
        component: IntArray | int = -1,
    ) -> LimitRows:
        """Rows of limits, of numbers that are the same for all or one for each.

        Args:
            kind: What they limit.
            at: Where they stand.
            subject: Joints or pairs.
            room: What is left below and above.
            slopes: Derivatives by the state.
            change: How the limited quantities change.
            unit: A unit in units of the limit.
            by_torque: Derivatives by the torque.
            mean: Whether they are means.
            component: Which values they are.
        """

        def every(value: Any) -> Any:
            return np.broadcast_to(value, subject.shape)

        return cls(
            kind=every(kind),
            at=at,
            subject=subject,
            below=every(room[0]),
            above=every(room[1]),
            y=np.zeros(subject.size),
            unit=every(unit),
            by_torque=every(by_torque),
            mean=every(mean),
            component=every(component),
            slopes=slopes,
            change=change,
        )

    # -- room and multipliers ----------------------------------------------------------

    @property
    def lower(self) -> Array:
        """Room below, never positive, shape (m,)."""
        return np.minimum(self.below, 0.0)

    @property
    def upper(self) -> Array:
        """Room above, never negative, shape (m,)."""
        return np.maximum(self.above, 0.0)

    @property
    def held_above(self) -> BoolArray:
        """Whether it is the upper side that holds, shape (m,)."""
        return np.asarray(self.y > 0.0)

    @property
    def value(self) -> Array:
        """Share of the duration that a unit of room is worth, never negative, (m,)."""
        return np.asarray(np.abs(self.y) / self.unit)

    @property
    def room(self) -> Array:
        """Room that is left on the side that holds, never negative, shape (m,).

        In shares of the limit for torques, velocities, accelerations and rates, in rad
        or m for positions, in m for clearances.
        """
        return np.where(self.held_above, self.upper, -self.lower) * self.unit

    @property
    def promise(self) -> Array:
        """What each gives away, as a share of the duration, shape (m,)."""
        return self.value * self.room

    @property
    def used(self) -> Array:
        """Share of the limit on the side that holds that is used, shape (m,)."""
        left = np.where(self.held_above, self.above, -self.below)
        return np.asarray(1.0 - left * self.unit)

    # -- some of them ------------------------------------------------------------------

    def of(self, *kinds: str) -> BoolArray:
        """Which of them are of some kinds, shape (m,)."""
        return np.isin(self.kind, kinds)

    @property
    def limits(self) -> BoolArray:
        """Which of them belong to limits of the problem, shape (m,)."""
        return ~self.of(TRUST, GOAL)

    def kept(self, rows: IntArray | BoolArray) -> LimitRows:
        """Some of the rows."""

        def some(item: Any) -> Any:
            return item[rows] if isinstance(item, np.ndarray) else item.kept(rows)

        return LimitRows(*(some(getattr(self, item.name)) for item in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[LimitRows]) -> LimitRows:
        """The rows of all parts, one after the other."""

        def together(items: list[Any]) -> Any:
            if isinstance(items[0], Linearised):
                return Linearised.stacked(items)
            if isinstance(items[0], Instants):
                both = zip(*items, strict=True)
                return Instants(*(np.concatenate(each) for each in both))
            return np.concatenate(items)

        columns = ([getattr(part, item.name) for part in parts] for item in fields(cls))
        return cls(*(together(column) for column in columns))
