"""Choice of the intervals to halve, by the jumps of the controls or unused torque.

Constant accelerations leave a part of the torque range unused, as torques change while
accelerations are constant. A torque that saturates in an interval reaches its limit at
one end of it only, and stays below the limit elsewhere. The shorter the interval, the
smaller the unused torque.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tominpmp.arrays import Array, BoolArray
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.layout import MOST_INTERVALS, Gridded

# The intervals to halve hold this share of the sum of all losses. The loss of an
# interval is its length times the largest jump of the controls, or of their slopes,
# around it, or times its unused torque.
HALVED_SHARE = 0.95
# Intervals shorter than this share of T are not halved.
SHORTEST = 1e-3
# A finer grid gains nothing on an interval in which a limiting joint, one that
# determines T, is at its speed limit throughout. A joint counts as limiting if it is at
# its speed limit for the share LIMITING of T; other joints may reach theirs only to
# support its motion elsewhere. Speeds above the share AT_LIMIT of their limit count as
# being at it.
AT_LIMIT, LIMITING = 0.999, 0.4
# If constant accelerations leave more than this mean share of the half range of
# saturated torques unused, intervals are chosen by the unused torque instead of the
# jumps.
MUCH_MISSING = 1e-2
# Torques beyond this share of their limits count as saturated.
AT_TORQUE_LIMIT = 0.98


def intervals_to_halve(of: Gridded, z: Array) -> BoolArray:
    """Whether to halve each interval, (N,): the intervals with most of the losses.

    Where torques limit constant accelerations, the intervals with saturated torques are
    halved: the jumps of the halves are no smaller, but they use more of the torque.

    Args:
        of: The parameterisation.
        z: An iterate of it.
    """
    h = of.motion(z).h
    losses = _unused_torques(of, z, h)
    if losses is None:
        losses = _jumps(of, z, h)
    losses[h < SHORTEST * h.sum()] = 0.0
    order = np.argsort(-losses, kind="stable")
    before = np.cumsum(losses[order]) - losses[order]
    split = np.zeros(h.size, dtype=bool)
    split[order] = (losses[order] > 0.0) & (before < HALVED_SHARE * losses.sum())
    split[order[max(MOST_INTERVALS - h.size, 0) :]] = False
    return split


def _unused_torques(of: Gridded, z: Array, h: Array) -> Array | None:
    """Unused torque times interval length, shape (N,); None if small.

    For each interval, it is the largest over all joints of the mean unused torque of a
    saturated joint, as a share of the half range, and of the jump of a torque around
    the interval, weighted by the share of the interval in T.
    """
    if not isinstance(of, InverseTranscription):
        return None
    at = of.instants(2, "")  # the beginnings of all intervals, then their ends
    _, q, v, a, _ = of.states(of.motion(z), at, 2)
    torques = np.empty_like(a)
    for part, (first, last) in zip(of.system.segments, of.segments, strict=True):
        mine = (at.interval >= first) & (at.interval < last)
        torques[mine] = part.torque(q[mine], v[mine], a[mine])
    begin, end = torques.reshape(2, h.size, -1)
    at_limit = np.maximum(np.abs(begin), np.abs(end)) > AT_TORQUE_LIMIT
    missing = np.where(at_limit, 0.5 * np.abs(end - begin), 0.0)
    # Where a torque switches inside an interval, it is between its limits on all of it.
    # The switching function is zero there: the loss is of the second order in length.
    around = np.pad(0.5 * (begin + end), ((1, 1), (0, 0)), mode="edge")
    jumps = 0.5 * np.abs(around[2:] - around[:-2])
    missing = np.maximum(missing, jumps * (h / h.sum())[:, None])
    unused = h * np.max(missing, axis=1)
    return unused if unused.sum() > MUCH_MISSING * h.sum() else None


def _jumps(of: Gridded, z: Array, h: Array) -> Array:
    """Jumps of the controls times length, (N,); zero where limiting speeds saturate."""
    speeds = np.abs(of.trajectory(z).v)
    limits = of.system.problem.robot.limits
    losses = h * _jumps_of_controls(of, z)
    at_limit = speeds > AT_LIMIT * limits.velocity
    if at_limit.shape[0] == h.size + 1:  # without dwells, nodes match intervals
        at_limit = at_limit[1:] & at_limit[:-1]
        limiting = h @ at_limit > LIMITING * h.sum()
        losses[np.any(at_limit[:, limiting], axis=1)] = 0.0
    return losses


def _jumps_of_controls(of: Gridded, z: Array) -> Array:
    """Largest jump of the controls, or of their slopes, around each interval, (N,)."""
    variation = of.scaled_at(z).variation(z)
    jumps = np.abs(variation.at(z))
    N, more = of.intervals, max(of.degree - 3, 0)
    # The jumps are between N intervals, or between N control points and a few more.
    jumps = np.max(jumps.reshape(N - 1 + more, -1), axis=1, initial=0.0)
    jumps = np.concatenate([[0.0], jumps, [0.0]])
    return np.asarray(np.max(sliding_window_view(jumps, 2 + more), axis=1))
