"""Barriers: positions that a joint would have to pass in collision.

The distance of some collision pairs depends on a single joint: for example the distance
of the first link of an arm from an obstacle, or from its base. A joint passes all
positions between its start and its goal (intermediate value theorem). If such a pair
overlaps at one of these positions, no motion exists. This is a proof, in contrast to
the failure of any number of starts.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.goals.turns import TURN
from tominpmp.initial_guess.guess import SAMPLES
from tominpmp.kinematics import units_of
from tominpmp.problem.problem import Problem


def find_barrier(problem: Problem, tolerated: float) -> str:
    """A barrier that blocks all motions, in a sentence; empty if none is proved.

    Every alternative of the goal must be blocked, and for joints that are angles the
    ways in both directions. With goals on a frame, or with moving obstacles, nothing
    can be proved.

    Args:
        problem: The problem.
        tolerated: Missing clearance that a motion may have [m].
    """
    parts = problem.alternatives
    barriers = [barrier_on_way(part, tolerated, turning=True) for part in parts]
    return barriers[0] if all(barriers) else ""


def barrier_on_way(problem: Problem, tolerated: float, *, turning: bool = False) -> str:
    """The barrier on the first blocked segment, in a sentence; empty without one.

    Args:
        problem: The problem, with one goal.
        tolerated: Missing clearance that a motion may have [m].
        turning: Whether joints that are angles may reach the goal by other turns.
    """
    begin: Array | None = problem.q_start
    many = len(problem.phases) > 1
    for number, phase in enumerate(problem.phases, 1):
        end = phase.goal.configuration
        if begin is not None and end is not None and len(phase.scene):
            where = f" on segment {number}" if many else ""
            ends = _ends(phase, begin, end) if turning else end[None]
            barrier = _between(phase, begin, ends, tolerated, where)
            if barrier:
                return barrier
        begin = end
    return ""


def _ends(problem: Problem, begin: Array, end: Array) -> Array:
    """Configurations at the nearest turns in both directions, shape (2, n).

    A joint that is no angle, or whose turn in a direction is beyond its limits, ends at
    the same position in both. All further turns pass the nearest ones.
    """
    robot = problem.robot
    limits = robot.limits
    up = begin + np.mod(end - begin, TURN)
    ends = np.stack([up, up - TURN])
    inside = (ends >= limits.position_lower) & (ends <= limits.position_upper)
    ends = np.where(inside, ends, ends[::-1])
    return np.where(problem.goal.angles(robot), ends, end)


def _between(
    problem: Problem, begin: Array, ends: Array, tolerated: float, where: str
) -> str:
    """The barrier of the joint with the least slack on all of its ways, in a sentence.

    Empty without a barrier.

    Args:
        problem: The problem of the segment.
        begin: Configuration at its start, shape (n,).
        ends: Configurations at the ends of the ways, shape (k, n).
        tolerated: Missing clearance that a motion may have [m].
        where: The segment, in words; empty if there is only one.
    """
    checker, robot = problem.checker, problem.robot
    joint = checker.single_joints
    pairs = np.flatnonzero((joint >= 0) & np.all(begin != ends, axis=0)[joint])
    if not pairs.size:
        return ""
    q = np.linspace(begin, ends, SAMPLES, axis=1).reshape(-1, robot.n)
    instants = np.repeat(np.arange(len(q)), pairs.size)
    each = np.tile(pairs, len(q))
    margins = problem.margins
    distances = checker.measured(q, instants, each, margins[each])
    slack = (distances - margins[each]).reshape(len(ends), SAMPLES, pairs.size)

    def narrowest(j: int) -> tuple[float, int]:
        """Least slack of a joint on its widest way, and its index in ``slack``."""
        columns = np.flatnonzero(joint[pairs] == j)
        own = slack[:, :, columns]
        way = int(np.argmax(own.min(axis=(1, 2))))
        place, column = np.unravel_index(np.argmin(own[way]), own[way].shape)
        index = np.ravel_multi_index((way, place, columns[column]), slack.shape)
        return float(slack.flat[index]), int(index)

    _, index = min(map(narrowest, np.unique(joint[pairs]).tolist()))
    pair = int(each[index])
    contact = checker.contact(pair, float(distances[index]), float(margins[pair]))
    if contact.lack <= tolerated:
        return ""
    j = int(joint[pair])
    return (
        f"No motion exists: joint {robot.joint_names[j]!r} has to pass "
        f"{q[instants[index], j]:.4g} {units_of(robot)[j]}{where}, where "
        f"{contact.pair} lack {contact.lack:.3g} m of clearance whatever the other "
        "joints do."
    )
