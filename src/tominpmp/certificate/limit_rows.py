"""Rows of limits: how limited quantities change, and what room they have."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.certificate.instants import Instants
from tominpmp.certificate.perturbations import Linearised


@dataclass(frozen=True, eq=False)
class LimitRows:
    """Rows of one kind of limit.

    Attributes:
        kind: "effort", "velocity", "clearance", ...
        change: How the limited quantities change.
        lower: Room below, never positive, shape (m,).
        upper: Room above, never negative, shape (m,).
        interval: The interval of each row, shape (m,).
        subject: Joint of each row, or pair, shape (m,).
        share: Where in its interval each row stands, from 0 to 1; shape (m,), or one
            for all.
        mean: Whether it is the mean of both ends instead.
        slopes: Derivatives by the positions there, shape (m, n); of clearances and
            other constraints on states.
        speed_slopes: Derivatives by the velocities there, likewise.
        unit: A unit of the rows in units of the limit: the reach for clearances [m];
            one for all, or shape (m,).
        component: Which value of its constraint each row is, shape (m,), of those that
            problems ask for.
    """

    kind: str
    change: Linearised
    lower: Array
    upper: Array
    interval: IntArray
    subject: IntArray
    share: Array | float = 0.5
    mean: bool = False
    slopes: Array | None = None
    speed_slopes: Array | None = None
    unit: Array | float = 1.0
    component: IntArray | None = None

    @property
    def end(self) -> int | None:
        """Which end of its interval each row stands at, where it is one for all."""
        if isinstance(self.share, float) and self.share in (0.0, 1.0):
            return int(self.share)
        return None

    @property
    def at(self) -> Instants:
        """Where the rows stand."""
        share = np.asarray(self.share, dtype=float)
        return Instants(self.interval, np.broadcast_to(share, self.interval.shape))

    def kept(self, rows: IntArray) -> LimitRows:
        """Some of the rows."""
        return replace(
            self,
            change=Linearised(self.change.matrix[rows], self.change.by_length[rows]),
            lower=self.lower[rows],
            upper=self.upper[rows],
            interval=self.interval[rows],
            subject=self.subject[rows],
            share=_some(self.share, rows),
            slopes=None if self.slopes is None else self.slopes[rows],
            speed_slopes=None if self.speed_slopes is None else self.speed_slopes[rows],
            unit=_some(self.unit, rows),
            component=None if self.component is None else self.component[rows],
        )


def _some(values: Array | float, rows: IntArray) -> Array | float:
    return values if isinstance(values, float) else values[rows]
