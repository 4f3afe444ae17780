"""The limits of a motion, one a row, with the slack and the multiplier of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.certificate.perturbations import Instants, Linearised

# Kinds of rows that are no limits of the problem: the trust region of the linear
# program, and the goal.
TRUST = "trust region"
GOAL = "goal"
# Pairs, constraints and rows of goals are numbered within a segment: subjects of the
# next segment are larger by this.
SEGMENT = 1 << 20


@dataclass(frozen=True, eq=False)
class LimitRows:
    """Limits of a motion, one a row.

    A single number is broadcast to all rows.

    Attributes:
        kind: "effort", "velocity", "clearance", ..., shape (m,).
        at: Instants of the rows.
        subject: Joint of each row, or collision pair, shape (m,).
        below: Lower limit less value, negative: infinite without a lower limit,
            positive where the motion violates it, shape (m,).
        above: Upper limit less value, positive: infinite without an upper limit,
            negative where the motion violates it, shape (m,).
        slopes: Derivatives by the state there, shape (m, 2 n); zero for torques.
        change: Linearised changes of the limited quantities; empty for unknowns, which
            are columns of the program.
        unit: A unit of each row in units of its limit: the reach for clearances [m],
            shape (m,).
        by_torque: Derivatives by the torque of the joint [1/(N m) or 1/N], shape (m,).
        mean: Whether each row is the mean of both ends of its interval, shape (m,).
        component: Index of the value of its constraint, shape (m,).
        y: Multipliers, as shares of the duration, positive where the upper limit is
            active, shape (m,).
    """

    kind: NDArray[np.str_]
    at: Instants
    subject: IntArray
    below: Array
    above: Array
    slopes: Array
    change: Linearised
    unit: Array = field(default_factory=partial(np.ones, ()))
    by_torque: Array = field(default_factory=partial(np.zeros, ()))
    mean: BoolArray = field(default_factory=lambda: np.array(False))
    component: IntArray = field(default_factory=lambda: np.array(-1))
    y: Array = field(default_factory=partial(np.zeros, ()))

    def __post_init__(self) -> None:
        """Broadcast single numbers to all rows."""
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                each = value.shape[-1:] if item.name == "slopes" else ()
                value = np.broadcast_to(value, (self.subject.size, *each))
                object.__setattr__(self, item.name, value)

    # -- slack and multipliers ---------------------------------------------------------

    @property
    def lower(self) -> Array:
        """Slack below, never positive, shape (m,)."""
        return np.minimum(self.below, 0.0)

    @property
    def upper(self) -> Array:
        """Slack above, never negative, shape (m,)."""
        return np.maximum(self.above, 0.0)

    @property
    def held_above(self) -> BoolArray:
        """Whether the upper limit is active, shape (m,)."""
        return np.asarray(self.y > 0.0)

    @property
    def value(self) -> Array:
        """Share of the duration that a unit of slack is worth, never negative, (m,)."""
        return np.asarray(np.abs(self.y) / self.unit)

    @property
    def room(self) -> Array:
        """Slack to the active limit, never negative, shape (m,).

        In shares of the limit for torques, velocities, accelerations and rates, in rad
        or m for positions, in m for clearances.
        """
        return np.where(self.held_above, self.upper, -self.lower) * self.unit

    @property
    def promise(self) -> Array:
        """Multiplier times slack of each row, as a share of the duration, (m,)."""
        return self.value * self.room

    @property
    def used(self) -> Array:
        """Used share of the active limit, shape (m,)."""
        left = np.where(self.held_above, self.above, -self.below)
        return np.asarray(1.0 - left * self.unit)

    # -- subsets -----------------------------------------------------------------------

    def of(self, *kinds: str) -> BoolArray:
        """Whether each row is of given kinds, shape (m,)."""
        return np.isin(self.kind, kinds)

    @property
    def limits(self) -> BoolArray:
        """Whether each row belongs to a limit of the problem, shape (m,)."""
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
