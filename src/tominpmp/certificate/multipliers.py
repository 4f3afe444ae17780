"""Multipliers of limits, each with the room that its limit still has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray

# What is no limit of the problem: how far a linear program is believed.
TRUST = "trust region"
GOAL = "goal"


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Multipliers of limits with the room that is left to them, one an entry.

    Room is in shares of the limit for torques, velocities, accelerations and rates, in
    rad or m for positions, in m for clearances.

    Attributes:
        kinds: Kinds that there are: "effort", "velocity", "clearance", ...
        code: Index of the kind of each, shape (m,).
        interval: Interval of the grid that each belongs to, shape (m,).
        subject: Joint of each, or pair, shape (m,).
        value: Share of the duration that a unit of room is worth, never negative, (m,).
        upper: Whether it is the upper side that holds, shape (m,).
        room: Room that is left on that side, shape (m,).
    """

    kinds: tuple[str, ...]
    code: IntArray
    interval: IntArray
    subject: IntArray
    value: Array
    upper: BoolArray
    room: Array

    @property
    def promise(self) -> Array:
        """What each gives away, as a share of the duration, shape (m,)."""
        return self.value * self.room

    def of(self, *kinds: str) -> BoolArray:
        """Which of them are of some kinds."""
        codes = [i for i, kind in enumerate(self.kinds) if kind in kinds]
        return np.isin(self.code, codes)

    @property
    def limits(self) -> BoolArray:
        """Which of them belong to limits of the problem."""
        return ~self.of(TRUST, GOAL)


class Collection:
    """Multipliers, while they are being collected."""

    def __init__(self) -> None:
        self._kinds: list[str] = []
        self._parts: list[Multipliers] = []

    def add(
        self,
        kind: str,
        interval: IntArray,
        subject: IntArray,
        y: Array,
        lower: Array,
        upper: Array,
        unit: Array | float = 1.0,
    ) -> None:
        """Take some of one kind.

        Args:
            kind: What they belong to.
            interval: Intervals, shape (m,).
            subject: Joints or pairs, shape (m,).
            y: Multipliers, positive where the upper side holds, shape (m,).
            lower: Room below, never positive, shape (m,); without bound where infinite.
            upper: Room above, never negative, shape (m,).
            unit: What a unit of room is in units of the limit, shape (m,).
        """
        room = np.where(y > 0.0, upper, -lower)
        bounded = np.isfinite(room)
        scale = np.broadcast_to(unit, room.shape)[bounded]
        if kind not in self._kinds:
            self._kinds.append(kind)
        part = Multipliers(
            kinds=(kind,),
            code=np.full(scale.size, self._kinds.index(kind)),
            interval=interval[bounded],
            subject=subject[bounded],
            value=np.abs(y[bounded]) / scale,
            upper=y[bounded] > 0.0,
            room=room[bounded] * scale,
        )
        self._parts.append(part)

    def multipliers(self) -> Multipliers:
        """All of them."""
        parts = self._parts
        return Multipliers(
            kinds=tuple(self._kinds),
            code=np.concatenate([part.code for part in parts]),
            interval=np.concatenate([part.interval for part in parts]),
            subject=np.concatenate([part.subject for part in parts]),
            value=np.concatenate([part.value for part in parts]),
            upper=np.concatenate([part.upper for part in parts]),
            room=np.concatenate([part.room for part in parts]),
        )
