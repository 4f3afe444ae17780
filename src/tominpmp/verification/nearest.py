"""Where a motion comes nearest to what it must not touch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from tominpmp.arrays import Array, IntArray
from tominpmp.collision import CollisionChecker
from tominpmp.problem import Problem
from tominpmp.transcription.exchange import CLOSE, DIPS, dipping
from tominpmp.verification.excess import Excess
from tominpmp.verification.replay import Replay

# Instants at which all distances are measured first, and what two measurements of one
# distance may differ by [m].
GLANCES = 8
GLANCE_ROUNDING = 1e-6
# Instants whose distances are asked for at once; those of long motions take memory.
CHUNK = 2000


class Nearest(NamedTuple):
    """The pair that has the least room beyond its margin.

    Attributes:
        excess: What it lacks.
        distance: Its distance [m].
    """

    excess: Excess
    distance: float


def closest(
    problem: Problem, replay: Replay, checker: CollisionChecker, tolerance: float
) -> Nearest | None:
    """The pair that has the least room beyond its margin on a motion.

    Args:
        problem: The problem, with the margin.
        replay: The motion.
        checker: Distances of the pairs.
        tolerance: What may be missing [m].

    Returns:
        The pair; None without pairs.
    """
    if not checker.pairs:
        return None
    margins = checker.margins(problem.margin)
    # The closest of a few instants tells how far the others need to be looked at.
    last = replay.t.size - 1
    some = np.linspace(0, last, GLANCES).astype(np.int64)
    room = checker.distances(replay.q[some], times=replay.t[some]) - margins
    k, pair = np.unravel_index(int(np.argmin(room)), room.shape)
    time, least = float(replay.t[some[k]]), float(room[k, pair])
    dips: list[IntArray] = []
    for begin in range(0, last + 1, CHUNK):
        cutoff = margins + max(least, 0.0) + GLANCE_ROUNDING + CLOSE
        part = replay.q[begin : begin + CHUNK]
        times = replay.t[begin : begin + CHUNK]
        room = checker.distances(part, cutoff, times) - margins
        k, other = np.unravel_index(int(np.argmin(room)), room.shape)
        if room[k, other] < least:
            time, pair, least = float(times[k]), other, float(room[k, other])
        dips.append(begin + dipping(-room, tolerance, max(least, 0.0) + CLOSE))
    # Between the instants it may be closer.
    found = np.concatenate(dips)
    for begin in range(0, found.size, CHUNK // DIPS.size):
        times = _between(replay.t, found[begin : begin + CHUNK // DIPS.size])
        room = checker.distances(_positions(replay, times), margins, times) - margins
        k, other = np.unravel_index(int(np.argmin(room)), room.shape)
        if room[k, other] < least:
            time, pair, least = float(times[k]), other, float(room[k, other])
    name = " and ".join(checker.pairs[int(pair)])
    violated = not -least <= tolerance
    excess = Excess("clearance", name, time, -least, "m", -least, violated)
    return Nearest(excess, least + float(margins[int(pair)]))


def _between(t: Array, index: IntArray) -> Array:
    """Times around some of the times, up to halfway to the next ones."""
    before = t[index] - t[np.maximum(index - 1, 0)]
    after = t[np.minimum(index + 1, t.size - 1)] - t[index]
    steps = np.where(DIPS < 0.0, before[:, None], after[:, None])
    return np.asarray((t[index, None] + DIPS * steps).ravel())


def _positions(replay: Replay, times: Array) -> Array:
    """Positions between the instants of a replay, by cubic polynomials."""
    return np.asarray(CubicHermiteSpline(replay.t, replay.q, replay.v)(times))
