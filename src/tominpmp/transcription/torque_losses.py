"""What constant accelerations leave of torques: these run on while accelerations stand.

A torque that is at its limit somewhere in an interval comes there at one end of it, and
is below it for the rest. The shorter the interval, the less it lacks.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.transcription.inverse import InverseTranscription

# Torques beyond this share of their limits are at them.
AT_LIMIT = 0.98


def torques_at_ends(of: InverseTranscription, z: Array) -> tuple[Array, Array]:
    """Torques where each interval begins and where it ends, shares, shape (N, n) each.

    Args:
        of: The parameterisation.
        z: An iterate of it.
    """
    spline = of.motion(z)
    a = spline.a
    begin, end = np.empty_like(a), np.empty_like(a)
    parts = zip(of.system.segments, of.segments, strict=True)
    for part, (first, last) in parts:
        here, there = slice(first, last), slice(first + 1, last + 1)
        begin[here] = part.torque(spline.q[here], spline.v[here], a[here])
        end[here] = part.torque(spline.q[there], spline.v[there], a[here])
    return begin, end


def missing_torque(begin: Array, end: Array) -> Array:
    """Mean share that a torque at its limit lacks on each interval, largest, (N,).

    Args:
        begin: Torques where each interval begins, shares, shape (N, n).
        end: Torques where it ends, shape (N, n).
    """
    at_limit = np.maximum(np.abs(begin), np.abs(end)) > AT_LIMIT
    missing = np.where(at_limit, 0.5 * np.abs(end - begin), 0.0)
    return np.asarray(np.max(missing, axis=1))
