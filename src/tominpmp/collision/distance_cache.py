"""Distance cache for motions that change little from call to call."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import Array
from tominpmp.collision.query import References

if TYPE_CHECKING:
    from tominpmp.collision.query import DistanceQuery

# A motion that is seen for the first time is looked at in steps of so many instants,
# then in half of them, and so on, each time from what was found beside it.
FIRST_STRIDE = 8


class DistanceCache:
    """Distances at a fixed number of configurations, call after call.

    A pair whose bodies cannot have come closer than the cutoff since they were last
    measured is not measured again. The bounds hold whatever the configurations are;
    they are good where those of one call are near those of the last, one by one, and
    in the first call where neighbours are near each other.
    """

    def __init__(self, query: DistanceQuery, instants: int) -> None:
        self._query = query
        self._known = References(instants, query.pairs)
        self._fresh = True

    @property
    def instants(self) -> int:
        """Number of configurations."""
        return int(self._known.slot.shape[0])

    def distances(
        self, q: Array, cutoff: float | Array, times: Array | None = None
    ) -> Array:
        """Signed distances below a cutoff; where they are above, lower bounds at least.

        Args:
            q: Configurations, shape (instants, n) [rad or m].
            cutoff: Distance beyond which a lower bound is enough [m], one for all pairs
                or by pair, shape (pairs,).
            times: Times [s], shape (instants,), for obstacles that move; None for the
                start.

        Returns:
            Distances [m], shape (instants, pairs).
        """
        query, m = self._query, self.instants
        limit = np.broadcast_to(np.asarray(cutoff, dtype=np.float64), (query.pairs,))
        rows = query.robot.expand(q)
        placed = query.place(rows, times)
        every = np.arange(m)
        if not self._fresh or m <= FIRST_STRIDE:
            self._fresh = False
            return query.distances(
                rows, placed, limit, self._known, every, every, times
            )
        self._fresh = False
        out = np.empty((m, query.pairs))
        stride, source = FIRST_STRIDE, 0
        part = every[::stride]
        while True:
            here = placed[0][part], placed[1][part]
            sources = np.maximum(part - source, 0)
            out[part] = query.distances(
                rows[part],
                here,
                limit,
                self._known,
                part,
                sources,
                None if times is None else times[part],
            )
            if stride == 1:
                return out
            stride //= 2
            source = stride
            part = every[stride :: 2 * stride]
