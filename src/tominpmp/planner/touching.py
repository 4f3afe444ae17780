"""Whether links of a robot alone in its scene touch in a motion, seen in passing."""

from __future__ import annotations

import numpy as np

from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem import Problem

# Instants that are looked at, the ends left out: those are the problem's.
SAMPLES = 24


def links_touch(problem: Problem, motion: Trajectory) -> bool:
    """Whether links overlap at one of some instants of a motion.

    True is certain, and False is not: they may touch between the instants. It takes a
    hundredth of the time of a replay, and no mesh is cut into pieces for it whose hull
    touches nothing.

    Args:
        problem: The problem, of an arm with nothing around it.
        motion: The motion.
    """
    checker = problem.checker
    times = np.linspace(0.0, motion.duration, SAMPLES + 2)[1:-1]
    every = motion(times).q
    if not checker.lone:
        return any(not checker.is_free(q, problem.margins) for q in every)
    cut: frozenset[str] = frozenset()
    for q in every:
        part = checker.with_cut(cut)
        if part.is_free(q):
            continue
        near = np.flatnonzero(part.distances(q[None], 0.0)[0] <= 0.0)
        cut |= {name for pair in near for name in part.pairs[pair]}
        if not checker.with_cut(cut).is_free(q):
            return True
    return False
