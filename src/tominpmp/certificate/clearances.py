"""Where pairs of bodies are nearest in a motion, and what the distances change by.

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
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.certificate.motion import Motion
from tominpmp.certificate.perturbations import Instants
from tominpmp.motion.extrema import local_maxima

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


class Nearest(NamedTuple):
    """Where pairs are nearest in a motion, k times in all.

    Attributes:
        times: When [s], shape (k,).
        pairs: Which, shape (k,).
        missing: What each lacks of its margin, as a share of the reach, shape (k,).
        slopes: Derivatives of what the least distances lack, as shares of the reach, by
            the configuration, shape (k, n). Where a corner passes, which has others
            before and after, they are those of the least distance of all.
        rates: Derivatives by time, of what moves by itself [1/s], shape (k,).
    """

    times: Array
    pairs: IntArray
    missing: Array
    slopes: Array
    rates: Array


def contacts(motion: Motion) -> Nearest | None:
    """The nearest instants of all pairs, and those at which they stay near.

    Args:
        motion: The motion.

    Returns:
        The pairs then; None if nothing is near.
    """
    task, changes = motion.task, motion.changes
    if not task.problem.checker.pairs:
        return None
    looks = _Approaches(motion)
    at = Instants.spread(motion.span, np.arange(1, SAMPLES + 1) / SAMPLES)
    times = changes.times(at)
    table = looks.table(times)
    near = table > -np.inf
    seen = np.flatnonzero(near.any(axis=0))
    if not seen.size:
        return None
    table, near = table[:, seen], near[:, seen]
    nearest = local_maxima(table)
    regular = np.isin(at.share, REGULAR)[:, None] & near & ~nearest

    def sampled(flags: BoolArray) -> Nearest:
        rows, columns = np.nonzero(flags)
        slopes = looks.slopes(times[rows], seen[columns])
        return Nearest(times[rows], seen[columns], table[rows, columns], *slopes)

    found = [sampled(nearest & (table <= -CLOSE)), sampled(regular)]
    # They stay as near as they are for a while.
    staying, T = found[1], float(changes.t[-1])
    speed = np.abs(looks.speed(staying.times, staying.slopes, staying.rates))
    kept = np.maximum(-staying.missing, 0.0) >= STAYING * T * speed
    found[1] = Nearest._make(part[kept] for part in staying)
    close = nearest & (table > -CLOSE)
    if close.any():
        found.append(looks.closest(times, seen, table, close))
    return Nearest(*map(np.concatenate, zip(*found, strict=True)))


@dataclass(frozen=True, eq=False)
class _Approaches:
    """What pairs of bodies lack of their margins along a motion."""

    motion: Motion

    @cached_property
    def _margins(self) -> Array:
        """Distances to keep, shape (pairs,) [m]."""
        problem = self.motion.task.problem
        return problem.checker.margins(problem.margin)

    def table(self, times: Array) -> Array:
        """What all pairs lack; minus infinity where they are far, shape (m, pairs)."""
        task = self.motion.task
        cutoff = self._margins + ATTENTION * task.reach
        found = task.problem.checker.distances(self._q(times), cutoff, times)
        missing = (self._margins - found) / task.reach
        return np.where(missing > -ATTENTION, missing, -np.inf)

    def _q(self, times: Array) -> Array:
        """Configurations, shape (m, n)."""
        return np.asarray(self.motion.trajectory(times).q)

    def slopes(self, times: Array, pair: IntArray) -> tuple[Array, Array]:
        """Derivatives of what pairs lack, at a time each."""
        if not times.size:
            return np.zeros((0, self.motion.changes.n)), np.zeros(0)
        task = self.motion.task
        distinct, index = np.unique(times, return_inverse=True)
        q = self._q(distinct)
        found = task.problem.checker.derivatives_at(q, index, pair, distinct)
        return -found[0] / task.reach, -found[1] / task.reach

    def speed(self, times: Array, slopes: Array, rates: Array) -> Array:
        """How fast what is missing grows along the motion [1/s], shape (k,)."""
        v = self.motion.trajectory(times).v
        return np.asarray(np.einsum("kj,kj->k", slopes, v) + rates)

    def closest(
        self, times: Array, seen: IntArray, table: Array, flags: BoolArray
    ) -> Nearest:
        """The nearest instants around flagged samples, found by halving the time.

        A corner that passes is a kink of the distance in time, or nearly: its slope
        there is that mean of those before and after which does not change with time.
        """
        rows, columns = np.nonzero(flags)
        pair, changes = seen[columns], self.motion.changes
        first, end = changes.t[list(self.motion.span)]
        padded = np.concatenate([[first], times, [end]])
        ends = [padded[rows], padded[rows + 2]]
        slopes = [self.slopes(time, pair) for time in ends]
        speeds = [self.speed(ends[i], *slopes[i]) for i in (0, 1)]
        for _ in range(HALVINGS):
            middle = 0.5 * (ends[0] + ends[1])
            by_q, by_t = self.slopes(middle, pair)
            speed = self.speed(middle, by_q, by_t)
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
        return Nearest(time, pair, missing, by_q, by_t)

    def _missing(self, times: Array, pair: IntArray) -> Array:
        """What pairs lack at a time each, shape (k,)."""
        task, margin = self.motion.task, self._margins[pair]
        enough, every = margin + ATTENTION * task.reach, np.arange(pair.size)
        q = self._q(times)
        found = task.problem.checker.measured(q, every, pair, enough, times)
        missing = (margin - found) / task.reach
        return np.where(missing > -ATTENTION, missing, -np.inf)
