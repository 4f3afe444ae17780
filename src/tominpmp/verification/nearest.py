"""Nearest collision pair of a motion, and contacts of pairs that are not checked."""

from __future__ import annotations

from itertools import compress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.collision.checker import CollisionChecker, Contact
from tominpmp.collision.selection import links_touching
from tominpmp.stopping import Stop, check
from tominpmp.verification.closest_approach import ROWS, ClosestApproach
from tominpmp.verification.limit_violations import LimitViolation
from tominpmp.verification.replay import Replay

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem

# Largest number of rows of a replay at which pairs that are not checked are tested.
TESTED_ROWS = 250


class Touch(NamedTuple):
    """Links that touch although the SRDF says that they never do.

    Attributes:
        link: Name of a link.
        other: Name of the other link.
        time: First time at which their meshes were found to overlap [s].
    """

    link: str
    other: str
    time: float

    def __str__(self) -> str:
        """Both links and the time, in a sentence."""
        return (
            f"Links {self.link!r} and {self.other!r} touch at {self.time:.3f} s: they "
            "are not checked, as the SRDF disables their pair."
        )


def nearest_pair(
    problem: Problem, replay: Replay, checker: CollisionChecker, tolerance: float
) -> tuple[LimitViolation, Contact] | None:
    """The pair with the least clearance beyond its margin along a motion.

    All pairs have to keep their margins at all times, also between the rows of the
    replay. A small violation is tolerated only near a start or a goal that is itself at
    the margin.

    Args:
        problem: The problem, with the margin.
        replay: The motion.
        checker: Collision checker with the pairs.
        tolerance: Tolerated violation near the start and the goal [m].

    Returns:
        The violation of the margin, negative for clearance, and the pair; None without
        pairs.

    Raises:
        Stop: If the time is used up before a bound of the clearance is known.
    """
    check()
    # Each link of a single robot is represented by one convex hull, whose distances are
    # lower bounds of the distances of its convex pieces. Only links whose hulls overlap
    # at some rows, and the nearest links, are decomposed: this leaves a tenth of the
    # pairs, and most meshes need no decomposition, which takes a second for each mesh,
    # once.
    single, cut = checker.single_arm, frozenset[str]()
    coarse = checker.with_cut(cut) if single else checker
    if not coarse.pairs:
        return None
    if single:
        overlap = np.any(coarse.distances(replay.q[::ROWS], 0.0) < 0.0, axis=0)
        cut = cut.union(*compress(coarse.pairs, overlap))
    # For a goal that is not a configuration, this is the final one of the motion.
    goal = problem.goal.configuration
    ends = np.array([problem.q_start, replay.q[-1] if goal is None else goal])
    bound, searched, refine = None, 0, True
    while True:
        try:
            coarse = checker.with_cut(cut) if single else checker
            if len(coarse.pairs) == searched:
                break  # the nearest links are decomposed, or convex
            searched, margins = len(coarse.pairs), coarse.margins(problem.margin)
            allowed = _tolerated(ends, coarse, margins, tolerance)
            search = ClosestApproach(coarse, replay, margins, allowed).run()
        except Stop:
            # Without the time to decompose meshes, a bound is better than no distance.
            if bound is None:
                raise
            search, refine = bound, False
            break
        cut = cut.union(coarse.pairs[search.pair])
        bound = bound if search.violated or search.possible_violation > 0.0 else search
    pair, lack = search.nearest(refine=refine), -search.clearance
    violated = search.violated or search.possible_violation > 0.0
    if violated and not search.violated:
        lack = max(lack, search.possible_violation)
    row = " and ".join(pair[:2]), search.time, lack, "m", lack, violated
    return LimitViolation("clearance", *row), pair


def _tolerated(
    ends: Array, checker: CollisionChecker, margins: Array, tolerance: float
) -> Array:
    """Tolerated violations near the start and the goal, shape (2, pairs) [m]."""
    room = checker.distances(ends, margins + tolerance) - margins
    allowed = np.where(room < tolerance, tolerance, 0.0)
    # The arrival time and with it the placements of moving obstacles are not known.
    allowed[1, checker.moving_pairs] = 0.0
    return allowed


def never_touching(problem: Problem, replay: Replay) -> tuple[Touch, ...]:
    """Links that touch although the SRDF says that they never do.

    Pairs that an SRDF disables are not checked. But the reason "Never" comes from
    random samples, and a file may give no reasons: these pairs are tested with their
    meshes at some rows of a replay. Pairs with other reasons ("Adjacent", "Default"),
    pairs of links that are connected by a joint, and pairs that the problem allows to
    touch are left out.
    """
    srdf = problem.robot.srdf
    if srdf is None or problem.self_collision is False:
        return ()
    pairs = {frozenset(pair): pair for pair in srdf.never_touch}
    unchecked = pairs.keys() - set(map(frozenset, problem.may_touch))
    if not unchecked:
        return ()
    step = 1 + replay.t.size // TESTED_ROWS
    q, t = replay.q[::step], replay.t[::step]
    contacts = links_touching(problem.robot, unchecked, q)
    return tuple(Touch(*pairs[names], float(t[row])) for names, row in contacts.items())
