"""Motions without the dwells at the ends of their segments.

The duration of a dwell cannot shrink, so that only the motion before and after the
dwell matters: where obstacles do not move, the certificate omits the dwell.

Accelerations that must not jump are zero at a dwell, and arrival times include the
dwells before them.
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


def dwells_among_motion(problem: Problem) -> bool:
    """Whether a problem has dwells while obstacles move."""
    dwells = any(segment.dwell for segment in problem.segments)
    return dwells and any(phase.scene.moving for phase in problem.phases)


def with_dwells(problem: Problem, dwells: Sequence[float]) -> Problem:
    """The same problem with other dwells at the ends of its segments.

    Args:
        problem: The problem.
        dwells: Dwell at the end of each segment [s].
    """
    each = zip(problem.segments, dwells, strict=True)
    segments = tuple(replace(segment, dwell=dwell) for segment, dwell in each)
    return problem._altered(segments=segments)


def without_dwells(problem: Problem, motion: Trajectory) -> tuple[Problem, Trajectory]:
    """A motion without its dwells.

    Args:
        problem: The problem.
        motion: The motion, with the end times of its segments if there are several.

    Returns:
        The problem with the dwells of the motion, and the motion without dwells.

    Raises:
        ProblemError: If the motion has a dwell, and obstacles move.
    """
    ends, spans = motion.segment_ends, spans_of(motion, problem.segments)
    dwells = [span.end - span.arrival for span in spans]
    if ends is None or not any(dwells):
        return problem, motion
    slack = SAME * motion.duration
    t, last = np.array(motion.t), []
    keep = np.ones(t.size, dtype=bool)
    shifted = np.array(ends)
    for k, (end, dwell) in enumerate(zip(ends.tolist(), dwells, strict=True)):
        if dwell > 0.0:
            keep &= ~((motion.t > end - dwell + slack) & (motion.t <= end + slack))
            t[motion.t >= end - slack] -= dwell
            shifted[k:] -= dwell
            last.append(int(np.searchsorted(motion.t, end - dwell - slack)))
    u, a = np.array(motion.u), motion.a
    after = np.array(last, dtype=int) + 1
    u[after - 1] = motion.u[np.minimum(after, t.size - 1)]
    if a is not None:
        # The interval before a node that is left out goes with it.
        a = a[keep] if len(a) == t.size else a[keep[1:]]
    t = t[keep]
    if t[-1] and dwells_among_motion(problem):
        raise ProblemError(
            "segments: the motion dwells while obstacles move, expected no dwell: "
            "there is no certificate for dwells among moving obstacles",
            "segments",
        )
    ends = t[np.argmin(np.abs(t[:, None] - shifted), axis=0)]
    q, v, u = motion.q[keep], motion.v[keep], u[keep]
    moving = replace(motion, t=t, q=q, v=v, u=u, a=a, segment_ends=ends)
    return with_dwells(problem, dwells), moving


def rest_nodes(motion: Motion) -> list[int]:
    """Nodes at which accelerations that must not jump are zero.

    They are both ends of the motion, and the nodes of dwells. If accelerations belong
    to nodes, their indices are the indices of the nodes.

    Args:
        motion: The motion, without its dwells.
    """

    def smooth(part: Motion) -> bool:
        return part.system.motion_limits.continuous

    parts = motion.segments
    nodes = [end for end in (0, -1) if smooth(parts[end])]
    if motion.changes.controls > motion.changes.N:
        for part, after, segment in zip(
            parts[:-1], parts[1:], motion.system.problem.segments[:-1], strict=True
        ):
            if segment.dwell > 0.0 and (smooth(part) or smooth(after)):
                nodes.append(part.span[1])
    return nodes
