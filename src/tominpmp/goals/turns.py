"""Whole turns of joints that are angles: joint positions that are equivalent."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from tominpmp.arrays import Array, BoolArray

TURN = 2.0 * np.pi
# Largest number of equivalent positions of all joints together. A problem raises it to
# one more than the number of angles, so that each may turn in the other direction.
MOST_WAYS = 6


def equivalent_positions(
    q: Array,
    near: Array,
    angles: BoolArray,
    limits: Sequence[Array],
    moving: BoolArray,
    most: int,
) -> tuple[Array, ...]:
    """Joint positions that are equivalent up to whole turns, the nearest first.

    An angle is reached by the nearest turn, and by the nearest turn in the other
    direction; by a third turn where the joint moves at the start or the end, as moving
    on may be faster than reversing. The joints choose independently: after the nearest
    turns of all joints come the changes of one joint, then those of two joints, each
    in the order of the time that the changed joints need at their speed limits.

    Args:
        q: Joint positions, shape (k,) [rad or m].
        near: Positions of the joints at the start, shape (k,).
        angles: Which of the joints are angles, shape (k,).
        limits: Lower and upper position limits, beyond which turns are left out, and
            speed limits [rad/s or m/s], shape (k,) each.
        moving: Which of the joints move at the start or the end, shape (k,).
        most: Largest number of combinations of turns.

    Returns:
        At least one vector of positions, shape (k,) each.
    """
    lower, upper, velocity = limits
    nearest = np.round((near - q) / TURN)
    first, changes = np.array(q), list[tuple[float, int, float]]()
    for i in np.flatnonzero(angles).tolist():
        turned = q[i] + TURN * (nearest[i] + np.array([0.0, -1.0, 1.0]))
        inside = [x for x in turned.tolist() if lower[i] <= x <= upper[i]]
        # Half a turn is equally far in both directions: the caller's number is kept.
        inside.sort(key=lambda x: (round(abs(x - near[i]), 9), abs(x - q[i])))
        others = inside[1 : 3 if moving[i] else 2]
        first[i] = (inside or [q[i]])[0]
        changes += [(abs(x - near[i]) / velocity[i], i, x) for x in others]
    changes.sort()
    pairs = [pair for pair in combinations(changes, 2) if pair[0][1] != pair[1][1]]
    pairs.sort(key=lambda pair: pair[1][0])  # the slower of both comes second
    ways = []
    for changed in [(), *((change,) for change in changes), *pairs][:most]:
        way = first.copy()
        for _, i, x in changed:
            way[i] = x
        ways.append(way)
    return tuple(ways)


def joined_turns(goals: Sequence[Any]) -> Any:
    """One goal with the equivalent positions of goals that are whole turns apart."""
    return goals[0]._with_ways(*(q for goal in goals for q in goal.ways))
