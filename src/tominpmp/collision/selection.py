"""Selection of the collision pairs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from tominpmp.arrays import Array
from tominpmp.collision.bodies import Geometry, part_bodies, part_link
from tominpmp.collision.broad import Pairs
from tominpmp.collision.narrow import NarrowPhase
from tominpmp.collision.query import PairDistances
from tominpmp.collision.shapes import Body
from tominpmp.description.model import are_neighbours

if TYPE_CHECKING:
    from tominpmp.robot.robot import Robot

T = TypeVar("T")

# Links that overlap at this share of random configurations overlap by design.
ALWAYS = 0.95
# Convex pieces that overlap at this share of configurations, while the meshes never
# do, are too coarse for the distance of the links.
MOSTLY = 0.5
SAMPLES = 100
# Faces of joined links that slide on each other have distances up to this, or overlap,
# depending on rounding; a margin between them can neither be kept nor proved [m].
FLUSH = 1e-5
# Configurations at which the meshes of two links with overlapping hulls are compared.
TRIES = 50
# Range in which a joint without limits is sampled [rad or m].
UNLIMITED = np.pi


def scene_pairs(bodies: Sequence[Body], links: int) -> Pairs:
    """Pair each of the first bodies, if it moves, with each of the rest."""
    moving = [i for i in range(links) if bodies[i].joint]
    return _indices([(i, k) for k in range(links, len(bodies)) for i in moving])


def links_of(
    robot: Robot, geometry: Geometry, cut: frozenset[str] | None = None
) -> tuple[Body, ...]:
    """Shapes of all links, shared by all checkers of a robot.

    ``cut`` has the names of the links whose meshes are represented by ``geometry``,
    while others are one hull each; None stands for all links.
    """
    found: list[Body] = []
    for part in range(len(robot.collision_model.geometryObjects)):
        whole = cut is not None and part_link(robot, part) not in cut
        taken_as: Geometry = "hull" if whole else geometry
        found += _once(robot, part_bodies, part, taken_as)
    return tuple(found)


def own_pairs(
    robot: Robot, geometry: Geometry, cut: frozenset[str] | None = None
) -> Pairs:
    """Pair the links of a robot with each other, and with bodies fixed to its base.

    Left out are the pairs that the semantic description disables (if it disables any),
    else neighbours; links that overlap at nearly all configurations; and links whose
    convex pieces overlap at most configurations while their meshes never do. The
    selection does not depend on the cut links, see :func:`links_of`. The first bodies
    of the pairs move.
    """
    return _once(robot, _own_pairs, geometry, cut)


def _own_pairs(robot: Robot, geometry: Geometry, cut: frozenset[str] | None) -> Pairs:
    left_out = _once(robot, _inseparable, geometry)
    bodies = links_of(robot, geometry, cut)
    return without(left_out, bodies, _candidates(robot, bodies))


def links_touching(
    robot: Robot, wanted: Collection[frozenset[str]], q: Array
) -> dict[frozenset[str], int]:
    """Links that touch at given configurations, whether or not their pair is checked.

    Links are first taken as one hull each, and where hulls overlap as meshes, at a few
    of the configurations: links that touch at one or two others may be missed.

    Args:
        robot: The robot.
        wanted: Names of the links of each pair.
        q: Configurations, shape (m, n) [rad or m].

    Returns:
        Index of the first configuration at which their meshes were found to overlap,
        by names.
    """
    rows, bodies = robot.expand(q), links_of(robot, "hull")
    pairs = _named(bodies, wanted)
    overlap = PairDistances(robot, watched=(bodies, pairs)).distances(q, 0.0) < 0.0
    meshes, found = links_of(robot, "mesh"), {}
    for names, columns in _columns(bodies, pairs).items():
        instants = np.flatnonzero(np.any(overlap[:, columns], axis=1))
        if not instants.size:
            continue
        exact = NarrowPhase(robot.model, meshes, _named(meshes, {names}))
        for instant in instants[:: 1 + instants.size // TRIES].tolist():
            if any(exact.overlaps(rows[instant])):
                found[names] = instant
                break
    return found


def _once(robot: Robot, make: Callable[..., T], *given: Hashable) -> T:
    """What a function makes of a robot and more arguments, kept with the robot.

    Hashing meshes and checking configurations takes longer than a plan in free space.
    """
    known: dict[object, T] = robot.__dict__.setdefault("_collision", {})
    key = make, *given
    if key not in known:
        known[key] = make(robot, *given)
    return known[key]


def _candidates(robot: Robot, bodies: Sequence[Body]) -> Pairs:
    """All pairs of links without the pairs that may touch by the robot's files."""
    disabled = set() if robot.srdf is None else set(robot.srdf.disabled_pairs)
    carriers = {body.joint for body in bodies}

    def watched(one: Body, other: Body) -> bool:
        if disabled:
            names = min(one.name, other.name), max(one.name, other.name)
            return names not in disabled
        return not are_neighbours(robot.model, one.joint, other.joint, carriers)

    return _moving_pairs(bodies, watched)


def _inseparable(robot: Robot, geometry: Geometry) -> frozenset[frozenset[str]]:
    """Names of links whose shapes always overlap, or are too coarse.

    Shapes are within their hulls, so that pairs whose hulls seldom overlap need no
    pieces: cutting a mesh into pieces takes a second.
    """
    share = _shares(robot, links_of(robot, "hull"), None)
    often = {names for names, value in share.items() if value > MOSTLY}
    if often and geometry != "hull":
        cut = frozenset(name for names in often for name in names)
        share = _shares(robot, links_of(robot, geometry, cut), often)
    left_out = {names for names, value in share.items() if value > ALWAYS}
    doubtful = {names for names, value in share.items() if MOSTLY < value <= ALWAYS}
    if doubtful:
        exact = _shares(robot, links_of(robot, "mesh"), doubtful)
        left_out |= {
            names for names in doubtful if not 0.0 < exact.get(names, 0.0) <= ALWAYS
        }
    return frozenset(left_out)


def _shares(
    robot: Robot, bodies: Sequence[Body], wanted: set[frozenset[str]] | None
) -> dict[frozenset[str], float]:
    """Share of random configurations at which links overlap, by their names."""
    watched = wanted is None
    pairs = _candidates(robot, bodies) if watched else _named(bodies, wanted or ())
    if not pairs.size:
        return {}
    narrow = NarrowPhase(robot.model, bodies, pairs)
    overlaps = np.array([narrow.overlaps(row, FLUSH) for row in _configurations(robot)])
    return {
        name: float(np.mean(np.any(overlaps[:, chosen], axis=1)))
        for name, chosen in _columns(bodies, pairs).items()
    }


def _named(bodies: Sequence[Body], wanted: Collection[frozenset[str]]) -> Pairs:
    """Pairs of bodies with certain names that move against each other."""
    return _moving_pairs(
        bodies, lambda one, other: frozenset((one.name, other.name)) in wanted
    )


def _moving_pairs(
    bodies: Sequence[Body], watched: Callable[[Body, Body], bool]
) -> Pairs:
    """Pairs of bodies that move against each other and pass a filter.

    The first bodies of the pairs move.
    """
    return _indices(
        [
            (i, k) if one.joint else (k, i)
            for (i, one), (k, other) in combinations(enumerate(bodies), 2)
            if one.joint != other.joint and watched(one, other)
        ]
    )


def _indices(pairs: Sequence[tuple[int, int]]) -> Pairs:
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _columns(bodies: Sequence[Body], pairs: Pairs) -> dict[frozenset[str], list[int]]:
    """Indices of pairs of bodies by the names of their links."""
    columns: dict[frozenset[str], list[int]] = {}
    for index, both in enumerate(pairs.tolist()):
        columns.setdefault(frozenset(bodies[i].name for i in both), []).append(index)
    return columns


def without(
    left_out: frozenset[frozenset[str]], bodies: Sequence[Body], pairs: Pairs
) -> Pairs:
    """The pairs of bodies without the pairs of names that are left out."""
    if not left_out:
        return pairs
    columns = _columns(bodies, pairs)
    dropped = [k for names in left_out for k in columns.get(names, ())]
    return np.delete(pairs, dropped, axis=0)


def _configurations(robot: Robot) -> Array:
    """Random configurations of the model, the same for all checkers."""
    limits, rng = robot.limits, np.random.default_rng(0)
    low = np.clip(limits.position_lower, -UNLIMITED, UNLIMITED)
    high = np.clip(limits.position_upper, -UNLIMITED, UNLIMITED)
    return robot.expand(rng.uniform(low, high, size=(SAMPLES, robot.n)))
