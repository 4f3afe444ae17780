"""Nearest pair of a motion, and links that touch without being checked."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.collision.checker import CollisionChecker, Contact
from tominpmp.collision.selection import links_touching
from tominpmp.stopping import Stop, check
from tominpmp.verification.closest_approach import Approach
from tominpmp.verification.limit_violations import LimitViolation
from tominpmp.verification.replay import Replay

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem

# Near a start or a goal at the margin a trace of violation is tolerated, while no joint
# is farther from there than this [rad or m].
NEAR_END = 0.05
# Largest number of rows of a replay at which links that are not checked are compared.
GLANCES = 250


class Touch(NamedTuple):
    """Links that touch although the SRDF says that they never do.

    Attributes:
        link: Name of a link.
        other: Name of the other one.
        time: First time at which their meshes were found to overlap [s].
    """

    link: str
    other: str
    time: float

    def __str__(self) -> str:
        """Both links and the time, in a sentence."""
        return (
            f"Links {self.link!r} and {self.other!r} touch at {self.time:.3f} s: they "
            "are not watched, as the SRDF disables their pair."
        )


def closest(
    problem: Problem, replay: Replay, checker: CollisionChecker, tolerance: float
) -> tuple[LimitViolation, Contact] | None:
    """The pair with the least clearance beyond its margin along a motion.

    All pairs are to keep their margins at all times, between the rows of the replay,
    too. Only around a start or a goal that is itself at the margin a trace of violation
    is tolerated.

    Args:
        problem: The problem, with the margin.
        replay: The motion.
        checker: Distances of the pairs.
        tolerance: Tolerated violation there [m].

    Returns:
        The missing clearance, and the pair; None without pairs.
    """
    check()
    # Links of a single robot are represented by one hull each, whose distances are not
    # larger than those of the pieces, and only the nearest links are cut into pieces:
    # this gives a tenth of the pairs, and most meshes need not be cut, which takes a
    # second for each mesh, once.
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
            # Without the time to cut meshes, a bound is better than no distance.
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
    """Tolerated violations around start and goal, shape (2, pairs) [m]."""
    ends = [problem.q_start]
    if problem.goal.configuration is not None:
        ends.append(problem.goal.configuration)
    room = checker.distances(np.array(ends), margins + tolerance) - margins
    allowed = np.zeros((2, margins.size))
    allowed[: len(ends)] = np.where(room < tolerance, tolerance, 0.0)
    # The places of moving obstacles at the end of the motion are not known.
    allowed[1, checker.moving_pairs] = 0.0
    return allowed


def never_touching(problem: Problem, replay: Replay) -> tuple[Touch, ...]:
    """Links that touch although the SRDF says that they never do.

    Pairs that an SRDF disables are not checked. But the reason "Never" comes from
    random samples, and a file may give no reasons. These pairs are compared by their
    meshes at some rows of a replay. Pairs with other reasons ("Adjacent", "Default"),
    pairs of links that one joint moves against each other, and pairs that may touch by
    the problem are left out.
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
