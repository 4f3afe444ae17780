"""Whole turns of joints that are angles: joint positions that are equivalent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tominpmp.arrays import Array, BoolArray

TURN = 2.0 * np.pi
# Share of a turn within which two distances count as equal: half a turn is equally far
# in both directions, and then the caller's number is kept.
ROUNDING = 1e-9
# Largest number of equivalent positions of all joints together: the nearest and, for
# most arms, one for each angle that turns in the other direction.
MOST_WAYS = 6


def equivalent_positions(
    q: Array,
    near: Array,
    angles: BoolArray,
    limits: tuple[Array, Array],
    moving: BoolArray,
    most: int = MOST_WAYS,
) -> tuple[Array, ...]:
    """Joint positions that are equivalent up to whole turns, the nearest first.

    An angle is reached by the nearest turn, and by the nearest turn in the other
    direction; by a third turn where the joint moves at the start or the end, as moving
    on may be faster than reversing.

    Args:
        q: Joint positions, shape (k,) [rad or m].
        near: Positions of the joints at the start, shape (k,).
        angles: Which of the joints are angles, shape (k,).
        limits: Position limits, shape (k,) each; turns beyond them are left out.
        moving: Which of the joints move at the start or the end, shape (k,).
        most: Largest number of combinations of turns.

    Returns:
        At least one vector of positions, shape (k,) each, in the order of the distance
        that all joints together travel in addition to the nearest turns.
    """
    ways: list[tuple[float, list[float]]] = [(0.0, [])]
    away = (near - q) / TURN
    nearest = np.sign(away) * np.maximum(np.ceil(np.abs(away) - 0.5 - ROUNDING), 0.0)
    for i, (angle, base) in enumerate(zip(q.tolist(), nearest.tolist(), strict=True)):
        choices = [angle]
        if angles[i]:
            turned = [angle + TURN * (base + more) for more in (0, -1, 1)]
            inside = [x for x in turned if limits[0][i] <= x <= limits[1][i]]
            inside.sort(key=lambda x: (round(abs(x - near[i]), 9), abs(x - angle)))
            choices = inside[: 3 if moving[i] else 2] or choices
        extra = [abs(x - near[i]) - abs(choices[0] - near[i]) for x in choices]
        ways = [
            (distance + more, [*before, x])
            for distance, before in ways
            for more, x in zip(extra, choices, strict=True)
        ]
        # Distances only grow with further joints: a combination that is cut off here
        # cannot be part of one of the best.
        ways = sorted(ways, key=lambda way: way[0])[:most]
    return tuple(np.array(way) for _, way in ways)


def joined_turns(goals: Sequence[Any]) -> Any:
    """One goal with the equivalent positions of goals that are whole turns apart."""
    return goals[0]._with_ways(*(q for goal in goals for q in goal.ways))
