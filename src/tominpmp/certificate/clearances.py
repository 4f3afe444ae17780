"""Clearances of a motion as linear rows on its small changes.

A pair of bodies limits a motion where it is nearest. That instant moves with the
motion, so that to first order the least distance changes as the distance at that
instant does: what is lost by coming there sooner or later is nothing, as the distance
does not change with time there. A row at another instant of the same approach would say
that it is: it has hardly any room, and would hold a motion that nothing holds. So each
approach of a pair is one row, at its nearest instant; only where a pair stays as near
as it is for a while there are others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.certificate.active_limits import Motion
from tominpmp.certificate.instants import Instants, local_maxima
from tominpmp.certificate.limit_rows import LimitRows
from tominpmp.certificate.perturbations import picked
from tominpmp.certificate.task import Room

# Where a pair that stays near is a row, too: the middles and the ends of the intervals.
REGULAR = (0.5, 1.0)
# Clearances beyond this, in shares of the reach, are no rows.
ATTENTION = 0.03
# Samples of an interval, between which the nearest instants of pairs are looked for.
SAMPLES = 16
# Pairs nearer than this, in shares of the reach, are looked at more closely: corners
# pass each other within a millisecond. So often the time around a sample is halved.
CLOSE, HALVINGS = 0.01, 6
# A pair stays near where at its speed the room would last for this share of the motion.
STAYING = 0.05


class Contacts(NamedTuple):
    """Pairs at instants, with what distances change by.

    Attributes:
        at: The instants, k of them.
        pair: The pair of each, shape (k,).
        missing: What it lacks of its margin, as a share of the reach, shape (k,).
        slopes: Derivatives of that by the configuration, shape (k, n).
        rates: Derivatives by time, of what moves by itself [1/s], shape (k,).
    """

    at: Instants
    pair: IntArray
    missing: Array
    slopes: Array
    rates: Array

    def kept(self, which: IntArray | BoolArray) -> Contacts:
        """Some of them."""
        return Contacts(
            self.at.kept(which),
            self.pair[which],
            self.missing[which],
            self.slopes[which],
            self.rates[which],
        )


class Nearest(NamedTuple):
    """Where pairs are nearest in a motion, k times in all.

    Attributes:
        times: When [s], shape (k,).
        pairs: Which, shape (k,).
        slopes: Derivatives of what the least distances lack, as shares of the reach, by
            the configuration, shape (k, n). Where a corner passes, which has others
            before and after, they are those of the least distance of all.
        rates: Derivatives by time, of what moves by itself [1/s], shape (k,).
    """

    times: Array
    pairs: IntArray
    slopes: Array
    rates: Array

    @classmethod
    def none(cls, n: int) -> Nearest:
        """Nothing near an arm of so many joints."""
        index = np.zeros(0, dtype=np.int64)
        return cls(np.zeros(0), index, np.zeros((0, n)), np.zeros(0))


def clearances(motion: Motion) -> list[LimitRows]:
    """Distances that are near their margins, as shares of the reach."""
    if motion.task.room is None:
        return []
    rows = []
    for found in _Approaches(motion, motion.task.room).contacts():
        inside = found.at.share < 1.0
        for own in (np.flatnonzero(inside), np.flatnonzero(~inside)):
            if own.size:
                rows.append(_rows(motion, found.kept(own)))
    return rows


def nearest_instants(motion: Motion) -> Nearest:
    """When pairs that come close are nearest, and how the least distances change."""
    if motion.task.room is None:
        return Nearest.none(motion.changes.n)
    found = _Approaches(motion, motion.task.room, CLOSE).contacts()
    close = [item.kept(item.missing > -CLOSE) for item in found]
    if not close:
        return Nearest.none(motion.changes.n)
    return Nearest(
        np.concatenate([item.at.times(motion.changes) for item in close]),
        np.concatenate([item.pair for item in close]),
        np.concatenate([item.slopes for item in close]),
        np.concatenate([item.rates for item in close]),
    )


@dataclass(frozen=True, eq=False)
class _Approaches:
    """Looks for the instants at which pairs limit a motion.

    Attributes:
        motion: The motion.
        room: What pairs have left.
        attention: Pairs with more room than this share of the reach are left out.
    """

    motion: Motion
    room: Room
    attention: float = ATTENTION

    def contacts(self) -> list[Contacts]:
        """The nearest instants of all pairs, and those at which they stay near."""
        changes = self.motion.changes
        at = Instants.spread(changes.N, np.arange(1, SAMPLES + 1) / SAMPLES)
        first, end = self.motion.span
        at = at.kept((at.interval >= first) & (at.interval < end))
        times = at.times(changes)
        row, pair, missing = self.room.near(self._q(times), self.attention, times)
        if not row.size:
            return []
        seen, column = np.unique(pair, return_inverse=True)
        table = np.full((times.size, seen.size), -np.inf)
        table[row, column] = missing
        nearest = local_maxima(table)
        rough, close = nearest & (table <= -CLOSE), nearest & (table > -CLOSE)
        regular = np.isin(at.share, REGULAR)[:, None] & (table > -np.inf) & ~nearest
        out = [self._sampled(at, times, seen, table, rough)]
        staying = self._sampled(at, times, seen, table, regular)
        out.append(staying.kept(self._stays(staying)))
        return [*out, *self._closest(times, seen, table, close)]

    def _q(self, times: Array) -> Array:
        """Configurations, shape (m, n)."""
        return np.asarray(self.motion.trajectory(times).q)

    def _sampled(
        self, at: Instants, times: Array, seen: IntArray, table: Array, flags: BoolArray
    ) -> Contacts:
        """Contacts at flagged samples of pairs."""
        rows, columns = np.nonzero(flags)
        found = self._slopes(times[rows], seen[columns])
        return Contacts(at.kept(rows), seen[columns], table[rows, columns], *found)

    def _slopes(self, times: Array, pair: IntArray) -> tuple[Array, Array]:
        """Derivatives of what pairs lack, at a time each."""
        if not times.size:
            return np.zeros((0, self.motion.changes.n)), np.zeros(0)
        distinct, index = np.unique(times, return_inverse=True)
        found = self.room.derivatives_at(self._q(distinct), index, pair, distinct)
        return found[0], found[1]

    def _speed(self, times: Array, slopes: Array, rates: Array) -> Array:
        """How fast what is missing grows along the motion [1/s], shape (k,)."""
        v = self.motion.trajectory(times).v
        return np.asarray(np.einsum("kj,kj->k", slopes, v) + rates)

    def _stays(self, found: Contacts) -> BoolArray:
        """Whether pairs stay as near as they are for a while."""
        T = float(self.motion.changes.t[-1])
        times = found.at.times(self.motion.changes)
        speed = np.abs(self._speed(times, found.slopes, found.rates))
        return np.asarray(np.maximum(-found.missing, 0.0) >= STAYING * T * speed)

    def _closest(
        self, times: Array, seen: IntArray, table: Array, flags: BoolArray
    ) -> list[Contacts]:
        """The nearest instants around flagged samples, found by halving the time.

        A corner that passes is a kink of the distance in time, or nearly: its slope
        there is that mean of those before and after which does not change with time.
        """
        rows, columns = np.nonzero(flags)
        if not rows.size:
            return []
        pair, (first, end) = seen[columns], self.motion.span
        outside = self.motion.changes.t[[first, end]]
        padded = np.concatenate([outside[:1], times, outside[1:]])
        ends = [padded[rows], padded[rows + 2]]
        slopes = [self._slopes(time, pair) for time in ends]
        speeds = [self._speed(ends[i], *slopes[i]) for i in (0, 1)]
        for _ in range(HALVINGS):
            middle = 0.5 * (ends[0] + ends[1])
            by_q, by_t = self._slopes(middle, pair)
            speed = self._speed(middle, by_q, by_t)
            for i, side in enumerate((speed > 0.0, speed <= 0.0)):
                ends[i] = np.where(side, middle, ends[i])
                speeds[i] = np.where(side, speed, speeds[i])
                slopes[i] = (
                    np.where(side[:, None], by_q, slopes[i][0]),
                    np.where(side, by_t, slopes[i][1]),
                )
        # What is missing grows before and falls after; else it is nearest at an end.
        rises, falls = np.maximum(speeds[0], 0.0), np.maximum(-speeds[1], 0.0)
        total = np.maximum(rises + falls, 1e-300)
        after = np.where(rises + falls > 0.0, rises / total, 0.5)
        time = (1.0 - after) * ends[0] + after * ends[1]
        by_q = (1.0 - after)[:, None] * slopes[0][0] + after[:, None] * slopes[1][0]
        by_t = (1.0 - after) * slopes[0][1] + after * slopes[1][1]
        missing = np.maximum(self._missing(time, pair), table[rows, columns])
        at = Instants.at_times(self.motion.changes, time)
        return [Contacts(at, pair, missing, by_q, by_t)]

    def _missing(self, times: Array, pair: IntArray) -> Array:
        """What pairs lack at a time each, shape (k,)."""
        missing = self.room.missing(self._q(times), pair, self.attention, times)
        return np.where(missing > -self.attention, missing, -np.inf)


def _rows(motion: Motion, found: Contacts) -> LimitRows:
    """Rows of contacts, all inside the intervals or all at their ends."""
    changes, (at, pair, missing, slopes, rates) = motion.changes, found
    by_q = picked(slopes, pair.size, np.arange(pair.size))
    if at.share[0] < 1.0:
        state = motion.trajectory(at.times(changes))
        change = changes.inside(*at, state.q, state.v)[0].after(by_q)
    else:
        joints = np.arange(changes.n)
        rows = ((at.interval[:, None] + 1) * changes.n + joints).ravel()
        change = changes.fixed(by_q @ changes.positions[rows])
    if motion.task.room is not None and motion.task.room.moving:
        change = at.with_time(change, rates)
    return LimitRows(
        kind="clearance",
        change=change,
        lower=np.full(pair.size, -np.inf),
        upper=np.maximum(-missing, 0.0),
        interval=at.interval,
        subject=pair,
        share=at.share,
        slopes=slopes,
        unit=motion.task.reach,
    )
