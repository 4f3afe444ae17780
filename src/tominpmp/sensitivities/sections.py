"""Multipliers of a motion of several segments, sorted by the segments.

The program of its small changes is one, with the duration of each segment by itself.
What each limit is worth is read segment by segment, since robot, load, limits and
obstacles are those of the segment, and added: the same motor costs on all of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import BoolArray, IntArray
from tominpmp.certificate.active_limits import Motion
from tominpmp.certificate.dual_solution import DualSolution
from tominpmp.certificate.multipliers import GOAL, Multipliers


class Section(NamedTuple):
    """A segment of a motion with its multipliers.

    Attributes:
        motion: The motion, with the task of the segment.
        found: The multipliers of what holds on it.
        number: Which it is, from 1; None where there is one only.
    """

    motion: Motion
    found: DualSolution
    number: int | None


@dataclass
class _Counts:
    """Subjects of segments before, which are counted through."""

    pairs: int = 0
    constraints: int = 0
    goals: int = 0


def sections(motion: Motion, found: DualSolution) -> Iterator[Section]:
    """The segments of a motion, each with what holds on it."""
    if not motion.sections:
        yield Section(motion, found, None)
        return
    before = _Counts()
    for number, part in enumerate(motion.sections, 1):
        yield Section(part, _own(part, found, before), number)
        task = part.task
        before.pairs += len(task.problem.checker.pairs)
        before.constraints += len(task.problem.constraints)
        before.goals += task.problem.goal.bounds(task.kinematics)[0].size


def _own(part: Motion, found: DualSolution, before: _Counts) -> DualSolution:
    """The multipliers of a segment, with subjects as in its own problem."""
    names = {item.name for item in part.task.problem.constraints}

    def start(kind: str) -> int:
        if kind == "clearance":
            return before.pairs
        if kind == GOAL:
            return before.goals
        return before.constraints if kind in names else 0

    rows = []
    for item, y in found.rows:
        mine = np.flatnonzero(_within(part, item.interval))
        if mine.size:
            kept = item.kept(mine)
            kept = replace(kept, subject=kept.subject - start(item.kind))
            rows.append((kept, y[mine]))
    given = found.multipliers
    mine = np.flatnonzero(_within(part, given.interval))
    offset = np.array([start(kind) for kind in given.kinds], dtype=np.int64)
    subject = given.subject - offset[given.code]
    multipliers = Multipliers(
        given.kinds,
        given.code[mine],
        given.interval[mine],
        subject[mine],
        given.value[mine],
        given.upper[mine],
        given.room[mine],
    )
    return replace(found, rows=tuple(rows), multipliers=multipliers)


def _within(part: Motion, interval: IntArray) -> BoolArray:
    first, end = part.span
    return np.asarray((interval >= first) & (interval < end))
