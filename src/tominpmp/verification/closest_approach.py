r"""Closest approach of pairs of bodies along a motion, at all times.

The motion is cut into stretches of time. In the middle of a stretch distances are
measured, or bounded where they are large, and no pair comes closer within it than by
what its points can move meanwhile. Stretches in which a pair may lack room, or come
clearly closer than what was measured so far, are cut into parts, for that pair alone.
So it is the time between the samples, too, that is judged.

Between the rows of a replay the motion is a cubic polynomial, whose values lie between
those of its Bézier points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.collision import CollisionChecker, Contact
from tominpmp.motion.curves import states
from tominpmp.motion.extrema import least_between
from tominpmp.verification.replay import Replay

# Rows of the replay in the stretches that are looked at first, which are cut into so
# many parts, so often.
ROWS, PARTS, CUTS = 32, 4, 12
# A motion that takes no time, or is lost at once, is looked at for so long [s].
INSTANT = 1e-9
# A pair is not looked for that is closer than the closest by this share of its room
# and this much [m].
RESOLUTION, LEAST_RESOLUTION = 0.1, 1e-6
# Numbers of a table of stretches by pairs, and pairs in stretches that are measured and
# that are cut at a time.
TABLE, MEASURED, CUT = 400_000, 20_000, 300
# Pairs in stretches that a replay is looked at in before the rest is left in doubt.
MOST = 5_000_000
# Pairs that are measured at first, to know how near anything comes.
FIRST = 8


@dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches of time of a motion.

    Attributes:
        begin: When they begin [s], shape (m,).
        end: When they end [s], shape (m,).
        time: Their middles [s], shape (m,).
        q: Configuration then, shape (m, n) [rad or m].
        swing: How far joints are from there within the stretch at most, shape (m, n).
    """

    begin: Array
    end: Array
    time: Array
    q: Array
    swing: Array


class HermitePath:
    """A replayed motion as cubic polynomials between its rows.

    Args:
        replay: The motion.
        stray: How far joints may be from it, shape (n,) [rad or m].
    """

    def __init__(self, replay: Replay, stray: Array | float = 0.0) -> None:
        self.t, self.q, self.v = replay.t, replay.q, replay.v
        if self.t.size == 1:
            self.t = self.t + np.array([0.0, INSTANT])
            self.q, self.v = (np.vstack([x, x]) for x in (self.q, 0.0 * self.v))
        self._stray = stray

    def stretches(self, begin: Array, end: Array) -> Stretches:
        """Stretches from time to time [s], shape (m,) each."""
        time = 0.5 * (begin + end)
        q = self.positions(time)
        first = np.searchsorted(self.t[1:-1], begin, "right")
        last = np.searchsorted(self.t[1:-1], end, "left")
        count = np.arange(int(np.max(last - first, initial=0)) + 1)
        row = np.minimum(first[:, None] + count, last[:, None])
        early = np.maximum(begin[:, None], self.t[row])
        late = np.minimum(end[:, None], self.t[row + 1])
        points = self._bezier(early.ravel(), late.ravel())
        away = np.abs(points.reshape(4, *row.shape, -1) - q[:, None])
        swing = np.max(away, axis=(0, 2)) + self._stray
        return Stretches(begin, end, time, q, swing)

    def positions(self, times: Array) -> Array:
        """Positions at times [s], shape (m,) to (m, n)."""
        return self._states(times)[0]

    def _states(self, times: Array) -> tuple[Array, Array]:
        """Positions and velocities at times [s]."""
        return states(self.t, self.q, self.v, None, times)[:2]

    def _bezier(self, begin: Array, end: Array) -> Array:
        """Bézier points between times that one row holds, shape (4, m, n)."""
        (q0, v0), (q1, v1) = self._states(begin), self._states(end)
        third = (end - begin)[:, None] / 3.0
        return np.stack([q0, q0 + third * v0, q1 - third * v1, q1])


class Approach:
    """The search for the least room on a motion.

    Args:
        checker: Distances of the pairs.
        replay: The motion.
        margins: Distances to keep by pair, shape (pairs,) [m].
        allowed: What pairs may lack near the start and near the end, shape (2, pairs)
            [m]; None for nothing.
        near: How far from there that is, by joint [rad or m].
        stray: How far joints may be from the motion, shape (n,) [rad or m].
        most: Pairs in stretches that are looked at before the rest is left in doubt.

    Attributes:
        pair: Index of the pair with the least room that was found.
        time: When that is [s].
        room: Its distance beyond the margin, as measured [m].
        violated: Whether a pair was measured to lack more than it may.
        doubt: By how much the bounds of some pair fall short of what is needed to tell
            that it does not [m]; zero where all is sure.
        stretches: How many pairs in stretches were looked at.
        given_up: Room that pairs have where they were looked at no closer [m].
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
        self._checker, self._margins = checker, margins
        self._path = HermitePath(replay, stray)
        self._near = near
        self._allowed = np.zeros((2, margins.size)) if allowed is None else allowed
        self._ends = replay.q[0], replay.q[-1]
        self.pair, self.time, self.room = 0, float(replay.t[0]), np.inf
        self.violated, self.doubt = False, 0.0
        self._most, self.stretches, self.given_up = most, 0, np.inf

    def nearest(self) -> Contact:
        """The pair with the least room that was found, looked at more closely."""
        self._sharpen()
        margin = float(self._margins[self.pair])
        return self._checker.contact(self.pair, self.room + margin, margin)

    @property
    def sure(self) -> float:
        """Room that every pair has at all times, if it lacks no more than it may [m].

        It may be less where that is more than what a pair may lack.
        """
        return min(self._wanted, self.given_up)

    def run(self) -> Approach:
        """Search, and return itself."""
        t, pairs = self._path.t, self._margins.size
        edges = np.append(t[:-1:ROWS], t[-1])
        most = max(1, TABLE // pairs)
        for at in range(0, edges.size - 1, most):
            part = edges[at : at + most + 1]
            self._look(self._path.stretches(part[:-1], part[1:]))
        return self

    def _look(self, stretches: Stretches) -> None:
        """Look at all pairs in stretches of many rows."""
        moved = self._moved(stretches)
        lower = self._checker.lower_bounds(stretches.q, stretches.time) - self._margins
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
        """Measure pairs in stretches, and cut those where they may come too close.

        Args:
            stretches: The stretches.
            moved: How far the pairs come closer within them at most, shape (k,) [m].
            stretch: Index of a stretch, shape (k,).
            pair: Index of a pair, shape (k,).
            cuts: How often they were cut.
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
            parts = self._path.stretches(begin, end)
            some, column = np.unique(pair[at : at + CUT], return_inverse=True)
            # The same pairs in all of the parts.
            index = (PARTS * index[:, None] + np.arange(PARTS)).ravel()
            column = np.repeat(column, PARTS)
            closer = self._moved(parts, some)[index, column]
            self._refine(parts, closer, index, some[column], cuts + 1)

    def _measure(
        self,
        stretches: Stretches,
        stretch: IntArray,
        pair: IntArray,
        moved: Array | None = None,
    ) -> Array:
        """Room of pairs in the middle of stretches, shape (k,) [m].

        Where it is so large that nothing more need be known it may be a bound.
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
        """Room beyond which nothing need be known where pairs may lack so much [m]."""
        if self.violated:
            return np.full(lack.shape, self._wanted)
        return np.maximum(-lack, self._wanted)

    @property
    def _wanted(self) -> float:
        """Room that pairs must come below to be looked at for the least [m]."""
        return self.room - max(RESOLUTION * abs(self.room), LEAST_RESOLUTION)

    def _may_lack(
        self, stretches: Stretches, stretch: IntArray, pair: IntArray
    ) -> Array:
        """What pairs may lack: more than nothing only near an end that they touch at.

        Shape (k,) [m], or (m, pairs) for indices that span a table.
        """
        lack = np.zeros(np.broadcast(stretch, pair).shape)
        for q, allowed in zip(self._ends, self._allowed, strict=True):
            away = np.max(np.abs(stretches.q - q) + stretches.swing, axis=1)
            here = (away <= self._near)[stretch]
            lack = np.maximum(lack, np.where(here, allowed[pair], 0.0))
        return lack

    def _moved(self, stretches: Stretches, pairs: IntArray | None = None) -> Array:
        """How far pairs come closer within stretches at most [m].

        Shape (m, k) for k pairs; None stands for all.
        """
        of = stretches
        return self._checker.closing(of.q, of.swing, of.begin, of.end, pairs)

    def _sharpen(self) -> None:
        """Look for the least room around where it was found."""
        t = self._path.t
        row = int(np.searchsorted(t, self.time))
        low, high = t[max(row - ROWS, 0)], t[min(row + ROWS, t.size - 1)]

        def look(times: Array) -> Array:
            pair = np.full(times.size, self.pair)
            at = self._path.stretches(times, times)
            return self._measure(at, np.arange(times.size), pair)

        least_between(look, low, high)
