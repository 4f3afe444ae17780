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

from tominpmp.certificate.motion import GridMotion
from tominpmp.exceptions import ProblemError
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import spans_of

# Tolerance between a node and a time, as a share of the duration.
SAME = 1e-9


def no_certificate(problem: Problem) -> str:
    """Why the motions of a problem have no certificate; empty if they have one."""
    dwells = any(segment.dwell for segment in problem.segments)
    if dwells and any(phase.scene.moving for phase in problem.phases):
        return "there is no certificate for dwells among moving obstacles"
    return ""


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
        ProblemError: If the motion has a dwell and moves before or after it, and
            obstacles move.
    """
    _, arrivals, ends = np.array(spans_of(motion, problem.segments)).T
    dwells = ends - arrivals
    if motion.segment_ends is None or not any(dwells):
        return problem, motion
    slack = SAME * motion.duration
    times = motion.t[:, None]
    dwelling = (times > arrivals + slack) & (times <= ends + slack)
    keep = ~np.any(dwelling, axis=1)
    t = motion.t - (times >= ends - slack) @ dwells
    shifted = ends - np.cumsum(dwells)
    dwelt = np.stack([arrivals, ends])[:, dwells > 0.0] - slack
    last, after = np.searchsorted(motion.t, dwelt)
    u, a = np.array(motion.u), motion.a
    u[last] = motion.u[after]
    if a is not None:
        # The interval before a node that is left out goes with it.
        a = a[keep] if len(a) == t.size else a[keep[1:]]
    t = t[keep]
    if t[-1] and (reason := no_certificate(problem)):
        raise ProblemError(
            "segments: the motion dwells while obstacles move, expected no dwell: "
            f"{reason}",
            "segments",
        )
    ends = t[np.argmin(np.abs(t[:, None] - shifted), axis=0)]
    q, v, u = motion.q[keep], motion.v[keep], u[keep]
    moving = replace(motion, t=t, q=q, v=v, u=u, a=a, segment_ends=ends)
    return with_dwells(problem, dwells.tolist()), moving


def rest_nodes(motion: GridMotion) -> list[int]:
    """Nodes at which accelerations that must not jump are zero.

    They are both ends of the motion, and the nodes of dwells. If accelerations belong
    to nodes, their indices are the indices of the nodes.

    Args:
        motion: The motion, without its dwells.
    """
    parts = motion.segments
    smooth = [part.system.motion_limits.continuous for part in parts]
    nodes = [end for end in (0, -1) if smooth[end]]
    if motion.changes.controls > motion.changes.N:
        for k, segment in enumerate(motion.system.problem.segments[:-1]):
            if segment.dwell > 0.0 and any(smooth[k : k + 2]):
                nodes.append(parts[k].span[1])
    return nodes
