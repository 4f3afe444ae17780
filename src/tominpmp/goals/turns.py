"""Whole turns: numbers of joints that are one place where a joint is an angle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tominpmp.arrays import Array, BoolArray

TURN = 2.0 * np.pi
# Half a turn either way is as far; a number that is given stays as it is where it is no
# farther by more than this share of a turn than the nearest one.
ROUNDING = 1e-9
# Ways of all joints together that are looked at: the nearest and, for most arms, one
# for each angle that goes the other way round.
MOST_WAYS = 6


def equivalent_positions(
    q: Array,
    near: Array,
    angles: BoolArray,
    limits: tuple[Array, Array],
    moving: BoolArray,
    most: int = MOST_WAYS,
) -> tuple[Array, ...]:
    """Positions that are the same place, for each way round; the nearest first.

    An angle is reached by the nearest turn, and by the one on the other side; by one
    more where the joint moves at the start or the end, and going on may be faster than
    turning back.

    Args:
        q: Positions, shape (k,) [rad or m].
        near: Where the joints begin, shape (k,).
        angles: Which of the joints are angles, shape (k,).
        limits: Position limits, shape (k,) each; turns beyond them are left out.
        moving: Which of the joints move at the start or the end, shape (k,).
        most: Largest number of positions.

    Returns:
        At least one, of shape (k,) each: by how much farther the joints go in all.
    """
    ways: list[tuple[float, list[float]]] = [(0.0, [])]
    away = (near - q) / TURN
    nearest = np.sign(away) * np.maximum(np.ceil(np.abs(away) - 0.5 - ROUNDING), 0.0)
    for i, (own, base) in enumerate(zip(q.tolist(), nearest.tolist(), strict=True)):
        found = [own]
        if angles[i]:
            several = [own + TURN * (base + more) for more in (0, -1, 1)]
            inside = [x for x in several if limits[0][i] <= x <= limits[1][i]]
            inside.sort(key=lambda x: (round(abs(x - near[i]), 9), abs(x - own)))
            found = inside[: 3 if moving[i] else 2] or found
        extra = [abs(x - near[i]) - abs(found[0] - near[i]) for x in found]
        ways = [
            (far + more, [*before, x])
            for far, before in ways
            for more, x in zip(extra, found, strict=True)
        ]
        # Sums only grow, so that none of the best begins with one that is left out.
        ways = sorted(ways, key=lambda way: way[0])[:most]
    return tuple(np.array(way) for _, way in ways)


def joined_turns(goals: Sequence[Any]) -> Any:
    """One goal with the turns of several that differ by turns alone."""
    return goals[0]._by(*(q for goal in goals for q in goal.ways))
