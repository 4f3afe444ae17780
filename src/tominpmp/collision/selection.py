"""Which pairs of bodies are watched."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.collision.bodies import Body
from tominpmp.collision.narrow import NarrowPhase
from tominpmp.robot import Robot

# Links that overlap at this share of random configurations are made to overlap.
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


def self_pairs(robot: Robot, bodies: Sequence[Body]) -> tuple[IntArray, IntArray]:
    """Pair the links of a robot with each other, and with what is fixed to its base.

    Left out are the pairs that the semantic description disables (if it disables any),
    else neighbours; and links that overlap at most configurations.

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
    """Indices of the pairs of links that do not overlap at most configurations."""
    if not first.size:
        return first
    narrow = NarrowPhase(robot.model, bodies, first, second)
    overlaps = np.array([narrow.overlaps(row) for row in _configurations(robot)])
    names = [
        frozenset((bodies[i].name, bodies[k].name))
        for i, k in zip(first.tolist(), second.tolist(), strict=True)
    ]
    mostly = set()
    for name in set(names):
        columns = [index for index, item in enumerate(names) if item == name]
        if np.mean(np.any(overlaps[:, columns], axis=1)) > MOSTLY:
            mostly.add(name)
    return np.array([i for i, name in enumerate(names) if name not in mostly], np.int64)


def _configurations(robot: Robot) -> Array:
    """Configurations of the model, the same ones for every checker."""
    limits, rng = robot.limits, np.random.default_rng(0)
    low = np.clip(limits.position_lower, -UNLIMITED, UNLIMITED)
    high = np.clip(limits.position_upper, -UNLIMITED, UNLIMITED)
    return robot.expand(rng.uniform(low, high, size=(SAMPLES, robot.n)))
