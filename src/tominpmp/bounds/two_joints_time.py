"""Least time of an arm with two joints: the longest time that no motion takes."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.enclosures import Enclosures
from tominpmp.bounds.narrowing import all_motions, narrowed
from tominpmp.bounds.two_joints import TwoJoints
from tominpmp.stopping import Stop, check

# Shortest time looked at [s], and grids of times in the search, each with so many
# parts of a part of the one before; so many are looked at first, each twice the last.
SHORTEST = 1e-2
DOUBLINGS = 6
GRIDS, PARTS = 2, 16
# How often all motions are narrowed, and those that were cut in halves.
ROUNDS, MORE_ROUNDS = 5, 2
# How much longer times are that are looked at with motions told apart, and how near to
# one that is not excluded is near enough.
STRIDE, LAST_STRIDE = 1.2, 1.04
# How many sets of motions there may be for a time, and how many are looked at at once.
MOST_SETS, AT_ONCE = 4000, 256
# After this share of them it is known how many more there would have to be.
EARLY = 0.15
# Slices of a range, how often each range is cut into them at most, and what share of
# one must be left for none to be worth another time.
SLICES, SHAVINGS, LITTLE = 16, 8, 0.9
# Longest time looked at [s].
LONGEST = 1e4
# Relative rounding, and errors of quadrature, that are granted.
ROUNDING = 1e-5


def two_joints_time(
    arm: TwoJoints, *, quick: bool = False, least: float = 0.0, known: float = math.inf
) -> float:
    """Time that no motion can beat, or a little less.

    Where it is time to stop it is what is known by then.

    Args:
        arm: The arm.
        quick: Whether not to tell motions apart by where they are on the way.
        least: A time that no motion can beat for other reasons [s]: where no longer one
            is excluded the outcome may be less.
        known: Duration of a motion, if there is one [s]: no time as long as that can be
            excluded, and none is tried.
    """
    longest = 0.0
    with contextlib.suppress(Stop):
        for T in _excluded_times(arm, quick, least, known):
            longest = T
    return longest * (1.0 - ROUNDING)


def _excluded_times(
    arm: TwoJoints, quick: bool, least: float, known: float
) -> Iterator[float]:
    """Times that no motion takes, each no less than the one before."""
    low, high = least, max(SHORTEST, least)
    while high <= LONGEST:
        doubled: Array = high * np.logspace(0, DOUBLINGS - 1, DOUBLINGS, base=2.0)
        last = _last_excluded(arm, doubled[doubled < known])
        if last == 0.0:
            break
        low, high = last, 2.0 * last
        yield low
        if last < doubled[-1]:
            break
    else:
        return
    high = min(high, known)
    for _ in range(GRIDS if high > low else 0):
        step = (high - low) / PARTS
        times: Array = low + step * np.arange(1.0, PARTS)
        low = max(low, _last_excluded(arm, times))
        high = low + step
        yield low
    # Beyond that, motions are told apart by where they are on the way.
    high = known
    while not quick and low > 0.0 and high > LAST_STRIDE * low:
        T = min(STRIDE * low, math.sqrt(low * high))
        low, high = (T, high) if excluded(arm, T, MOST_SETS) else (low, T)
        yield low


def _last_excluded(arm: TwoJoints, times: Array) -> float:
    """The longest of some times that no motion takes, or zero; times rise."""
    check()
    if not times.size:
        return 0.0
    _, left = narrowed(arm, times, all_motions(arm, times), ROUNDS)
    out = np.setdiff1d(np.arange(times.size), left)
    return float(times[out[-1]]) if out.size else 0.0


def excluded(arm: TwoJoints, T: float, most: int = 1) -> bool:
    """Whether no motion takes so little time, nor less.

    All bounds allow to wait, so that shorter motions are among the longer ones.

    Args:
        arm: The arm.
        T: The time.
        most: How many sets of motions are looked at at most.
    """
    check()
    sets, _ = narrowed(arm, T, all_motions(arm, T), ROUNDS)
    if not sets.rows or most == 1:
        return not sets.rows
    sets = shaved(arm, T, sets)
    if not sets.rows:
        return True
    width = np.maximum(sets.high - sets.low, 1e-12)[0]
    left, seen, share = [(sets, 1.0)], 0, 1.0
    while left:
        check()
        sets, part = left.pop()
        if sets.rows > AT_ONCE:
            left.append((sets.taken(np.arange(AT_ONCE, sets.rows)), part))
            sets = sets.taken(np.arange(AT_ONCE))
        seen += 2 * sets.rows
        share -= sets.rows * part
        # What is done so far tells how much there is to do.
        if seen > most or (seen > EARLY * most and seen > (1.0 - share) * most):
            return False
        sets, _ = narrowed(arm, T, sets.halved(width), MORE_ROUNDS)
        part *= 0.5
        share += sets.rows * part
        if sets.rows:
            left.append((sets, part))
    return True


def shaved(arm: TwoJoints, T: float, sets: Enclosures) -> Enclosures:
    """One row without the slices of its ranges in which nothing is left.

    Those that are left of each range are enclosed anew, so that it narrows all others.
    """
    for _ in range(SHAVINGS):
        check()
        before = sets
        slices, which = narrowed(arm, T, sets.sliced(SLICES), MORE_ROUNDS)
        for number in range(sets.low.size):
            mine = np.flatnonzero(which // SLICES == number)
            if not mine.size:
                return slices.taken(mine)
            sets = sets.cut(slices.taken(mine).hull)
        if np.any(sets.low > sets.high):
            return sets.taken(np.zeros(0, dtype=np.intp))
        with np.errstate(invalid="ignore", divide="ignore"):
            left = (sets.high - sets.low) / (before.high - before.low)
        if not np.any(left < LITTLE):
            break
    return sets
