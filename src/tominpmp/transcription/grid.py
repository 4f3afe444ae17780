"""Knots of a motion: shares of its duration, and ticks of the clock of a controller.

A controller receives a motion as samples at its period and interpolates them by
polynomials: cubic ones through positions and velocities, of degree 5 if accelerations
are given as well. A motion that is a polynomial of this degree between any two ticks is
reproduced exactly, so that the controller runs the planned motion. This is the case if
all knots are ticks.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from tominpmp.arrays import Array, IntArray
from tominpmp.motion.samples import multiples

# Number of equal angles into which the first and the last interval of the cosine grid
# are divided, and the additional nodes, as shares of the angle of the first interval:
# without them, a few motions of benchmarks/random_goals.py were 0.1 % slower than a
# time-optimal straight line. They are nodes of a grid with three times as many inner
# intervals, so that a motion on 16 intervals is one on 40 as well: nodes elsewhere made
# motions of a Fetch break torques by 42 % on the finer grid, and end up to 10 % slower.
END_PARTS = 3
END_NODES = np.arange(1, END_PARTS) / END_PARTS
# Number of intervals of the wait before a motion, and least number of intervals of a
# segment, unless the whole motion has fewer.
LEAST_INTERVALS = 10
# A duration this close to a multiple of the period counts as the multiple, in shares of
# the period, and a value this close to its bound counts as equal to it, in shares of
# the bound: interior-point solvers leave the duration slightly above an active bound.
ROUNDING = 1e-6


def interval_shares(kind: str, intervals: int, *, sudden: bool = True) -> Array:
    """Lengths of the intervals as shares of the duration.

    Fast joints reach their speed almost at once when a motion begins and ends; with
    constant accelerations on intervals, a uniform grid makes such motions longer by
    about one interval, 1/(N - 1). The cosine grid has short intervals at both ends: its
    nodes are at (1 - cos(pi k / M)) / 2, also for k = 1/3, 2/3, M - 2/3 and M - 1/3.

    Args:
        kind: "uniform" or "cosine".
        intervals: Number N of intervals.
        sudden: Whether accelerations may jump at the start and at the end of a motion.
            If not, the first and the last interval are not split: shorter intervals
            would need excessive jerks, and make linear programs with jerk limits fail.

    Returns:
        Shares that add up to 1, shape (N, 1).
    """
    if kind == "uniform":
        return np.diff(np.linspace(0.0, 1.0, intervals + 1))[:, None]
    split = sudden and intervals >= 4 * END_NODES.size
    return _cosine_shares(intervals, split, split)[:, None]


def delayed_shares(intervals: int, delay: float, *, sudden: bool = True) -> Array:
    """Lengths of the intervals of a motion that begins with a wait.

    Intervals are short at both ends, as on the cosine grid, but not where the wait and
    the motion meet.

    Args:
        intervals: Number of intervals of the motion that follows the wait.
        delay: Share of the wait in the whole duration, between 0 and 1.
        sudden: Whether accelerations may jump at the ends, see :func:`interval_shares`.

    Returns:
        Lengths of the intervals for a whole duration of 1, shape (W + N, 2): the wait
        and the motion have a column, that is a duration, each.
    """
    before = np.linspace(0.0, 1.0, LEAST_INTERVALS + 1)
    if sudden:
        before = np.sort(np.concatenate([before, before[1] * END_NODES]))
    after = _sine_shares(intervals, sudden)
    parts = delay * np.diff(before), (1.0 - delay) * after
    return np.asarray(block_diag(*(part[:, None] for part in parts)))


def _sine_shares(intervals: int, sudden: bool) -> Array:
    """Shares of intervals that become shorter towards the end only, (intervals,)."""
    extra = END_NODES.size if sudden else 0
    places = np.linspace(0.0, 1.0, intervals - extra + 1)
    last = 1.0 - places[1] * END_NODES[:extra]
    return np.diff(np.sin(0.5 * np.pi * np.sort(np.concatenate([places, last]))))


def segment_intervals(intervals: int, durations: Array) -> IntArray:
    """Number of intervals of each of several segments, shape (k,).

    The intervals of a motion without segments are divided among the segments in
    proportion to their durations, with a least number for each segment.

    Args:
        intervals: Number of intervals of a motion without segments.
        durations: Durations of the segments, in any unit, shape (k,).
    """
    shared = np.rint(intervals * durations / durations.sum()).astype(np.int64)
    least: IntArray = np.clip(shared, min(intervals, LEAST_INTERVALS), intervals)
    return least


def segmented_shares(
    kind: str, counts: IntArray, durations: Array, smooth: bool, *, sudden: bool = True
) -> Array:
    """Lengths of the intervals of several segments with separate durations.

    Intervals are short at both ends of each segment, where torques are likely to
    switch; for continuous accelerations, only at both ends of the whole motion. The
    shortest intervals are at the ends of the whole motion only: where the position is
    free, they make the linear programs ill-conditioned.

    Args:
        kind: "uniform" or "cosine".
        counts: Number of intervals of each segment, shape (k,).
        durations: Durations of the segments, in any unit, shape (k,).
        smooth: Whether accelerations are continuous.
        sudden: Whether accelerations may jump at the ends, see :func:`interval_shares`.

    Returns:
        Lengths of the intervals for a whole duration of 1, shape (sum of counts, k).
    """
    count, parts = durations.size, list[Array]()
    for k, intervals in enumerate(counts.tolist()):
        outer = (k == 0, k == count - 1)
        if kind == "uniform" or count == 1:
            shares = interval_shares(kind, intervals, sudden=sudden)[:, 0]
        elif smooth and not any(outer):
            shares = interval_shares("uniform", intervals)[:, 0]
        elif smooth:
            shares = _sine_shares(intervals, sudden)
            shares = shares[::-1] if k == 0 else shares
        else:
            shares = _cosine_shares(intervals, *outer)
        parts.append(durations[k] / durations.sum() * shares)
    return np.asarray(block_diag(*(part[:, None] for part in parts)))


def _cosine_shares(intervals: int, first: bool, last: bool) -> Array:
    """Shares of a cosine grid, with the first or last interval split on request."""
    inner = np.linspace(0.0, 1.0, intervals - END_NODES.size * (first + last) + 1)
    ends = inner[1] * END_NODES
    parts = [inner, *([ends] if first else []), *([1.0 - ends] if last else [])]
    places = np.sort(np.concatenate(parts))
    return np.diff(0.5 * (1.0 - np.cos(np.pi * places)))


def ticks_of(duration: float, period: float) -> int:
    """Least number of periods that cover a duration, up to rounding."""
    return int(np.ceil(duration / period - ROUNDING))


def whole_periods(duration: float, period: float | None) -> float:
    """Duration rounded up to whole periods [s]; unchanged without a clock.

    Args:
        duration: The duration [s].
        period: Period of the clock [s]; None without a clock.
    """
    if period is None:
        return duration
    return float(multiples(np.array(ticks_of(duration, period)), period))


def at_ticks(times: ArrayLike, period: float) -> Array:
    """Times snapped to the nearest ticks of a clock, exact to the last bit [s].

    Args:
        times: Times that are ticks up to rounding [s].
        period: Period of the clock [s].
    """
    return multiples(np.rint(np.asarray(times) / period), period)


def knots_near(nodes: Array, count: int, intervals: int = 0) -> IntArray:
    """Knots at ticks near the nodes of a motion, scaled to a number of periods.

    Nodes that fall on the same tick become one knot. If this leaves too few intervals,
    the longest intervals are split, as far as there are ticks.

    Args:
        nodes: Times of the nodes, shape (M,), in any unit.
        count: Number of periods of the motion.
        intervals: Least number of intervals.

    Returns:
        Indices of the ticks, increasing from 0, shape (N + 1,).
    """
    share = (nodes - nodes[0]) / (nodes[-1] - nodes[0])
    knots = np.unique(np.rint(share * count).astype(np.int64))
    while knots.size - 1 < min(intervals, count):
        gaps = np.diff(knots)
        k = int(np.argmax(gaps))
        knots = np.insert(knots, k + 1, knots[k] + gaps[k] // 2)
    return knots
