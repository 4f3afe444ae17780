r"""Closest approach of collision pairs along a motion, at all times.

The motion is divided into time intervals. In the middle of an interval distances are
measured, or bounded where they are large; within the interval a distance decreases by
no more than the displacements of the points of the pair. Intervals in which a pair may
violate its margin, or come clearly closer than the least measured distance, are
subdivided for this pair alone. So the times between samples are covered, too.

Between the rows of a replay the motion is a cubic polynomial, whose values lie between
the least and the largest of its Bézier points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.collision.checker import CollisionChecker, Contact
from tominpmp.motion.curves import curve_through
from tominpmp.motion.extrema import least_between
from tominpmp.verification.replay import Replay

# Rows of the replay in each of the first intervals, number of parts of a subdivided
# interval, and largest number of successive subdivisions.
ROWS, PARTS, CUTS = 32, 4, 12
# Improvement of the least clearance below which closer approaches are not searched for:
# a share of that clearance, and its least value [m].
RESOLUTION, LEAST_RESOLUTION = 0.1, 1e-6
# Limits of memory: entries of a table of intervals by pairs, and number of pairs in
# intervals that are measured at once, and that are subdivided at once.
TABLE, MEASURED, CUT = 400_000, 20_000, 300
# Largest number of pairs in intervals before the search is given up.
MOST = 5_000_000
# Largest distance of the joints from the start or the end of a motion at which their
# tolerated violations hold [rad or m].
NEAR_END = 0.05
# Number of pairs in intervals that are measured first, to bound the least clearance.
FIRST = 8


class TimeIntervals(NamedTuple):
    """Time intervals of a motion.

    Attributes:
        begin: Beginnings of the intervals [s], shape (m,).
        end: Ends of the intervals [s], shape (m,).
        time: Middles of the intervals [s], shape (m,).
        q: Configurations in the middles, shape (m, n) [rad or m].
        spread: Largest deviation of each joint from the middle configuration within an
            interval, shape (m, n) [rad or m].
    """

    begin: Array
    end: Array
    time: Array
    q: Array
    spread: Array


class Cases(NamedTuple):
    """Pairs in time intervals, which the search examines, k in all.

    Attributes:
        intervals: The intervals.
        interval: Index of the interval of each case, shape (k,).
        pair: Index of the pair of each case, shape (k,).
    """

    intervals: TimeIntervals
    interval: IntArray
    pair: IntArray


class ClosestApproach:
    """Search for the least clearance along a motion.

    The clearance of a pair is its distance minus its margin.

    Args:
        checker: Collision checker with the pairs.
        replay: The motion.
        margins: Distances to keep by pair, shape (pairs,) [m].
        allowed: Tolerated violations near the start and near the end, shape (2, pairs)
            [m]; None without tolerance.
        drift: Largest deviations of the real motion from the replay by joint, shape
            (n,) [rad or m].
        most: Largest number of pairs in intervals before the search is given up.

    Attributes:
        pair: Index of the pair with the least measured clearance.
        time: Time of the least measured clearance [s].
        clearance: The least measured clearance [m].
        violated: Whether a measured violation exceeds its tolerance.
        possible_violation: Largest violation that the bounds leave open [m]; zero where
            all pairs are proved to keep their margins.
        intervals: Number of examined pairs in intervals.
        unexamined: Lower bound of the clearance where the search was given up [m].
    """

    def __init__(
        self,
        checker: CollisionChecker,
        replay: Replay,
        margins: Array,
        allowed: Array | None = None,
        drift: Array | float = 0.0,
        most: int = MOST,
    ) -> None:
        self._checker, self._margins = checker, margins
        self._motion, self._drift = replay, drift
        self._curve = curve_through(replay.t, replay.q, replay.v)
        self._allowed = np.zeros((2, margins.size)) if allowed is None else allowed
        self._ends = replay.q[0], replay.q[-1]
        self.pair, self.time, self.clearance = 0, float(replay.t[0]), np.inf
        self.violated, self.possible_violation = False, 0.0
        self._most, self.intervals, self.unexamined = most, 0, np.inf

    def nearest(self, *, refine: bool = True) -> Contact:
        """The pair with the least clearance.

        Args:
            refine: Whether its minimum in time is refined, by further measurements, for
                which there is no time after a stop.
        """
        t = self._motion.t
        row = int(np.searchsorted(t, self.time))
        low, high = t[max(row - ROWS, 0)], t[min(row + ROWS, t.size - 1)]

        def clearances(times: Array) -> Array:
            instants, pair = np.arange(times.size), np.full(times.size, self.pair)
            return self._measure(Cases(self._intervals(times, times), instants, pair))

        if refine:
            least_between(clearances, low, high)
        margin = float(self._margins[self.pair])
        return self._checker.contact(self.pair, self.clearance + margin, margin)

    @property
    def lower_bound(self) -> float:
        """Lower bound of the clearance of all pairs at all times [m].

        It is valid where it exceeds the negative tolerances of the pairs.
        """
        return min(self._search_bound, self.unexamined)

    def run(self) -> ClosestApproach:
        """Search along the whole motion; returns the search itself."""
        t, pairs = self._motion.t, self._margins.size
        # A single row is an interval of no duration.
        edges = np.append(t[: max(t.size - 1, 1) : ROWS], t[-1])
        most = max(1, TABLE // pairs)
        for first in range(0, edges.size - 1, most):
            chunk = edges[first : first + most + 1]
            self._examine(self._intervals(chunk[:-1], chunk[1:]))
        return self

    def _intervals(self, begin: Array, end: Array) -> TimeIntervals:
        """Intervals of the motion, which is a cubic polynomial between two of its rows.

        The spread includes the deviations of the real motion from this motion.

        Args:
            begin: Beginnings of the intervals [s], shape (m,).
            end: Ends of the intervals [s], shape (m,).
        """
        t, curve, time = self._motion.t, self._curve, 0.5 * (begin + end)
        first = np.searchsorted(t[1:-1], begin, "right")
        last = np.searchsorted(t[1:-1], end, "left")
        count = np.arange(int(np.max(last - first, initial=0)) + 1)
        row = np.minimum(first[:, None] + count, last[:, None])
        early = np.maximum(begin[:, None], t[row])
        late = np.minimum(end[:, None], np.append(t[1:], np.inf)[row])
        q0, q1 = curve(early.ravel()), curve(late.ravel())
        v0, v1 = curve(early.ravel(), 1), curve(late.ravel(), 1)
        third = (late - early).reshape(-1, 1) / 3.0
        bezier = np.stack([q0, q0 + third * v0, q1 - third * v1, q1])
        q = curve(time)
        distance = np.abs(bezier.reshape(4, *row.shape, -1) - q[:, None])
        spread = np.max(distance, axis=(0, 2)) + self._drift
        return TimeIntervals(begin, end, time, q, spread)

    def _examine(self, intervals: TimeIntervals) -> None:
        """Examine all pairs in intervals of many rows."""
        span = intervals.begin, intervals.end
        closing = self._checker.decrease(intervals.q, intervals.spread, *span)
        lower = self._checker.lower_bounds(intervals.q, intervals.time) - self._margins
        if self.clearance == np.inf:
            nearest = np.argsort(lower, axis=None, kind="stable")[:FIRST]
            self._measure(Cases(intervals, *divmod(nearest, lower.shape[1])))
        rows, every = (np.arange(size) for size in lower.shape)
        table = Cases(intervals, rows[:, None], every)
        accepted = self._accepted(self._tolerated(table))
        interval, pair = np.nonzero(lower - closing < accepted)
        for first in range(0, interval.size, MEASURED):
            chosen = interval[first : first + MEASURED], pair[first : first + MEASURED]
            self._refine(Cases(intervals, *chosen), closing[chosen])

    def _refine(self, cases: Cases, closing: Array, cuts: int = 0) -> None:
        """Measure pairs in intervals, and subdivide where they may be too close.

        Args:
            cases: The pairs in intervals.
            closing: Largest decrease of each distance within its interval, shape (k,)
                [m].
            cuts: Number of successive subdivisions so far.
        """
        intervals, interval, pair = cases
        lower = self._measure(cases, closing) - closing
        tolerated = self._tolerated(cases)
        open_ = lower < self._accepted(tolerated)
        self.intervals += interval.size
        if cuts == CUTS or self.intervals > self._most:
            self.unexamined = min(self.unexamined, np.min(lower, initial=np.inf))
            violation = float(np.max((-tolerated - lower)[open_], initial=0.0))
            self.possible_violation = max(self.possible_violation, violation)
            return
        interval, pair = interval[open_], pair[open_]
        for first in range(0, interval.size, CUT):
            chunk = slice(first, first + CUT)
            used, index = np.unique(interval[chunk], return_inverse=True)
            edges = np.linspace(
                intervals.begin[used], intervals.end[used], PARTS + 1, axis=1
            )
            begin, end = edges[:, :-1].ravel(), edges[:, 1:].ravel()
            parts = self._intervals(begin, end)
            some, column = np.unique(pair[chunk], return_inverse=True)
            # A pair is examined in all parts of its interval.
            index = (PARTS * index[:, None] + np.arange(PARTS)).ravel()
            column = np.repeat(column, PARTS)
            closer = self._checker.decrease(parts.q, parts.spread, begin, end, some)
            finer = Cases(parts, index, some[column])
            self._refine(finer, closer[index, column], cuts + 1)

    def _measure(self, cases: Cases, closing: Array | None = None) -> Array:
        """Clearances of pairs in the middle of intervals, shape (k,) [m].

        Large clearances are replaced by lower bounds, where a lower bound suffices.
        """
        (_, _, times, q, _), interval, pair = cases
        margins, enough = self._margins[pair], np.full(pair.size, np.inf)
        tolerated = self._tolerated(cases)
        if closing is not None:
            enough = margins + self._accepted(tolerated) + closing
        distance = self._checker.measured(q, interval, pair, enough, times)
        clearance = distance - margins
        exact = distance < enough
        least = np.where(exact, clearance, np.inf)
        self.violated = self.violated or bool(np.any(least < -tolerated))
        k = int(np.argmin(least))
        if least[k] < self.clearance:
            self.pair, self.time = int(pair[k]), float(times[interval[k]])
            self.clearance = float(least[k])
        return np.asarray(clearance)

    def _accepted(self, tolerated: Array) -> Array:
        """Clearances above which no subdivision is needed, by tolerated violation [m].

        After a measured violation, only the least clearance is of interest.
        """
        least = -np.inf if self.violated else -tolerated
        return np.asarray(np.maximum(least, self._search_bound))

    @property
    def _search_bound(self) -> float:
        """Clearance below which intervals are subdivided in search of the least [m]."""
        return self.clearance - max(RESOLUTION * abs(self.clearance), LEAST_RESOLUTION)

    def _tolerated(self, cases: Cases) -> Array:
        """Tolerated violations of pairs, positive only near the start and the end.

        Shape (k,) [m], or (m, pairs) for indices that span a table.
        """
        intervals, interval, pair = cases
        tolerated = np.zeros(np.broadcast(interval, pair).shape)
        for q, allowed in zip(self._ends, self._allowed, strict=True):
            distance = np.max(np.abs(intervals.q - q) + intervals.spread, axis=1)
            near = (distance <= NEAR_END)[interval]
            tolerated = np.maximum(tolerated, np.where(near, allowed[pair], 0.0))
        return tolerated
