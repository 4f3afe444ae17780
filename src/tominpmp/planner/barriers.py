"""Barriers: joints that cannot pass whatever the others do, so that no motion exists.

The distance of some pairs depends on one joint alone: that of the first link of an arm
to an obstacle, or to its base. A joint passes all positions between those at the start
and at the goal (intermediate value theorem), so a pair of that kind that overlaps at
one of them is a proof, which the failure of any number of starts is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.collision.checker import Contact
from tominpmp.kinematics import prismatic_joints
from tominpmp.problem.problem import Problem

# Positions of a joint that are looked at between start and goal.
PLACES = 128
# Lack of clearance of a barrier beyond the lack that motions are forgiven [m].
DEEP = 1e-4


@dataclass(frozen=True)
class Barrier:
    """A pair of bodies that a joint cannot pass.

    Attributes:
        joint: Name of the joint.
        position: Where the pair lacks most room [rad or m].
        unit: Unit of the position.
        contact: The pair, and how near its bodies are there.
        segment: Number of the segment, from 1; None if there is one alone.
    """

    joint: str
    position: float
    unit: str
    contact: Contact
    segment: int | None = None

    def __str__(self) -> str:
        """A sentence."""
        where = "" if self.segment is None else f" on segment {self.segment}"
        return (
            f"No motion exists: joint {self.joint!r} has to pass {self.position:.4g} "
            f"{self.unit}{where}, where {self.contact.pair} lack "
            f"{self.contact.lack:.3g} m of room whatever the other joints do."
        )


def find_barrier(problem: Problem, forgiven: float) -> Barrier | None:
    """Look for a barrier to all motions; None if there is no proof of one.

    Every way to meet the goal must be barred. Goals on a frame, and obstacles that
    move, prove nothing.

    Args:
        problem: The problem.
        forgiven: Lack of clearance that a motion is forgiven [m].
    """
    found = [_barred(part, forgiven) for part in problem.alternatives]
    return found[0] if all(found) else None


def _barred(problem: Problem, forgiven: float) -> Barrier | None:
    """The barrier for one way to meet the goal, of the first segment that has one."""
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
    """The barrier between two configurations, if there is one."""
    checker, robot = problem.checker, problem.robot
    joint = checker.lone_joints
    pairs = np.flatnonzero((joint >= 0) & (begin != end)[joint])
    if not pairs.size:
        return None
    q = np.linspace(begin, end, PLACES)
    instants = np.repeat(np.arange(PLACES), pairs.size)
    every = np.tile(pairs, PLACES)
    margins = problem.margins
    distances = checker.measured(q, instants, every, margins[every])
    worst = int(np.argmin(distances - margins[every]))
    pair = int(every[worst])
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
