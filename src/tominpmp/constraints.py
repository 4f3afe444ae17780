"""Path constraints b(q) <= 0 (paper, equations 6 and 9)."""

from __future__ import annotations

from typing import Protocol

from tominpmp.arrays import Array, IntArray
from tominpmp.collision import CollisionChecker


class PathConstraint(Protocol):
    """Inequalities on the configuration that hold at all times."""

    @property
    def count(self) -> int:
        """Number of inequalities at an instant."""

    def values(self, q: Array) -> Array:
        """Values b(q), <= 0 where satisfied, shapes (m, n) to (m, count)."""

    def gradients(self, q: Array, which: IntArray) -> Array:
        """Gradients of some inequalities at one q of shape (n,), shape (k, n)."""


class ClearanceConstraint:
    """Keep every link farther than a margin from every obstacle: margin - distance.

    Attributes:
        checker: Distances of the pairs.
        margin: Distance to keep [m], one for all pairs or by pair.
        length: Length that the values are divided by [m].
    """

    def __init__(
        self, checker: CollisionChecker, margin: float | Array, length: float
    ) -> None:
        self.checker, self.margin, self.length = checker, margin, length

    @property
    def count(self) -> int:
        """Number of pairs."""
        return len(self.checker.pairs)

    def values(self, q: Array) -> Array:
        """Missing clearance in units of the length, shape (m, count)."""
        return (self.margin - self.checker.distances(q)) / self.length

    def gradients(self, q: Array, which: IntArray) -> Array:
        """Gradients of some values, shape (k, n)."""
        return -self.checker.gradients(q, which) / self.length
