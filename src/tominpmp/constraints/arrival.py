"""When a goal is met: no earlier than one time, no later than another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import Constraint, Partials, States


@dataclass(frozen=True, eq=False)
class Arrival(Constraint):
    """The time at the end of a segment, before the arm stays there, within bounds.

    Attributes:
        earliest: No earlier than this [s].
        latest: No later than this [s]; infinity for any time.
    """

    earliest: float
    latest: float

    name = "arrival"
    order = 0

    @property
    def count(self) -> int:
        """One."""
        return 1

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """The times [s]."""
        shape = instants, 1
        return np.full(shape, self.earliest), np.full(shape, self.latest)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """The times [s], shape (m, 1)."""
        return states.t[:, None]

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """One."""
        return Partials(at, by_t=np.ones(at.size))
