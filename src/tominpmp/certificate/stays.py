"""Motions without the dwells at the ends of their segments.

The duration of a dwell cannot shrink, and only the motion before and after it matters:
where obstacles do not move, the dwell may be left out.

Accelerations that must not jump are zero at a dwell, and arrival times count the dwells
before them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tominpmp.certificate.motion import Motion
from tominpmp.exceptions import ProblemError
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import spans_of

# Tolerance between a node and a time, as a share of the duration.
SAME = 1e-9


def stays_where_it_moves(problem: Problem) -> bool:
    """Whether motions of a problem have dwells while obstacles move."""
    stays = any(segment.dwell for segment in problem.segments)
    return stays and any(phase.scene.moving for phase in problem.phases)


def with_stays(problem: Problem, stays: Sequence[float]) -> Problem:
    """The same problem with other dwells at the ends of its segments.

    Args:
        problem: The problem.
        stays: Dwell at the end of each segment [s].
    """
    each = zip(problem.segments, stays, strict=True)
    segments = tuple(replace(segment, dwell=stay) for segment, stay in each)
    return problem._altered(segments=segments)


def without_stays(problem: Problem, motion: Trajectory) -> tuple[Problem, Trajectory]:
    """A motion without its dwells.

    Args:
        problem: The problem.
        motion: Its motion, with the ends of its segments if there are several.

    Returns:
        The problem with the dwells of the motion, and the motion without them.

    Raises:
        ProblemError: If the motion has a dwell, and obstacles move.
    """
    ends, spans = motion.segment_ends, spans_of(motion, problem.segments)
    stays = [span.end - span.arrival for span in spans]
    if ends is None or not any(stays):
        return problem, motion
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
    after = np.array(last, dtype=int) + 1
    u[after - 1] = motion.u[np.minimum(after, t.size - 1)]
    if a is not None:
        # The interval before a node that is left out goes with it.
        a = a[keep] if len(a) == t.size else a[keep[1:]]
    t = t[keep]
    if t[-1] and stays_where_it_moves(problem):
        raise ProblemError(
            "segments: the motion stays where obstacles move, expected no dwell: there "
            "is no certificate for that",
            "segments",
        )
    ends = t[np.argmin(np.abs(t[:, None] - new), axis=0)]
    q, v, u = motion.q[keep], motion.v[keep], u[keep]
    found = replace(motion, t=t, q=q, v=v, u=u, a=a, segment_ends=ends)
    return with_stays(problem, stays), found


def still_nodes(motion: Motion) -> list[int]:
    """Nodes at which accelerations that must not jump are zero.

    These are both ends, and the dwells; controls at the ends of intervals have the
    indices of their nodes.

    Args:
        motion: The motion, without its dwells.
    """

    def smooth(part: Motion) -> bool:
        return part.system.motion_limits.continuous

    parts = motion.segments
    found = [place for place in (0, -1) if smooth(parts[place])]
    if motion.changes.controls > motion.changes.N:
        for part, after, segment in zip(
            parts[:-1], parts[1:], motion.system.problem.segments[:-1], strict=True
        ):
            if segment.dwell > 0.0 and (smooth(part) or smooth(after)):
                found.append(part.span[1])
    return found
