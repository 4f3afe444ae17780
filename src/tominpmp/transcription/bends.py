"""Where the controls of a motion bend, and which intervals are to be halved for it.

Constant accelerations leave a part of torques, as these run on while accelerations
stand. A torque that is at its limit somewhere in an interval comes there at one end of
it, and is below it for the rest. The shorter the interval, the less it lacks.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.transcription.bspline import BSplineTranscription
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.layout import Gridded

# The largest number of intervals.
MOST_INTERVALS = 300
# Intervals are halved that have this share of all bends, with their lengths, together.
BENDS = 0.95
# Shorter intervals, as shares of T, are left as they are.
SHORTEST = 1e-3
# Where a joint is at its speed limit from end to end of an interval, there is nothing
# to gain for it; if it is one that T hangs on, which is there for this share of T. The
# others may swing at their limits to help it elsewhere.
AT_LIMIT, RULING = 0.999, 0.4
# Constant accelerations that leave this much of torques at their limits, in shares of
# their half ranges in the mean, are held by that rather than by where they jump.
MUCH_MISSING = 1e-2
# Torques beyond this share of their limits are at them.
AT_TORQUE_LIMIT = 0.98


def to_be_split(of: Gridded, z: Array, share: float = BENDS) -> BoolArray:
    """Which intervals are to be halved: those with a share of all bends, (N,).

    Constant accelerations that are held by torques are divided where these run to their
    limits: in halves they jump no less, and gain all the same.
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
    """What torques at their limits lack, (N,); None if that is not much."""
    if not isinstance(of, InverseTranscription):
        return None
    losses = h * missing_torque(*torques_at_ends(of, z))
    return losses if losses.sum() > MUCH_MISSING * h.sum() else None


def _bends(of: Gridded, z: Array, h: Array) -> Array:
    """How much controls bend, with lengths, where speeds leave them room, (N,)."""
    speeds = np.abs(of.trajectory(z).v)
    limits = of.system.problem.robot.limits
    bends = h * bends_of_controls(of, z)
    at_limit = speeds > AT_LIMIT * limits.velocity
    if at_limit.shape[0] == h.size + 1:  # no stays on the way
        at_limit = at_limit[1:] & at_limit[:-1]
        ruling = h @ at_limit > RULING * h.sum()
        bends[np.any(at_limit[:, ruling], axis=1)] = 0.0
    return bends


def bends_of_controls(of: Gridded, z: Array) -> Array:
    """How much the controls jump, or their slopes, around each interval, shape (N,)."""
    variation = of.scaled_at(z).variation(z)
    jumps = np.abs(variation.matrix @ z + variation.offset)
    N, more = of.intervals, 0
    if isinstance(of, BSplineTranscription):
        more = max(of.degree - 3, 0)
    # Jumps are between N intervals, or between as many control points and some more.
    jumps = np.max(jumps.reshape(N - 1 + more, -1), axis=1, initial=0.0)
    jumps = np.concatenate([[0.0], jumps, [0.0]])
    width = jumps.size - N + 1
    around = [jumps[k : k + N] for k in range(width)]
    return np.asarray(np.max(around, axis=0))


def torques_at_ends(of: InverseTranscription, z: Array) -> tuple[Array, Array]:
    """Torques where each interval begins and where it ends, shares, shape (N, n) each.

    Args:
        of: The parameterisation.
        z: An iterate of it.
    """
    found = of.states(of.motion(z), of.instants(2, ""), 2)
    q, v, a = (x.reshape(2, of.intervals, -1) for x in (found.q, found.v, found.a))
    torques = np.empty_like(a)
    for part, (first, last) in zip(of.system.segments, of.segments, strict=True):
        for end in (0, 1):
            here = end, slice(first, last)
            torques[here] = part.torque(q[here], v[here], a[here])
    return torques[0], torques[1]


def missing_torque(begin: Array, end: Array) -> Array:
    """Mean share that a torque at its limit lacks on each interval, largest, (N,).

    Args:
        begin: Torques where each interval begins, shares, shape (N, n).
        end: Torques where it ends, shape (N, n).
    """
    at_limit = np.maximum(np.abs(begin), np.abs(end)) > AT_TORQUE_LIMIT
    missing = np.where(at_limit, 0.5 * np.abs(end - begin), 0.0)
    return np.asarray(np.max(missing, axis=1))
