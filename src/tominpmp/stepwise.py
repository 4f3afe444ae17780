"""Reconstruction of motions whose accelerations jump, from samples."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array, BoolArray

# Deviations up to which positions and velocities are what the accelerations make,
# relative to the largest ones: more than rounding, as jumps may come in pairs.
EXACT_Q, EXACT_V = 1e-8, 1e-6
# Times of ROS messages are rounded to this [s].
NANOSECOND = 1e-9
# Jumps this close to the middle of their intervals, in shares of these, one after
# another, are what a ramp looks like.
MIDDLE = 0.01
# Accelerations that differ from those of cubics by this share of the largest one are
# others; those that jump by this share do.
CUBIC, JUMP = 1e-6, 0.02


def stepwise_motion(
    t: Array, q: Array, v: Array, a: Array
) -> tuple[Array, Array, Array, Array] | None:
    """Find the motion whose acceleration is that of the samples, with jumps.

    Where all joints jump at one instant between two samples, from the acceleration of
    the one to that of the other, that instant follows from the velocities.

    Returns:
        Times, positions and velocities with those instants, and the acceleration of
        every interval; None if the samples are not of such a motion.
    """
    if np.isnan(a).any():
        return None
    h, before, jump = np.diff(t), a[:-1], np.diff(a, axis=0)
    slack_v = EXACT_V * (1.0 + np.abs(v).max()) + NANOSECOND * np.abs(a).max()
    slack_q = EXACT_Q * (1.0 + np.abs(q).max()) + NANOSECOND * np.abs(v).max()
    gap = np.diff(v, axis=0) - h[:, None] * before
    jumps = np.any(np.abs(gap) > slack_v, axis=1)
    # Time from the jump to the next sample.
    rest = np.zeros(h.size)
    size = np.sum(jump[jumps] ** 2, axis=1)
    if np.any(size == 0.0):
        return None
    rest[jumps] = np.clip(
        np.sum(gap[jumps] * jump[jumps], axis=1) / size, 0.0, h[jumps]
    )
    gap_q = np.diff(q, axis=0) - h[:, None] * (v[:-1] + 0.5 * h[:, None] * before)
    if _ramps(h, jumps, rest):
        return None
    missed = np.abs(gap - rest[:, None] * jump) > slack_v
    missed_q = np.abs(gap_q - 0.5 * rest[:, None] ** 2 * jump) > slack_q
    if np.any(missed) or np.any(missed_q):
        return None
    at = np.flatnonzero(jumps)
    s = (h[at] - rest[at])[:, None]
    times = np.insert(t, at + 1, t[at] + s[:, 0])
    if np.any(np.diff(times) <= 0.0):
        return None
    return (
        times,
        np.insert(q, at + 1, q[at] + s * (v[at] + 0.5 * s * a[at]), axis=0),
        np.insert(v, at + 1, v[at] + s * a[at], axis=0),
        np.insert(a, at + 1, a[at + 1], axis=0)[:-1],
    )


def _ramps(h: Array, jumps: BoolArray, rest: Array) -> bool:
    """Whether jumps of accelerations are what ramps look like that are sampled.

    Velocities are the same whether an acceleration rises evenly from one sample to the
    next or jumps halfway; positions nearly so, but what they differ by adds up.

    Args:
        h: Lengths of the intervals between samples [s], shape (m,).
        jumps: In which of them accelerations jump, shape (m,).
        rest: Time from the jump to the end of the interval [s], shape (m,).
    """
    halfway = jumps & (np.abs(rest - 0.5 * h) <= MIDDLE * h)
    after = np.append(halfway[:-1] & halfway[1:], False)
    row = after | np.insert(after[:-1], 0, False)
    return bool(2 * np.sum(row) > np.sum(jumps))


def cubics_that_jump(t: Array, q: Array, v: Array, a: Array) -> bool:
    """Whether samples are nodes of cubics whose accelerations jump at some.

    A row has the acceleration just after its jump; those of polynomials of degree 5
    would have to end with it.

    Args:
        t: Times [s], shape (m,).
        q: Positions, shape (m, n).
        v: Velocities, shape (m, n).
        a: Accelerations, shape (m, n); NaN where they are not known.
    """
    if not all(np.all(np.isfinite(part)) for part in (q, v, a)):
        return False
    h, largest, rise = np.diff(t)[:, None], np.abs(a).max(), np.diff(q, axis=0)
    begins = 6.0 * rise / h**2 - (4.0 * v[:-1] + 2.0 * v[1:]) / h
    ends = -6.0 * rise / h**2 + (2.0 * v[:-1] + 4.0 * v[1:]) / h
    if np.any(np.abs(begins - a[:-1]) > CUBIC * largest):
        return False
    return bool(np.any(np.abs(ends - a[1:]) > JUMP * largest))
