"""Trajectories of motions of several segments: what is carried on each, and stays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.base import Transcription


def trajectory_of_segments(of: Transcription[Any], motion: Trajectory) -> Trajectory:
    """A motion as that of its segments, with the times that it stays at their ends.

    Args:
        of: Its parameterisation.
        motion: The motion, as if nothing else was carried and it stayed nowhere.

    Returns:
        The motion; as it was where there is one segment only.
    """
    if of.segment_ends is None:
        return motion
    whole = replace(motion, segment_ends=motion.t[list(of.segment_ends)])
    for k, segment in enumerate(of.system.problem.segments):
        if segment.dwell > 0.0:
            whole = _with_stay(whole, k, segment.dwell)
    inverses = tuple(part.motor_dynamics.inverse for part in of.system.segments)
    return whole.with_torques(inverses[0], inverses)


def _with_stay(motion: Trajectory, segment: int, dwell: float) -> Trajectory:
    """A motion that stays where a segment ends [s], at rest."""
    assert motion.segment_ends is not None  # noqa: S101
    ends = np.array(motion.segment_ends)
    node = int(np.searchsorted(motion.t, ends[segment]))
    t = np.concatenate([motion.t[: node + 1], motion.t[node:] + dwell])
    v = np.array(motion.v)
    v[node] = 0.0
    q, v, u = (np.insert(x, node + 1, x[node], axis=0) for x in (motion.q, v, motion.u))
    a = None if motion.a is None else np.array(motion.a)
    if a is not None and len(a) == motion.t.size:
        a[node] = 0.0
        a = np.insert(a, node + 1, 0.0, axis=0)
    elif a is not None:
        a = np.insert(a, node, 0.0, axis=0)
    ends[segment:] += dwell
    # Sums may round: each end is the node that it is.
    ends = t[np.argmin(np.abs(t[:, None] - ends), axis=0)]
    return replace(motion, t=t, q=q, v=v, u=u, a=a, segment_ends=ends)
