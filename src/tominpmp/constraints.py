"""Path constraints b(q, t) <= 0 (paper, equations 6 and 9).

Time t is real time [s]: obstacles may move. With t = tau T the term of the paper for it
is db/dT = db/dt * tau.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.collision import CollisionChecker, Derivatives, DistanceCache

# Numbers of instants for which distances are remembered: a transcription looks at the
# instants of its rows, and at those between them.
CACHES = 3
# Pairs at instants beyond which nothing is remembered, as that would take memory.
MOST_KEPT = 4_000_000


class PathConstraint(Protocol):
    """Inequalities on the configuration that hold at all times."""

    @property
    def count(self) -> int:
        """Number of inequalities at an instant."""

    @property
    def moving(self) -> bool:
        """Whether the values depend on time."""

    @property
    def kinks(self) -> Array:
        """Times at which values may have a kink at any q [s], shape (k,)."""

    def rises(self, duration: float) -> Array:
        """Fastest rises of values with time [1/s] before a time [s], shape (count,)."""

    def values(
        self, q: Array, attention: float | None = None, times: Array | None = None
    ) -> Array:
        """Values b(q, t), <= 0 where satisfied, shapes (m, n), (m,) to (m, count).

        Values below -attention may be upper bounds that are below it too.
        """

    def is_kept(self, q: Array) -> bool:
        """Whether all inequalities hold at one q of shape (n,)."""

    def gradients(self, q: Array, which: IntArray) -> Array:
        """Gradients of some inequalities at one q of shape (n,), shape (k, n)."""

    def gradients_at(self, q: Array, instants: IntArray, which: IntArray) -> Array:
        """Gradients of inequalities ``which`` at q[instants], shape (k, n)."""

    def derivatives_at(
        self, q: Array, instants: IntArray, which: IntArray, times: Array | None = None
    ) -> Derivatives:
        """Derivatives of inequalities ``which`` by q, shape (k, n), and t, (k,)."""


class ClearanceConstraint:
    """Keep every link farther than a margin from all that it is watched against.

    Attributes:
        checker: Distances of the pairs.
        margin: Distance to keep [m], one for all pairs or by pair.
        length: Length that the values are divided by [m].
        attention: Values below minus this need not be exact: there is more room than
            anyone asks for, and a bound on it is enough, which is faster. In units of
            the length; infinite for exact values throughout.
    """

    def __init__(
        self,
        checker: CollisionChecker,
        margin: float | Array,
        length: float,
        attention: float = math.inf,
    ) -> None:
        self.checker, self.margin, self.length = checker, margin, length
        self.attention = attention
        self._caches: dict[int, DistanceCache] = {}

    def forget(self) -> None:
        """Forget former queries, on which values depend within the tolerances."""
        self._caches.clear()
        self.checker.forget()

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without what is remembered."""
        return {**self.__dict__, "_caches": {}}

    @property
    def count(self) -> int:
        """Number of pairs."""
        return len(self.checker.pairs)

    @property
    def moving(self) -> bool:
        """Whether an obstacle moves, so that the values depend on time."""
        return self.checker.moving

    @property
    def kinks(self) -> Array:
        """Times at which an obstacle changes its velocity at once [s], shape (k,)."""
        return self.checker.kinks

    def rises(self, duration: float) -> Array:
        """How fast the obstacles of the pairs move before a time [s], in lengths a s.

        Shape (count,).
        """
        begin, end = np.zeros(1), np.array([duration])
        return np.asarray(self.checker.obstacle_speeds(begin, end)[0] / self.length)

    def values(
        self, q: Array, attention: float | None = None, times: Array | None = None
    ) -> Array:
        """Missing clearance in units of the length.

        Args:
            q: Configurations, shape (m, n) [rad or m]. Calls with as many of them are
                taken for the same instants of a motion that changes a little.
            attention: Instead of the attribute.
            times: Times [s], shape (m,), for obstacles that move; None for the start.

        Returns:
            Shape (m, count). Values above minus the attention are exact; the others
            may be upper bounds, which are not above it either.
        """
        attention = self.attention if attention is None else attention
        if math.isinf(attention):
            found = self.checker.distances(q, times=times)
            return (self.margin - found) / self.length
        cutoff = self.margin + attention * self.length
        if len(q) * self.count > MOST_KEPT:
            found = self.checker.distances(q, cutoff, times)
        else:
            found = self._cache(len(q)).distances(q, cutoff, times)
        return (self.margin - found) / self.length

    def is_kept(self, q: Array) -> bool:
        """Whether the margin is kept at one configuration; faster than the values."""
        return self.checker.is_free(q, self.margin)

    def _cache(self, instants: int) -> DistanceCache:
        # The one that was not used for longest is the first.
        found = self._caches.pop(instants, None)
        if found is None:
            found = self.checker.cache(instants)
            if len(self._caches) >= CACHES:
                del self._caches[next(iter(self._caches))]
        self._caches[instants] = found
        return found

    def gradients(self, q: Array, which: IntArray) -> Array:
        """Gradients of some values at one configuration, shape (k, n)."""
        return -self.checker.gradients(q, which) / self.length

    def gradients_at(self, q: Array, instants: IntArray, which: IntArray) -> Array:
        """Gradients of some values at several configurations.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            instants: Index of the configuration of each gradient, shape (k,).
            which: Index of its pair, shape (k,).

        Returns:
            Shape (k, n).
        """
        return self.derivatives_at(q, instants, which).gradients

    def derivatives_at(
        self, q: Array, instants: IntArray, which: IntArray, times: Array | None = None
    ) -> Derivatives:
        """Derivatives of some values at several configurations and times.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            instants: Index of the configuration of each value, shape (k,).
            which: Index of its pair, shape (k,).
            times: Times [s], shape (m,), for obstacles that move; None for the start.

        Returns:
            Derivatives by configuration, and by time [1/s].
        """
        found = self.checker.derivatives_at(q, instants, np.asarray(which), times)
        return Derivatives(*(-part / self.length for part in found))
