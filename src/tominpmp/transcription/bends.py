"""Bends of the controls of a motion, and the intervals to be halved for them.

Constant accelerations leave a part of the torque range unused, as torques change while
accelerations are constant. A torque that saturates in an interval reaches its limit at
one end, and is below the limit for the rest. The shorter the interval, the smaller the
missing torque.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tominpmp.arrays import Array, BoolArray
from tominpmp.transcription.bspline import BSplineTranscription
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.layout import Gridded

# The largest number of intervals.
MOST_INTERVALS = 300
# The intervals that are halved hold this share of all bends, weighted by length.
BENDS = 0.95
# Shorter intervals, as shares of T, are not halved.
SHORTEST = 1e-3
# A finer grid gains nothing on an interval where a ruling joint, on which T depends, is
# at its speed limit from end to end: a ruling joint is at its limit for this share of
# T. Other joints may swing at their limits to help it elsewhere.
AT_LIMIT, RULING = 0.999, 0.4
# Where constant accelerations leave this much of saturated torques unused, in shares of
# their half ranges in the mean, the missing torque rather than the jumps picks the
# intervals.
MUCH_MISSING = 1e-2
# Torques beyond this share of their limits are at them.
AT_TORQUE_LIMIT = 0.98


def to_be_split(of: Gridded, z: Array, share: float = BENDS) -> BoolArray:
    """Which intervals are to be halved: intervals that hold a share of all bends, (N,).

    Constant accelerations limited by torques are divided where the torques saturate:
    the halves jump no less, but recover missing torque.
    """
    h = of.motion(z).h
    bends = _losses(of, z, h)
    if bends is None:
        bends = _bends(of, z, h)
    bends[h < SHORTEST * h.sum()] = 0.0
    order = np.argsort(-bends, kind="stable")
    before = np.cumsum(bends[order]) - bends[order]
    split = np.zeros(h.size, dtype=bool)
    split[order] = (bends[order] > 0.0) & (before < share * bends.sum())
    split[order[max(MOST_INTERVALS - h.size, 0) :]] = False
    return split


def _losses(of: Gridded, z: Array, h: Array) -> Array | None:
    """Missing torque of saturated joints, times length, (N,); None if it is small.

    It is the mean over an interval, in shares of the half range, of the joint that
    misses most.
    """
    if not isinstance(of, InverseTranscription):
        return None
    at = of.instants(2, "")  # where all intervals begin, and where they end
    _, q, v, a, _ = of.states(of.motion(z), at, 2)
    torques = np.empty_like(a)
    for part, (first, last) in zip(of.system.segments, of.segments, strict=True):
        mine = (at.interval >= first) & (at.interval < last)
        torques[mine] = part.torque(q[mine], v[mine], a[mine])
    begin, end = torques.reshape(2, h.size, -1)
    at_limit = np.maximum(np.abs(begin), np.abs(end)) > AT_TORQUE_LIMIT
    missing = np.where(at_limit, 0.5 * np.abs(end - begin), 0.0)
    losses = h * np.max(missing, axis=1)
    return losses if losses.sum() > MUCH_MISSING * h.sum() else None


def _bends(of: Gridded, z: Array, h: Array) -> Array:
    """Bends of the controls, times length, where speeds are not saturated, (N,)."""
    speeds = np.abs(of.trajectory(z).v)
    limits = of.system.problem.robot.limits
    bends = h * _bends_of_controls(of, z)
    at_limit = speeds > AT_LIMIT * limits.velocity
    if at_limit.shape[0] == h.size + 1:  # no dwells on the way
        at_limit = at_limit[1:] & at_limit[:-1]
        ruling = h @ at_limit > RULING * h.sum()
        bends[np.any(at_limit[:, ruling], axis=1)] = 0.0
    return bends


def _bends_of_controls(of: Gridded, z: Array) -> Array:
    """Largest jump of the controls, or of their slopes, around each interval, (N,)."""
    variation = of.scaled_at(z).variation(z)
    jumps = np.abs(variation.at(z))
    N, more = of.intervals, 0
    if isinstance(of, BSplineTranscription):
        more = max(of.degree - 3, 0)
    # Jumps are between N intervals, or between as many control points and some more.
    jumps = np.max(jumps.reshape(N - 1 + more, -1), axis=1, initial=0.0)
    jumps = np.concatenate([[0.0], jumps, [0.0]])
    return np.asarray(np.max(sliding_window_view(jumps, 2 + more), axis=1))
