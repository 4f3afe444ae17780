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

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.collision import CollisionChecker
from tominpmp.verification.link_displacement import LinkDisplacement, link_balls
from tominpmp.verification.replay import Replay

# Numbers of rows, or times: where stretches begin and end.
Edges: TypeAlias = np.ndarray[Any, Any]

# Rows of the replay in the stretches that are looked at first, then in their parts;
# then stretches between two rows are cut into so many parts, so often.
SPANS = (32, 8, 2, 1)
PARTS, CUTS = 4, 9
# A pair is not looked for that is closer than the closest by this share of its room
# and this much [m].
RESOLUTION, LEAST_RESOLUTION = 0.1, 1e-6
# Numbers of a table of stretches by pairs, and of pairs in stretches, at a time.
TABLE, LIST = 400_000, 20_000
# Pairs in stretches that a replay is looked at in before the rest is left in doubt.
MOST = 5_000_000
# Pairs that are measured at first, to know how near anything comes, and places at
# which the closest is looked for more closely, so often.
FIRST, PLACES, ROUNDS = 8, 9, 4


@dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches of time of a motion.

    Attributes:
        begin: When they begin [s], shape (m,).
        end: When they end [s], shape (m,).
        time: A time within them [s], shape (m,).
        q: Configuration then, shape (m, n) [rad or m].
        swing: How far joints are from there within the stretch at most, shape (m, n).
    """

    begin: Array
    end: Array
    time: Array
    q: Array
    swing: Array

    @property
    def half(self) -> Array:
        """Longest time from ``time`` to an end, shape (m,) [s]."""
        return np.maximum(self.time - self.begin, self.end - self.time)

    def taken(self, which: IntArray | slice) -> Stretches:
        """Some of them."""
        fields = (self.begin, self.end, self.time, self.q, self.swing)
        return Stretches(*(field[which] for field in fields))


class Course:
    """A replayed motion as stretches of time.

    Args:
        replay: The motion.
        stray: How far joints may be from it, shape (n,) [rad or m].
    """

    def __init__(self, replay: Replay, stray: Array | float = 0.0) -> None:
        self.t, self.q, self.v = replay.t, replay.q, replay.v
        self._stray = stray

    @property
    def last(self) -> int:
        """Number of the last row."""
        return self.t.size - 1

    def rows(self, first: IntArray, behind: IntArray) -> Stretches:
        """Stretches from row to row, shape (m,) each."""
        middle = (first + behind) // 2
        q = self.q[middle]
        swing = np.zeros_like(q)
        for k in range(int(np.max(behind - first, initial=0))):
            row = np.minimum(first + k, behind - 1)
            for points in _bezier(
                self.t[row + 1] - self.t[row],
                (self.q[row], self.q[row + 1]),
                (self.v[row], self.v[row + 1]),
            ):
                np.maximum(swing, np.abs(points - q), out=swing)
        return Stretches(
            self.t[first], self.t[behind], self.t[middle], q, swing + self._stray
        )

    def between(self, begin: Array, end: Array) -> Stretches:
        """Stretches between two rows, from time to time [s], shape (m,) each."""
        time = 0.5 * (begin + end)
        row = np.clip(np.searchsorted(self.t, time, side="right") - 1, 0, self.last - 1)
        q = self._at(row, time)[0]
        ends = [self._at(row, begin), self._at(row, end)]
        swing = np.zeros_like(q)
        for points in _bezier(
            end - begin, (ends[0][0], ends[1][0]), (ends[0][1], ends[1][1])
        ):
            np.maximum(swing, np.abs(points - q), out=swing)
        return Stretches(begin, end, time, q, swing + self._stray)

    def positions(self, times: Array) -> Array:
        """Positions at times [s], shape (m,) to (m, n)."""
        row = np.searchsorted(self.t, times, side="right") - 1
        return self._at(np.clip(row, 0, self.last - 1), times)[0]

    def _at(self, row: IntArray, time: Array) -> tuple[Array, Array]:
        """Positions and velocities at times after rows (Hermite's polynomials)."""
        h = (self.t[row + 1] - self.t[row])[:, None]
        s = (time - self.t[row])[:, None] / h
        change = self.q[row + 1] - self.q[row]
        v0, v1 = h * self.v[row], h * self.v[row + 1]
        second, third = 3.0 * change - 2.0 * v0 - v1, v0 + v1 - 2.0 * change
        q = self.q[row] + s * (v0 + s * (second + s * third))
        v = (v0 + s * (2.0 * second + 3.0 * s * third)) / h
        return q, v


def _bezier(
    h: Array, q: tuple[Array, Array], v: tuple[Array, Array]
) -> Iterator[Array]:
    """Bézier points of cubic polynomials over lengths of time, shape (m, n) each."""
    third = h[:, None] / 3.0
    yield from (q[0], q[0] + third * v[0], q[1] - third * v[1], q[1])


@dataclass(frozen=True)
class Closest:
    """The least room that was found.

    Attributes:
        pair: Index of the pair.
        time: When [s].
        room: Distance beyond the margin, as measured [m].
        violated: Whether a pair was measured to lack more than it may.
        doubt: By how much the bounds of some pair fall short of what is needed to tell
            that it does not [m]; zero where all is sure.
    """

    pair: int
    time: float
    room: float
    violated: bool
    doubt: float


class Approach:
    """The search for the least room on a motion.

    Args:
        checker: Distances of the pairs.
        replay: The motion, of two rows at least.
        margins: Distances to keep by pair, shape (pairs,) [m].
        allowed: What pairs may lack near the start and near the end, shape (2, pairs)
            [m].
        near: How far from there that is, by joint [rad or m].
        stray: How far joints may be from the motion, shape (n,) [rad or m].
        most: Pairs in stretches that are looked at before the rest is left in doubt.

    Attributes:
        stretches: How many pairs in stretches were looked at.
        given_up: Room that pairs have where they were looked at no closer [m].
    """

    def __init__(
        self,
        checker: CollisionChecker,
        replay: Replay,
        margins: Array,
        allowed: Array,
        near: float,
        stray: Array | float = 0.0,
        most: int = MOST,
    ) -> None:
        self._checker, self._margins = checker, margins
        self._course = Course(replay, stray)
        self._allowed, self._near = allowed, near
        self._ends = replay.q[0], replay.q[-1]
        own = np.arange(margins.size) >= checker.obstacle_pairs
        reach = LinkDisplacement(checker.robot, link_balls(checker))
        self._motion = reach.relative(checker.pairs, own)
        self._found = Closest(0, float(replay.t[0]), np.inf, False, 0.0)
        self._most, self.stretches, self.given_up = most, 0, np.inf

    @property
    def sure(self) -> float:
        """Room that every pair has at all times, if it lacks no more than it may [m].

        It may be less where that is more than what a pair may lack.
        """
        return min(self._wanted, self.given_up)

    def run(self) -> Closest:
        """Search."""
        last, pairs = self._course.last, self._margins.size
        edges = np.append(np.arange(0, last, SPANS[0]), last)
        for begin in range(0, edges.size - 1, max(1, TABLE // pairs)):
            part = edges[begin : begin + max(1, TABLE // pairs) + 1]
            self._look(part[:-1], part[1:])
        self._sharpen()
        return self._found

    def _look(self, first: IntArray, behind: IntArray) -> None:
        """Look at all pairs in stretches of many rows."""
        stretches = self._course.rows(first, behind)
        moved = self._moved(stretches)
        lower = self._checker.lower_bounds(stretches.q, stretches.time) - self._margins
        if self._found.room == np.inf:
            nearest = np.argsort(lower, axis=None, kind="stable")[:FIRST]
            self._measure(stretches, *divmod(nearest, lower.shape[1]))
        every = np.arange(lower.shape[1])
        bar = self._bar(self._may_lack(stretches, slice(None), every))
        stretch, pair = np.nonzero(lower - moved < bar)
        for at in range(0, stretch.size, LIST):
            chosen = stretch[at : at + LIST], pair[at : at + LIST]
            self._refine(stretches, first, behind, moved[chosen], *chosen, level=0)

    def _refine(
        self,
        stretches: Stretches,
        first: Edges,
        behind: Edges,
        moved: Array,
        stretch: IntArray,
        pair: IntArray,
        level: int,
    ) -> None:
        """Measure pairs in stretches, and cut those where they may come too close.

        Args:
            stretches: The stretches.
            first: Rows at which they begin; times, after the last of the spans.
            behind: Rows or times at which they end.
            moved: How far the pairs come closer within them at most, shape (k,) [m].
            stretch: Index of a stretch, ascending, shape (k,).
            pair: Index of a pair, shape (k,).
            level: How often they were cut.
        """
        lower = self._measure(stretches, stretch, pair, moved) - moved
        lack = self._may_lack(stretches, stretch, pair)
        open_ = lower < self._bar(lack)
        self.stretches += stretch.size
        if level == len(SPANS) - 1 + CUTS or self.stretches > self._most:
            self.given_up = min(self.given_up, np.min(lower, initial=np.inf))
            short = float(np.max((-lack - lower)[open_], initial=0.0))
            self._found = replace(self._found, doubt=max(self._found.doubt, short))
            return
        stretch, pair = stretch[open_], pair[open_]
        for at in range(0, stretch.size, LIST // SPANS[0]):
            part = slice(at, at + LIST // SPANS[0])
            used, index = np.unique(stretch[part], return_inverse=True)
            self._cut(first[used], behind[used], index, pair[part], level)

    def _cut(
        self, first: Edges, behind: Edges, index: IntArray, pair: IntArray, level: int
    ) -> None:
        """Cut stretches, and go on with the same pairs in all of their parts."""
        if level + 1 < len(SPANS):
            begin, end = _rows_within(first, behind, SPANS[level + 1])
            stretches, parts = None, begin.shape[1]
        else:
            if level + 1 == len(SPANS):
                first, behind = self._course.t[first], self._course.t[behind]
            places = np.linspace(0.0, 1.0, PARTS + 1)
            edges = first[:, None] + places * (behind - first)[:, None]
            begin, end, parts = edges[:, :-1], edges[:, 1:], PARTS
            stretches = self._course.between(begin.ravel(), end.ravel())
        inside = (end > begin).ravel()
        number = np.cumsum(inside) - 1
        begin, end = begin.ravel()[inside], end.ravel()[inside]
        if stretches is None:
            stretches = self._course.rows(begin, end)
        else:
            stretches = stretches.taken(np.flatnonzero(inside))
        child = (index[:, None] * parts + np.arange(parts)).ravel()
        pairs = np.repeat(pair, parts)[inside[child]]
        child = number[child[inside[child]]]
        order = np.argsort(child, kind="stable")
        child, pairs = child[order], pairs[order]
        moved = np.empty(child.size)
        some, column = np.unique(pairs, return_inverse=True)
        most = max(1, TABLE // self._margins.size)
        for at in range(0, stretches.time.size, most):
            part = slice(at, at + most)
            rows = slice(*np.searchsorted(child, (at, at + most)))
            table = self._moved(stretches.taken(part), some)
            moved[rows] = table[child[rows] - at, column[rows]]
        self._refine(stretches, begin, end, moved, child, pairs, level + 1)

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
        exact = np.flatnonzero(distance < enough)
        if exact.size:
            best = int(exact[np.argmin(room[exact])])
            violated = bool(np.any(room[exact] < -lack[exact]))
            self._take(
                int(pair[best]),
                float(times[stretch[best]]),
                float(room[best]),
                violated,
            )
        return np.asarray(room)

    def _take(self, pair: int, time: float, room: float, violated: bool) -> None:
        found = replace(self._found, violated=violated or self._found.violated)
        if room < found.room:
            found = replace(found, pair=pair, time=time, room=room)
        self._found = found

    def _bar(self, lack: Array) -> Array:
        """Room beyond which nothing need be known where pairs may lack so much [m]."""
        if self._found.violated:
            return np.full(lack.shape, self._wanted)
        return np.maximum(-lack, self._wanted)

    @property
    def _wanted(self) -> float:
        """Room that pairs must come below to be looked at for the least [m]."""
        best = self._found.room
        return best - max(RESOLUTION * abs(best), LEAST_RESOLUTION)

    def _may_lack(
        self, stretches: Stretches, stretch: IntArray | slice, pair: IntArray
    ) -> Array:
        """What pairs may lack: more than nothing only near an end that they touch at.

        Returns:
            Shape (k,) [m], or (m, pairs) for a slice of all stretches.
        """
        lack = np.zeros(())
        for q, allowed in zip(self._ends, self._allowed, strict=True):
            if not np.any(allowed):
                continue
            away = np.max(np.abs(stretches.q - q) + stretches.swing, axis=1)
            here = (away <= self._near)[stretch]
            given = allowed[pair]
            if isinstance(stretch, slice):
                here = here[:, None]
            lack = np.maximum(lack, np.where(here, given, 0.0))
        shape = (stretches.time.size, pair.size)
        return np.broadcast_to(
            lack, shape if isinstance(stretch, slice) else pair.shape
        )

    def _moved(self, stretches: Stretches, pairs: IntArray | None = None) -> Array:
        """How far pairs come closer within stretches at most [m].

        Shape (m, k) for k pairs; None stands for all.
        """
        moved = self._motion.bound(stretches.q, stretches.swing, pairs)
        if self._checker.moving:
            speeds = self._checker.obstacle_speeds(stretches.begin, stretches.end)
            speeds = speeds if pairs is None else speeds[:, pairs]
            moved = moved + speeds * stretches.half[:, None]
        return moved

    def _sharpen(self) -> None:
        """Look for the least room around where it was found."""
        t = self._course.t
        row = int(np.searchsorted(t, self._found.time))
        low, high = t[max(row - SPANS[0], 0)], t[min(row + SPANS[0], t.size - 1)]
        for _ in range(ROUNDS):
            times = np.linspace(low, high, PLACES)
            still = np.zeros((PLACES, self._course.q.shape[1]))
            at = Stretches(times, times, times, self._course.positions(times), still)
            pair = np.full(PLACES, self._found.pair)
            self._measure(at, np.arange(PLACES), pair)
            step, time = times[1] - times[0], self._found.time
            low, high = max(time - step, low), min(time + step, high)


def _rows_within(first: Edges, behind: Edges, span: int) -> tuple[Edges, Edges]:
    """Cut stretches of rows into parts of so many; some of the last ones are empty."""
    parts = -(-int(np.max(behind - first)) // span)
    begin = np.minimum(first[:, None] + span * np.arange(parts), behind[:, None])
    return begin, np.minimum(begin + span, behind[:, None])
