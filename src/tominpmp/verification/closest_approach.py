r"""Closest approach of pairs of bodies along a motion, at all times.

The motion is cut into stretches of time. In the middle of a stretch distances are
measured, or bounded where they are large; within the stretch a distance falls by no
more than the displacements of the points of the pair. Stretches in which a pair may
violate its margin, or come clearly closer than the least measured distance, are cut
into parts, for that pair alone. So the times between samples are covered, too.

Between the rows of a replay the motion is a cubic polynomial, whose values lie between
those of its Bézier points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.collision.checker import CollisionChecker, Contact
from tominpmp.motion.curves import states
from tominpmp.motion.extrema import least_between
from tominpmp.verification.replay import Replay

# Rows of the replay in each of the first stretches, number of parts into which a
# stretch is cut, and largest number of successive cuts.
ROWS, PARTS, CUTS = 32, 4, 12
# Duration of the stretch of a motion with a single row [s].
INSTANT = 1e-9
# Pairs that are closer than the closest pair by less than this share of its clearance,
# or by less than this [m], are not searched.
RESOLUTION, LEAST_RESOLUTION = 0.1, 1e-6
# Entries of a table of stretches by pairs, and pairs in stretches that are measured at
# a time, and that are cut at a time.
TABLE, MEASURED, CUT = 400_000, 20_000, 300
# Largest number of pairs in stretches before the search is given up.
MOST = 5_000_000
# Pairs that are measured first, for a first bound of the least clearance.
FIRST = 8


@dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches of time of a motion.

    Attributes:
        begin: Their beginnings [s], shape (m,).
        end: Their ends [s], shape (m,).
        time: Their middles [s], shape (m,).
        q: Configurations in the middles, shape (m, n) [rad or m].
        swing: Largest deviations of joints from there in the stretch, shape (m, n).
    """

    begin: Array
    end: Array
    time: Array
    q: Array
    swing: Array

    @classmethod
    def of(
        cls, motion: Replay, begin: Array, end: Array, stray: Array | float = 0.0
    ) -> Stretches:
        """Stretches of a motion, which is a cubic polynomial between two of its rows.

        Args:
            motion: The motion, of two rows at least.
            begin: Times from which the stretches last [s], shape (m,).
            end: Times up to which they last [s], shape (m,).
            stray: Largest deviations of joints from the motion, shape (n,) [rad or m].
        """
        t, time = motion.t, 0.5 * (begin + end)
        q, _, _ = states(t, motion.q, motion.v, None, time)
        first = np.searchsorted(t[1:-1], begin, "right")
        last = np.searchsorted(t[1:-1], end, "left")
        count = np.arange(int(np.max(last - first, initial=0)) + 1)
        row = np.minimum(first[:, None] + count, last[:, None])
        early = np.maximum(begin[:, None], t[row])
        late = np.minimum(end[:, None], t[row + 1])
        (q0, v0, *_), (q1, v1, *_) = (
            states(t, motion.q, motion.v, None, times.ravel())
            for times in (early, late)
        )
        third = (late - early).reshape(-1, 1) / 3.0
        bezier = np.stack([q0, q0 + third * v0, q1 - third * v1, q1])
        away = np.abs(bezier.reshape(4, *row.shape, -1) - q[:, None])
        return cls(begin, end, time, q, np.max(away, axis=(0, 2)) + stray)


class Approach:
    """The search for the least clearance beyond the margins along a motion.

    Args:
        checker: Distances of the pairs.
        replay: The motion.
        margins: Distances to keep by pair, shape (pairs,) [m].
        allowed: Tolerated violations near the start and near the end, shape (2, pairs)
            [m]; None without tolerance.
        near: Largest distance of joints from there at which it holds [rad or m].
        stray: Largest deviations of joints from the motion, shape (n,) [rad or m].
        most: Largest number of pairs in stretches before the search is given up.

    Attributes:
        pair: Index of the pair with the least measured clearance beyond its margin.
        time: Its time [s].
        room: Its clearance beyond the margin [m].
        violated: Whether a pair was measured to violate its margin by more than its
            tolerance.
        doubt: Largest possible violation that the bounds leave open [m]; zero where
            all pairs are proved to keep their margins.
        stretches: Number of pairs in stretches that were examined.
        given_up: Lower bound of the clearance where the search was given up [m].
    """

    def __init__(
        self,
        checker: CollisionChecker,
        replay: Replay,
        margins: Array,
        allowed: Array | None = None,
        near: float = 0.0,
        stray: Array | float = 0.0,
        most: int = MOST,
    ) -> None:
        if replay.t.size == 1:
            moment, q = np.array([0.0, INSTANT]), np.vstack([replay.q, replay.q])
            replay = replace(replay, t=moment, q=q, v=np.zeros_like(q))
        self._checker, self._margins = checker, margins
        self._motion, self._stray, self._near = replay, stray, near
        self._allowed = np.zeros((2, margins.size)) if allowed is None else allowed
        self._ends = replay.q[0], replay.q[-1]
        self.pair, self.time, self.room = 0, float(replay.t[0]), np.inf
        self.violated, self.doubt = False, 0.0
        self._most, self.stretches, self.given_up = most, 0, np.inf

    def nearest(self) -> Contact:
        """The pair with the least clearance, at its refined minimum in time."""
        t = self._motion.t
        row = int(np.searchsorted(t, self.time))
        low, high = t[max(row - ROWS, 0)], t[min(row + ROWS, t.size - 1)]

        def look(times: Array) -> Array:
            pair = np.full(times.size, self.pair)
            at = self._stretches(times, times)
            return self._measure(at, np.arange(times.size), pair)

        least_between(look, low, high)
        margin = float(self._margins[self.pair])
        return self._checker.contact(self.pair, self.room + margin, margin)

    @property
    def sure(self) -> float:
        """Lower bound of the clearance of all pairs at all times [m].

        It holds where it is above the negative tolerances of the pairs.
        """
        return min(self._wanted, self.given_up)

    def run(self) -> Approach:
        """Search, and return itself."""
        t, pairs = self._motion.t, self._margins.size
        edges = np.append(t[:-1:ROWS], t[-1])
        most = max(1, TABLE // pairs)
        for at in range(0, edges.size - 1, most):
            part = edges[at : at + most + 1]
            self._look(self._stretches(part[:-1], part[1:]))
        return self

    def _stretches(self, begin: Array, end: Array) -> Stretches:
        return Stretches.of(self._motion, begin, end, self._stray)

    def _look(self, stretches: Stretches) -> None:
        """Examine all pairs in stretches of many rows."""
        of = stretches
        moved = self._checker.decrease(of.q, of.swing, of.begin, of.end)
        lower = self._checker.lower_bounds(of.q, of.time) - self._margins
        if self.room == np.inf:
            nearest = np.argsort(lower, axis=None, kind="stable")[:FIRST]
            self._measure(stretches, *divmod(nearest, lower.shape[1]))
        rows, every = (np.arange(size) for size in lower.shape)
        bar = self._bar(self._may_lack(stretches, rows[:, None], every))
        stretch, pair = np.nonzero(lower - moved < bar)
        for at in range(0, stretch.size, MEASURED):
            chosen = stretch[at : at + MEASURED], pair[at : at + MEASURED]
            self._refine(stretches, moved[chosen], *chosen)

    def _refine(
        self,
        stretches: Stretches,
        moved: Array,
        stretch: IntArray,
        pair: IntArray,
        cuts: int = 0,
    ) -> None:
        """Measure pairs in stretches, and cut stretches in which they may be too close.

        Args:
            stretches: The stretches.
            moved: Largest decreases of the distances within them, shape (k,) [m].
            stretch: Index of a stretch, shape (k,).
            pair: Index of a pair, shape (k,).
            cuts: Number of successive cuts so far.
        """
        lower = self._measure(stretches, stretch, pair, moved) - moved
        lack = self._may_lack(stretches, stretch, pair)
        open_ = lower < self._bar(lack)
        self.stretches += stretch.size
        if cuts == CUTS or self.stretches > self._most:
            self.given_up = min(self.given_up, np.min(lower, initial=np.inf))
            short = float(np.max((-lack - lower)[open_], initial=0.0))
            self.doubt = max(self.doubt, short)
            return
        stretch, pair = stretch[open_], pair[open_]
        for at in range(0, stretch.size, CUT):
            used, index = np.unique(stretch[at : at + CUT], return_inverse=True)
            edges = np.linspace(
                stretches.begin[used], stretches.end[used], PARTS + 1, axis=1
            )
            begin, end = edges[:, :-1].ravel(), edges[:, 1:].ravel()
            parts = self._stretches(begin, end)
            some, column = np.unique(pair[at : at + CUT], return_inverse=True)
            # The same pairs in all parts.
            index = (PARTS * index[:, None] + np.arange(PARTS)).ravel()
            column = np.repeat(column, PARTS)
            closer = self._checker.decrease(parts.q, parts.swing, begin, end, some)
            self._refine(parts, closer[index, column], index, some[column], cuts + 1)

    def _measure(
        self,
        stretches: Stretches,
        stretch: IntArray,
        pair: IntArray,
        moved: Array | None = None,
    ) -> Array:
        """Clearances of pairs in the middle of stretches, shape (k,) [m].

        Lower bounds where these suffice.
        """
        margins, enough = self._margins[pair], np.full(pair.size, np.inf)
        lack = self._may_lack(stretches, stretch, pair)
        if moved is not None:
            enough = margins + self._bar(lack) + moved
        q, times = stretches.q, stretches.time
        distance = self._checker.measured(q, stretch, pair, enough, times)
        room = distance - margins
        exact = distance < enough
        least = np.where(exact, room, np.inf)
        self.violated = self.violated or bool(np.any(least < -lack))
        k = int(np.argmin(least))
        if least[k] < self.room:
            self.pair, self.time = int(pair[k]), float(times[stretch[k]])
            self.room = float(least[k])
        return np.asarray(room)

    def _bar(self, lack: Array) -> Array:
        """Clearances that need no closer examination, for tolerated violations [m]."""
        if self.violated:
            return np.full(lack.shape, self._wanted)
        return np.maximum(-lack, self._wanted)

    @property
    def _wanted(self) -> float:
        """Clearance below which a pair is searched for the least one [m]."""
        return self.room - max(RESOLUTION * abs(self.room), LEAST_RESOLUTION)

    def _may_lack(
        self, stretches: Stretches, stretch: IntArray, pair: IntArray
    ) -> Array:
        """Tolerated violations of pairs: positive only near the start and the end.

        Shape (k,) [m], or (m, pairs) for indices that span a table.
        """
        lack = np.zeros(np.broadcast(stretch, pair).shape)
        for q, allowed in zip(self._ends, self._allowed, strict=True):
            away = np.max(np.abs(stretches.q - q) + stretches.swing, axis=1)
            here = (away <= self._near)[stretch]
            lack = np.maximum(lack, np.where(here, allowed[pair], 0.0))
        return lack
