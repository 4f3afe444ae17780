"""Motions and their problems one after another, as one of several segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.motion.samples import subdivided
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.segments import Segment, segments_of

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem

# Spacing of the nodes of a motion of degree 5 that is joined to others of lower degree
# [s].
FINE = 0.01
# Shorter dwells would be lost in the rounding of times [s].
SHORTEST = 1e-8


def in_sequence(
    problem: Problem, parts: Sequence[Problem], dwells: Sequence[float]
) -> Problem:
    """The problem that is solved by the motions of several problems, when joined.

    Args:
        problem: A problem with the robot without the payloads of the parts, and with
            all values that the parts have in common.
        parts: The problems, each of which begins at rest where the previous one ends.
        dwells: Dwell times at the end of each part [s].
    """
    segments, own = list[Segment](), len(problem.robot.payloads)
    for part, dwell in zip(parts, dwells, strict=True):
        load = next(iter(part.robot.payloads[own:]), None)
        segments += part.segments or [Segment(part.goal, payload=load)]
        segments[-1] = replace(segments[-1], stop=True, dwell=dwell)
    return problem._altered(
        _phases=(tuple(phase for part in parts for phase in part.phases), []),
        segments=tuple(segments),
        q_start=parts[0].q_start,
        goal=segments[-1].goal,
    )


def joined(motions: Sequence[Trajectory], dwells: Sequence[float]) -> Trajectory:
    """Join motions, each of which begins at rest where the previous one ends.

    Args:
        motions: The motions.
        dwells: Dwell times at the start, and at the end of each motion [s].

    Returns:
        One motion; its segments are the motions, each with the dwell at its end.
    """
    pieces = [[p.trajectory for p in segments_of(motion, ())] for motion in motions]
    parts = [part for row in pieces for part in row]
    mixed = len({part.degree for part in parts}) > 1
    alike = [[_cubic(part) if mixed else part for part in row] for row in pieces]
    runs, last = _dwell(alike[0][0], 0, dwells[0]), list[int]()
    for row, dwell in zip(alike, dwells[1:], strict=True):
        last += range(len(runs), len(runs) + len(row))
        runs += [*row, *_dwell(row[-1], -1, dwell)]
        last[-1] = len(runs) - 1

    def whole(rows: Sequence[Array]) -> Array:
        """Concatenate the rows of all runs; shared nodes come from the later run."""
        inner = zip(rows[:-1], runs[:-1], strict=True)
        return np.concatenate([*(r[: run.t.size - 1] for r, run in inner), rows[-1]])

    ends = np.cumsum([run.duration for run in runs])
    begins = np.append(0.0, ends[:-1])
    arrays: dict[str, Any] = {
        name: whole([getattr(run, name) for run in runs])
        for name in ("q", "v", "u", "a")
        if getattr(runs[0], name) is not None
    }
    dynamics = [p.inverse_dynamics for p in parts if p.inverse_dynamics is not None]
    known = len(dynamics) == len(parts)
    return Trajectory(
        parts[0].joint_names,
        whole([begin + run.t for begin, run in zip(begins, runs, strict=True)]),
        **arrays,
        inverse_dynamics=dynamics[0] if known else None,
        holding=None if known else parts[-1].inverse_dynamics or parts[-1].holding,
        segment_ends=ends[last],
        segment_dynamics=tuple(dynamics) if known else (),
    )


def _dwell(part: Trajectory, row: int, seconds: float) -> list[Trajectory]:
    """The dwell at the first or last node of a motion; empty if it is too short."""
    if seconds <= SHORTEST:
        return []
    q, dynamics = part.q[[row, row]], part.inverse_dynamics or part.holding
    rest = np.zeros_like(q)
    u = part.u[[row, row]] if dynamics is None else dynamics(q, rest, rest)
    # Accelerations have a row for each node, or for each interval.
    a = None if part.a is None else rest[: 2 if part.degree == 5 else 1]
    t = np.array([0.0, seconds])
    return [Trajectory(part.joint_names, t, q, rest, u, a=a)]


def _cubic(part: Trajectory) -> Trajectory:
    """A motion as a cubic spline of positions and velocities: exact up to degree 3."""
    if part.degree < 5:
        return replace(part, a=None)
    t = subdivided(part.t, FINE)
    q, v, _, u = part(t)
    return replace(part, t=t, q=q, v=v, u=u, a=None)
