"""Nearest pair along a motion: where it comes nearest to what it must not touch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.collision import CollisionChecker
from tominpmp.collision.selection import links_of, links_touching
from tominpmp.problem import Problem
from tominpmp.stopping import Stop, check
from tominpmp.verification.closest_approach import Approach, Closest, HermitePath
from tominpmp.verification.limit_violations import LimitViolation
from tominpmp.verification.replay import Replay

# Where a start or a goal touches something, pairs may lack a trace of room as long as
# no joint is farther from there than this [rad or m].
NEAR_END = 0.05
# Links are as near as pieces as they are as hulls if this is what differs [m].
RESIDUE = 1e-6
# Rows of a replay, at most, at which links are looked at that nobody watches.
GLANCES = 1000
# Rows of a planned motion, with its nodes: between them it is known.
PLANNED_ROWS = 200


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


class Nearest(NamedTuple):
    """The pair that has the least room beyond its margin.

    Attributes:
        violation: What it lacks.
        distance: Its distance [m].
    """

    violation: LimitViolation
    distance: float


def closest(
    problem: Problem, replay: Replay, checker: CollisionChecker, tolerance: float
) -> Nearest | None:
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
        The pair; None without pairs.
    """
    check()
    if checker.lone:
        if not checker.with_cut(frozenset()).pairs:
            return None
        found = _of_links(problem, replay, checker, tolerance)
        if found is not None:
            return found
    if not checker.pairs:
        return None
    margins = checker.margins(problem.margin)
    allowed = _touching(problem, checker, margins, tolerance)
    nearest = Approach(checker, replay, margins, allowed, NEAR_END).run()
    return _nearest(nearest, checker, margins)


def _of_links(
    problem: Problem, replay: Replay, checker: CollisionChecker, tolerance: float
) -> Nearest | None:
    """The links of a lone robot that come nearest, if they are clear of each other.

    Links are taken as one hull each, which are never farther apart than the links as
    pieces. Only those that come nearest are cut into pieces, until two are found that
    come as near as pieces as all others do as hulls at least. There are a tenth of the
    pairs then, and most meshes need not be cut, which takes a second each when it is
    done for the first time. None where links touch, or it cannot be told.
    """
    cut: frozenset[str] = frozenset()
    clear = None
    while True:
        try:
            part = checker.with_cut(cut)
            margins = part.margins(problem.margin)
            found = Approach(part, replay, margins).run()
            apart = found.room > tolerance and not (found.violated or found.doubt > 0.0)
            clear = _nearest(found, part, margins) if apart else None
            names = frozenset(part.pairs[found.pair])
            if names <= cut or _of_one_piece(part, names):
                return clear
            cut |= names
            q = HermitePath(replay).positions(np.array([found.time]))
            if _apart(checker.with_cut(cut), names, q) <= found.room + RESIDUE:
                return clear
        except Stop:
            # No time to cut meshes: a bound of what is there is better than nothing.
            if clear is None:
                raise
            return clear


def _apart(checker: CollisionChecker, names: frozenset[str], q: Array) -> float:
    """Distance of two links at a configuration, shape (1, n) [m]."""
    pairs = [names == frozenset(pair) for pair in checker.pairs]
    return float(np.min(checker.distances(q)[0, pairs]))


def _of_one_piece(checker: CollisionChecker, names: frozenset[str]) -> bool:
    """Whether cutting these links into pieces would change nothing."""
    hulls = sum(body.name in names for body in checker.links)
    cut = (checker.cut or frozenset()) | names
    pieces = links_of(checker.robot, checker.geometry, cut)
    return sum(body.name in names for body in pieces) == hulls


def _nearest(found: Closest, checker: CollisionChecker, margins: Array) -> Nearest:
    name = " and ".join(checker.pairs[found.pair])
    lack, violated = -found.room, found.violated or found.doubt > 0.0
    if violated and not found.violated:
        lack = max(lack, found.doubt)
    row = name, found.time, lack, "m", lack, violated
    violation = LimitViolation("clearance", *row)
    return Nearest(violation, found.room + float(margins[found.pair]))


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
