"""Selection of the collision pairs of a robot and a scene."""

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

# Links that overlap at more than this share of random configurations do so by design.
ALWAYS = 0.95
# Convex pieces that overlap at more than this share of the configurations, although the
# meshes never do, are too coarse to represent the distance of the links.
MOSTLY = 0.5
# Number of random configurations.
SAMPLES = 100
# Links whose distance is smaller than this count as overlapping [m]: faces of connected
# links that slide on each other may overlap or not, depending on rounding, and a margin
# between them can neither be kept nor proved.
FLUSH = 1e-5
# Approximate number of configurations at which the meshes of two links with overlapping
# hulls are checked.
TRIES = 50
# Largest position at which a joint is sampled, in either direction [rad or m].
UNLIMITED = np.pi


def scene_pairs(bodies: Sequence[Body], links: int) -> Pairs:
    """Pairs of the first bodies (links), if they move, with all other bodies."""
    moving = [i for i in range(links) if bodies[i].joint]
    return _indices([(i, k) for k in range(links, len(bodies)) for i in moving])


def link_bodies(
    robot: Robot, geometry: Geometry, cut: frozenset[str] | None = None
) -> tuple[Body, ...]:
    """Bodies of all links, shared by all checkers of a robot.

    Args:
        robot: The robot.
        geometry: Representation of meshes.
        cut: Names of the links whose meshes have this representation, while the meshes
            of other links are represented by one hull each; None for all links.
    """
    bodies: list[Body] = []
    for part in range(len(robot.collision_model.geometryObjects)):
        whole = cut is not None and part_link(robot, part) not in cut
        kind: Geometry = "hull" if whole else geometry
        bodies += _cached(robot, part_bodies, part, kind)
    return tuple(bodies)


def own_pairs(
    robot: Robot, geometry: Geometry, cut: frozenset[str] | None = None
) -> Pairs:
    """Pairs of the links of a robot, including bodies that are fixed to its base.

    Of the links that move relative to each other, three kinds of pairs are left out:
    pairs that the semantic description disables or, if it disables no pair, neighbours;
    links that overlap at almost all configurations; and links whose convex pieces
    overlap at most configurations although their meshes never do. The selection does
    not depend on ``cut``, see :func:`link_bodies`. The first body of each pair moves.
    """
    checked = _cached(robot, _checked, geometry)
    return _named(link_bodies(robot, geometry, cut), checked)


def links_touching(
    robot: Robot, wanted: Collection[frozenset[str]], q: Array
) -> dict[frozenset[str], int]:
    """Links that touch at given configurations, whether or not their pair is checked.

    The hulls of the links are checked at all configurations, and the meshes at a sample
    of the configurations at which the hulls overlap: links that touch at only one or
    two configurations may be missed.

    Args:
        robot: The robot.
        wanted: Names of the links of each pair to check.
        q: Configurations, shape (m, n) [rad or m].

    Returns:
        Index of the first configuration at which the meshes were found to overlap, by
        the names of the links.
    """
    rows, bodies = robot.expand(q), link_bodies(robot, "hull")
    pairs = _named(bodies, wanted)
    overlap = PairDistances(robot, (bodies, pairs)).distances(q, 0.0) < 0.0
    meshes, found = link_bodies(robot, "mesh"), {}
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


def _cached(robot: Robot, function: Callable[..., T], *arguments: Hashable) -> T:
    """Result of a function of a robot and more arguments, cached with the robot.

    Hashing meshes and checking configurations takes longer than a plan in free space.
    """
    cache: dict[object, T] = robot.__dict__.setdefault("_collision", {})
    key = function, *arguments
    if key not in cache:
        cache[key] = function(robot, *arguments)
    return cache[key]


def _checked(robot: Robot, geometry: Geometry) -> frozenset[frozenset[str]]:
    """Names of the pairs of links that are checked, see :func:`own_pairs`.

    Shapes are inside their hulls, so that pairs whose hulls seldom overlap need no
    decomposition, which takes a second for a mesh.
    """
    hulls = link_bodies(robot, "hull")
    candidates = _candidates(robot, hulls)
    share = _overlaps(robot, hulls, candidates)
    often = {names for names, value in share.items() if value > MOSTLY}
    if often and geometry != "hull":
        cut = frozenset(name for names in often for name in names)
        share = _overlaps(robot, link_bodies(robot, geometry, cut), often)
    left_out = {names for names, value in share.items() if value > ALWAYS}
    doubtful = {names for names, value in share.items() if MOSTLY < value <= ALWAYS}
    if doubtful:
        exact = _overlaps(robot, link_bodies(robot, "mesh"), doubtful)
        left_out |= {
            names for names in doubtful if not 0.0 < exact.get(names, 0.0) <= ALWAYS
        }
    return frozenset(candidates - left_out)


def _candidates(robot: Robot, bodies: Sequence[Body]) -> set[frozenset[str]]:
    """All pairs of links, except disabled pairs (SRDF) or, without any, neighbours."""
    disabled = () if robot.srdf is None else robot.srdf.disabled_pairs
    carriers = {body.joint for body in bodies}
    every = {
        frozenset((one.name, other.name))
        for one, other in combinations(bodies, 2)
        if one.joint != other.joint
        if disabled or not are_neighbours(robot.model, one.joint, other.joint, carriers)
    }
    return every - set(map(frozenset, disabled))


def _overlaps(
    robot: Robot, bodies: Sequence[Body], wanted: Collection[frozenset[str]]
) -> dict[frozenset[str], float]:
    """Share of random configurations at which links overlap, by their names.

    Args:
        robot: The robot.
        bodies: Bodies of the links.
        wanted: Names of the links of each pair.
    """
    pairs = _named(bodies, wanted)
    narrow = NarrowPhase(robot.model, bodies, pairs)
    overlaps = np.array([narrow.overlaps(row, FLUSH) for row in _configurations(robot)])
    return {
        name: float(np.mean(np.any(overlaps[:, chosen], axis=1)))
        for name, chosen in _columns(bodies, pairs).items()
    }


def _named(bodies: Sequence[Body], wanted: Collection[frozenset[str]]) -> Pairs:
    """Pairs of bodies with given names that move relative to each other.

    The first body of each pair moves.
    """
    return _indices(
        [
            (i, k) if one.joint else (k, i)
            for (i, one), (k, other) in combinations(enumerate(bodies), 2)
            if one.joint != other.joint and frozenset((one.name, other.name)) in wanted
        ]
    )


def _indices(pairs: Sequence[tuple[int, int]]) -> Pairs:
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _columns(bodies: Sequence[Body], pairs: Pairs) -> dict[frozenset[str], list[int]]:
    """Indices of the pairs of bodies, by the names of their links."""
    columns: dict[frozenset[str], list[int]] = {}
    for index, both in enumerate(pairs.tolist()):
        columns.setdefault(frozenset(bodies[i].name for i in both), []).append(index)
    return columns


def without(
    left_out: frozenset[frozenset[str]], bodies: Sequence[Body], pairs: Pairs
) -> Pairs:
    """The pairs of bodies, except pairs whose names are left out."""
    if not left_out:
        return pairs
    names = (frozenset(bodies[i].name for i in both) for both in pairs.tolist())
    return pairs[[name not in left_out for name in names]]


def _configurations(robot: Robot) -> Array:
    """Random configurations of the model, (SAMPLES, nq), the same for all checkers."""
    limits, rng = robot.limits, np.random.default_rng(0)
    low = np.clip(limits.position_lower, -UNLIMITED, UNLIMITED)
    high = np.clip(limits.position_upper, -UNLIMITED, UNLIMITED)
    return robot.expand(rng.uniform(low, high, size=(SAMPLES, robot.n)))
