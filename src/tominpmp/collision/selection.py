"""Which pairs of bodies are watched."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.collision.bodies import Body, Geometry, robot_bodies
from tominpmp.collision.narrow import NarrowPhase
from tominpmp.robot import Robot

# Links that overlap at this share of random configurations are made to overlap.
ALWAYS = 0.95
# Convex pieces that overlap at this share of them, where the meshes never do, cannot
# tell how far apart the links are.
MOSTLY = 0.5
SAMPLES = 100
# Where a joint has no limits: what is sampled of it [rad or m].
UNLIMITED = np.pi


def scene_pairs(bodies: Sequence[Body], links: int) -> tuple[IntArray, IntArray]:
    """Pair each of the first bodies, if it moves, with each of the rest."""
    moving = [i for i in range(links) if bodies[i].joint]
    others = range(links, len(bodies))
    first = np.array([i for _ in others for i in moving], dtype=np.int64)
    second = np.array([k for k in others for _ in moving], dtype=np.int64)
    return first, second


def links_of(robot: Robot, geometry: Geometry) -> tuple[Body, ...]:
    """Shapes of all links, the same ones for every checker of a robot."""
    known = _known(robot)
    if ("links", geometry) not in known:
        known["links", geometry] = tuple(robot_bodies(robot, geometry))
    found: tuple[Body, ...] = known["links", geometry]
    return found


def own_pairs(robot: Robot, geometry: Geometry) -> tuple[IntArray, IntArray]:
    """As :func:`self_pairs` for :func:`links_of`, found once for each robot."""
    known = _known(robot)
    if ("pairs", geometry) not in known:
        known["pairs", geometry] = self_pairs(robot, links_of(robot, geometry))
    found: tuple[IntArray, IntArray] = known["pairs", geometry]
    return found


def _known(robot: Robot) -> dict[tuple[str, str], Any]:
    """What was found for a robot before.

    Hashing meshes and trying configurations takes longer than a plan in free space.
    """
    found: dict[tuple[str, str], Any] = robot.__dict__.setdefault("_collision", {})
    return found


def self_pairs(robot: Robot, bodies: Sequence[Body]) -> tuple[IntArray, IntArray]:
    """Pair the links of a robot with each other, and with what is fixed to its base.

    Left out are the pairs that the semantic description disables (if it disables any),
    else neighbours; links that overlap at nearly all configurations; and links whose
    convex pieces overlap at most of them while their meshes do not at any.

    Args:
        robot: The robot.
        bodies: Its links.

    Returns:
        Bodies of the pairs, of which the first moves, shapes (pairs,).
    """
    disabled = set() if robot.srdf is None else set(robot.srdf.disabled_pairs)
    carriers = {body.joint for body in bodies}
    candidates = []
    for i, one in enumerate(bodies):
        for k in range(i + 1, len(bodies)):
            other = bodies[k]
            if one.joint == other.joint:
                continue
            names = min(one.name, other.name), max(one.name, other.name)
            if names in disabled:
                continue
            if not disabled and _neighbours(robot, one.joint, other.joint, carriers):
                continue
            candidates.append((i, k) if one.joint else (k, i))
    first = np.array([i for i, _ in candidates], dtype=np.int64)
    second = np.array([k for _, k in candidates], dtype=np.int64)
    kept = _sometimes_apart(robot, bodies, first, second)
    return first[kept], second[kept]


def _neighbours(robot: Robot, one: int, other: int, carriers: set[int]) -> bool:
    """Whether no other link with a shape is between two joints in the tree."""
    for joint, target in ((one, other), (other, one)):
        parent = int(robot.model.parents[joint])
        while parent and parent not in carriers:
            parent = int(robot.model.parents[parent])
        if parent == target:
            return True
    return False


def _sometimes_apart(
    robot: Robot, bodies: Sequence[Body], first: IntArray, second: IntArray
) -> IntArray:
    """Indices of the pairs of links that their shapes can tell apart."""
    if not first.size:
        return first
    share = _overlapping(robot, bodies, first, second)
    left_out = {name for name, often in share.items() if often > ALWAYS}
    doubtful = {name for name, often in share.items() if MOSTLY < often <= ALWAYS}
    if doubtful:
        meshes = robot_bodies(robot, "mesh")
        pairs = [
            (i, k) if meshes[i].joint else (k, i)
            for i, k in combinations(range(len(meshes)), 2)
            if frozenset((meshes[i].name, meshes[k].name)) in doubtful
        ]
        exact = _overlapping(robot, meshes, *np.array(pairs, dtype=np.int64).T)
        left_out |= {name for name in doubtful if exact.get(name, 0.0) == 0.0}
    return np.array(
        [
            index
            for index, (i, k) in enumerate(zip(first, second, strict=True))
            if frozenset((bodies[i].name, bodies[k].name)) not in left_out
        ],
        np.int64,
    )


def _overlapping(
    robot: Robot, bodies: Sequence[Body], first: IntArray, second: IntArray
) -> dict[frozenset[str], float]:
    """Share of random configurations at which links overlap, by their names."""
    narrow = NarrowPhase(robot.model, bodies, first, second)
    overlaps = np.array([narrow.overlaps(row) for row in _configurations(robot)])
    columns: dict[frozenset[str], list[int]] = {}
    for index, (i, k) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        columns.setdefault(frozenset((bodies[i].name, bodies[k].name)), []).append(
            index
        )
    return {
        name: float(np.mean(np.any(overlaps[:, chosen], axis=1)))
        for name, chosen in columns.items()
    }


def _configurations(robot: Robot) -> Array:
    """Configurations of the model, the same ones for every checker."""
    limits, rng = robot.limits, np.random.default_rng(0)
    low = np.clip(limits.position_lower, -UNLIMITED, UNLIMITED)
    high = np.clip(limits.position_upper, -UNLIMITED, UNLIMITED)
    return robot.expand(rng.uniform(low, high, size=(SAMPLES, robot.n)))
