"""Nearest pair along a motion: where it comes nearest to what it must not touch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.collision import CollisionChecker, Contact
from tominpmp.collision.selection import links_touching
from tominpmp.problem import Problem
from tominpmp.stopping import Stop, check
from tominpmp.verification.closest_approach import Approach
from tominpmp.verification.limit_violations import LimitViolation
from tominpmp.verification.replay import Replay

# Where a start or a goal touches something, pairs may lack a trace of room as long as
# no joint is farther from there than this [rad or m].
NEAR_END = 0.05
# Rows of a replay, at most, at which links are looked at that nobody watches.
GLANCES = 1000


class Touch(NamedTuple):
    """Links that touch although the SRDF says that they never do.

    Attributes:
        link: Name of a link.
        other: Name of the other one.
        time: When their meshes were first found to overlap [s].
    """

    link: str
    other: str
    time: float

    def __str__(self) -> str:
        """Both of them and the time, in a sentence."""
        return (
            f"Links {self.link!r} and {self.other!r} touch at {self.time:.3f} s: they "
            "are not watched, as the SRDF disables their pair."
        )


def closest(
    problem: Problem, replay: Replay, checker: CollisionChecker, tolerance: float
) -> tuple[LimitViolation, Contact] | None:
    """The pair that has the least room beyond its margin on a motion.

    No pair may lack any room at any time, between the rows of the replay neither; but
    where the start or the goal of the problem is itself at the margin, a trace of it
    around there.

    Args:
        problem: The problem, with the margin.
        replay: The motion.
        checker: Distances of the pairs.
        tolerance: What may be missing there [m].

    Returns:
        What the pair lacks, and the pair; None without pairs.
    """
    check()
    # Links of a lone robot are taken as one hull each, which are never farther apart
    # than the links as pieces, and only those that come nearest are cut into pieces.
    # There are a tenth of the pairs then, and most meshes need not be cut, which takes
    # a second each when it is done for the first time.
    part = checker.with_cut(frozenset()) if checker.single_arm else checker
    if not part.pairs:
        return None
    bound = None
    while True:
        try:
            margins = part.margins(problem.margin)
            allowed = _touching(problem, part, margins, tolerance)
            found = Approach(part, replay, margins, allowed, NEAR_END).run()
        except Stop:
            # No time to cut meshes: a bound of what is there is better than nothing.
            if bound is None:
                raise
            found = bound
            break
        names, cut = frozenset(part.pairs[found.pair]), part.cut or frozenset()
        if not checker.single_arm or names <= cut:
            break
        bound = bound if found.violated or found.doubt > 0.0 else found
        part = checker.with_cut(cut | names)
    pair = found.nearest()
    lack, violated = -found.room, found.violated or found.doubt > 0.0
    if violated and not found.violated:
        lack = max(lack, found.doubt)
    row = " and ".join(pair[:2]), found.time, lack, "m", lack, violated
    return LimitViolation("clearance", *row), pair


def _touching(
    problem: Problem, checker: CollisionChecker, margins: Array, tolerance: float
) -> Array:
    """What pairs may lack around ends that are at the margin, shape (2, pairs) [m]."""
    ends = [problem.q_start]
    if problem.goal.configuration is not None:
        ends.append(problem.goal.configuration)
    room = checker.distances(np.array(ends), margins + tolerance) - margins
    allowed = np.zeros((2, margins.size))
    allowed[: len(ends)] = np.where(room < tolerance, tolerance, 0.0)
    # Where what moves will be when the motion ends is not known to the problem.
    allowed[1, checker.moving_pairs] = 0.0
    return allowed


def never_touching(problem: Problem, replay: Replay) -> tuple[Touch, ...]:
    """Links that touch although the SRDF says that they never do.

    An SRDF is obeyed: pairs that it disables are not watched. But the reason "Never"
    tells of samples that somebody took once, and a file without reasons says nothing;
    this says which links touch, by their meshes at some rows of a replay. Pairs with
    other reasons, such as "Adjacent" or "Default", are left out, and so are links that
    one joint moves against each other, and those that the problem lets touch.
    """
    srdf = problem.robot.srdf
    if srdf is None or problem.self_collision is False:
        return ()
    pairs = {frozenset(pair): pair for pair in srdf.never_touch}
    looked_at = pairs.keys() - set(map(frozenset, problem.may_touch))
    if not looked_at:
        return ()
    step = 1 + replay.t.size // GLANCES
    q, t = replay.q[::step], replay.t[::step]
    found = links_touching(problem.robot, looked_at, q)
    return tuple(Touch(*pairs[names], float(t[row])) for names, row in found.items())
