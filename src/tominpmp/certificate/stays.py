"""Motions without the time that they stay at the ends of their segments.

Nothing can be gained there, and all that matters is how the arm comes and goes: where
nothing but the arm moves, it may as well go on at once.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.exceptions import ProblemError
from tominpmp.problem import Problem
from tominpmp.trajectory import Trajectory

# Nodes this near to a time are at it, as a share of the duration.
SAME = 1e-9


def stays_where_it_moves(problem: Problem) -> bool:
    """Whether motions of a problem have to stay somewhere while obstacles move."""
    stays = any(segment.dwell for segment in problem.segments)
    return stays and any(phase.scene.moving for phase in problem.phases)


def without_stays(problem: Problem, motion: Trajectory) -> Trajectory:
    """A motion that goes on at once wherever it stays.

    Args:
        problem: A problem of several segments.
        motion: Its motion, with the ends of its segments.

    Raises:
        ProblemError: If it stays anywhere, and obstacles move.
    """
    ends = motion.segment_ends
    stays = [segment.dwell for segment in problem.segments]
    if ends is None or not any(stays):
        return motion
    if stays_where_it_moves(problem):
        raise ProblemError(
            "segments: the motion stays where obstacles move, expected no dwell: there "
            "is no certificate for that",
            "segments",
        )
    slack = SAME * motion.duration
    t, last = np.array(motion.t), []
    keep = np.ones(t.size, dtype=bool)
    new = np.array(ends)
    for k, (end, stay) in enumerate(zip(ends.tolist(), stays, strict=True)):
        if stay > 0.0:
            keep &= ~((motion.t > end - stay + slack) & (motion.t <= end + slack))
            t[motion.t >= end - slack] -= stay
            new[k:] -= stay
            last.append(int(np.searchsorted(motion.t, end - stay - slack)))
    u, a = np.array(motion.u), motion.a
    for node in last:
        after = min(node + 1, t.size - 1)
        u[node] = motion.u[after]
    if a is not None:
        # The interval before a node that is left out goes with it.
        a = a[keep] if len(a) == t.size else a[keep[1:]]
    found = replace(
        motion,
        t=t[keep],
        q=motion.q[keep],
        v=motion.v[keep],
        u=u[keep],
        a=a,
        segment_ends=None,
    )
    places = np.argmin(np.abs(found.t[:, None] - new), axis=0)
    return replace(found, segment_ends=found.t[places])
