"""Clearance of the links: a path constraint b(q, t) <= 0 (paper, equations 6 and 9).

Time t is real time [s]: obstacles may move. With t = tau T the paper's term for moving
obstacles is db/dT = db/dt * tau.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import Array, Converted, IntArray, default, record
from tominpmp.collision.query import Derivatives
from tominpmp.constraints.base import Constraint, Partials, States

if TYPE_CHECKING:
    from tominpmp.collision.checker import CollisionChecker

# Share of the padding that may be used up between rows, for obstacles at rest and for
# moving obstacles.
GRAZE, GRAZE_MOVING = 0.8, 0.5
# Violation that is tolerated even without padding, in units of the length, and its
# largest share of the padding that remains.
LEAST_GRAZE, REST = 1e-5, 0.5


@record
class ClearanceConstraint(Constraint):
    """Keep every collision pair farther apart than a margin.

    Attributes:
        checker: Distances of the pairs.
        margin: Distance to keep [m], a number for all pairs or an array by pair.
        length: Length by which the values are divided [m].
        padding: Part of the margin in excess of the margin of the problem, in units of
            the length, a number for all pairs or an array by pair.
    """

    checker: CollisionChecker
    margin: float | Array
    length: float
    padding: Converted[float | Array, Array] = default(0.0)

    name = "clearance"
    gradual = True

    def __post_init__(self) -> None:
        """Expand the padding to one value for each pair."""
        padding = np.broadcast_to(self.padding, len(self.checker.pairs))
        object.__setattr__(self, "padding", padding)
        object.__setattr__(self, "moving", self.checker.moving)

    @property
    def count(self) -> int:
        """Number of pairs."""
        return len(self.checker.pairs)

    @property
    def kinks(self) -> Array:
        """Times at which the velocity of an obstacle jumps [s], shape (k,)."""
        return self.checker.obstacles.kinks

    def rises(self, duration: float) -> Array:
        """Largest speed of the obstacle of each pair up to a duration [s].

        In units of the length per second, shape (count,).
        """
        begin, end = np.zeros(1), np.array([duration])
        return np.asarray(self.checker.obstacle_speeds(begin, end)[0] / self.length)

    def values(
        self, q: Array, attention: float = math.inf, times: Array | None = None
    ) -> Array:
        """Missing clearance in units of the length.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            attention: Values below the negative of this need not be exact, in units of
                the length.
            times: Times [s], shape (m,), for moving obstacles; None for the start.

        Returns:
            Shape (m, count). Values above the negative of the attention are exact;
            other values may be upper bounds, which are below it as well.
        """
        cutoff = self.margin + attention * self.length
        return (self.margin - self.checker.distances(q, cutoff, times)) / self.length

    def derivatives_at(
        self, q: Array, instants: IntArray, which: IntArray, times: Array | None = None
    ) -> Derivatives:
        """Derivatives of some values at several configurations and times.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            instants: Index of the configuration of each value, shape (k,).
            which: Index of the pair of each value, shape (k,).
            times: Times [s], shape (m,), for moving obstacles; None for the start.

        Returns:
            Derivatives by configuration, and by time [1/s].
        """
        found = self.checker.derivatives_at(q, instants, np.asarray(which), times)
        return Derivatives(*(-part / self.length for part in found))

    # -- as a constraint on states -----------------------------------------------------

    @property
    def room(self) -> Array:
        """The padding."""
        return np.asarray(self.padding)

    @property
    def usable(self) -> Array:
        """Part of the padding that pairs may use up between the instants of rows.

        At their instants, the rows keep the margin and the padding. Between them, a
        part of the padding may be used up, but never all of it: the verification of the
        motion tolerates no violation of the margin. If a motion begins or ends at the
        margin, the padding is zero, and a tiny violation is tolerated.
        """
        share = GRAZE_MOVING if self.moving else GRAZE
        rest = REST * (1.0 - share) * self.padding
        least = np.where(self.padding > 0.0, np.minimum(LEAST_GRAZE, rest), LEAST_GRAZE)
        return np.asarray(share * self.padding + least)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Missing clearance in units of the length, shape (m, count)."""
        return self.values(states.q, attention, states.t)

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives of the missing clearance."""
        by_q, by_t = self.derivatives_at(states.q, at, which, states.t)
        return Partials(at, by_q=by_q, by_t=by_t if self.moving else None)
