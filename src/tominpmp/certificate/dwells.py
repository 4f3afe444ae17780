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
from tominpmp.problem.segments import segments_of, spans_of
from tominpmp.problem.sequence import joined

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
    # Each segment is split at the node where its dwell begins, and the dwells are left
    # out.
    split = np.ravel([arrivals, ends], order="F") - SAME * motion.duration
    nodes = motion.t[np.searchsorted(motion.t, split)]
    dwells = nodes[1::2] - nodes[::2]
    if motion.segment_ends is None or not any(dwells):
        return problem, motion
    dynamics = tuple(item for item in motion.segment_dynamics for _ in range(2))
    halves = replace(motion, segment_ends=nodes, segment_dynamics=dynamics)
    parts = [item.trajectory for item in segments_of(halves, ())[::2]]
    moving = joined(parts, [0.0] * (len(parts) + 1))
    if moving.duration and (reason := no_certificate(problem)):
        raise ProblemError(
            "segments: the motion dwells while obstacles move, expected no dwell: "
            f"{reason}",
            "segments",
        )
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
