"""Barriers: positions that a joint would have to pass in collision.

The distance of some collision pairs depends on a single joint: for example the distance
of the first link of an arm from an obstacle, or from its base. A joint passes all
positions between its start and its goal (intermediate value theorem). If such a pair
overlaps at one of these positions, no motion exists. This is a proof, in contrast to
the failure of any number of starts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.collision.checker import Contact
from tominpmp.kinematics import prismatic_joints
from tominpmp.problem.problem import Problem

# Positions of a joint that are checked between start and goal.
PLACES = 128
# A barrier lacks at least this much more clearance than is tolerated in motions [m].
DEEP = 1e-4


@dataclass(frozen=True)
class Barrier:
    """A collision pair that blocks the path of a joint.

    Attributes:
        joint: Name of the joint.
        position: Position of the joint with the least clearance [rad or m].
        unit: Unit of the position.
        contact: The collision pair, with its distance at this position.
        segment: Number of the segment, from 1; None if the problem has a single one.
    """

    joint: str
    position: float
    unit: str
    contact: Contact
    segment: int | None = None

    def __str__(self) -> str:
        """A sentence for the user."""
        where = "" if self.segment is None else f" on segment {self.segment}"
        return (
            f"No motion exists: joint {self.joint!r} has to pass {self.position:.4g} "
            f"{self.unit}{where}, where {self.contact.pair} lack "
            f"{self.contact.lack:.3g} m of room whatever the other joints do."
        )


def find_barrier(problem: Problem, forgiven: float) -> Barrier | None:
    """Look for a barrier that blocks all motions; None if no barrier is proved.

    Every alternative of the goal must be blocked. With goals on a frame, or with moving
    obstacles, nothing can be proved.

    Args:
        problem: The problem.
        forgiven: Lack of clearance that is tolerated in a motion [m].
    """
    barriers = [_barred(part, forgiven) for part in problem.alternatives]
    return barriers[0] if all(barriers) else None


def _barred(problem: Problem, forgiven: float) -> Barrier | None:
    """The barrier for one alternative of the goal, on its first blocked segment."""
    begin: Array | None = problem.q_start
    many = len(problem.phases) > 1
    for number, phase in enumerate(problem.phases):
        end = phase.goal.configuration
        if begin is not None and end is not None and len(phase.scene):
            segment = number + 1 if many else None
            barrier = _between(phase, begin, end, forgiven, segment)
            if barrier is not None:
                return barrier
        begin = end
    return None


def _between(
    problem: Problem, begin: Array, end: Array, forgiven: float, segment: int | None
) -> Barrier | None:
    """The barrier between two configurations; None if there is none."""
    checker, robot = problem.checker, problem.robot
    joint = checker.single_joints
    pairs = np.flatnonzero((joint >= 0) & (begin != end)[joint])
    if not pairs.size:
        return None
    q = np.linspace(begin, end, PLACES)
    instants = np.repeat(np.arange(PLACES), pairs.size)
    each = np.tile(pairs, PLACES)
    margins = problem.margins
    distances = checker.measured(q, instants, each, margins[each])
    worst = int(np.argmin(distances - margins[each]))
    pair = int(each[worst])
    contact = checker.contact(pair, float(distances[worst]), float(margins[pair]))
    if contact.lack <= forgiven + DEEP:
        return None
    j = int(joint[pair])
    return Barrier(
        robot.joint_names[j],
        float(q[instants[worst], j]),
        "m" if prismatic_joints(robot)[j] else "rad",
        contact,
        segment,
    )
