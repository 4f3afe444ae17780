"""Least time of one joint in gravity: a shortest path through its swings.

A motion is a chain of swings, whose turning points lie in cells of a grid: a shortest
path through the cells is a bound on all motions, however often they swing.

Where a motion meets a state twice, the loop between can be cut out. So the fastest one
spirals: its swings get wider, each past the position of the start, and then narrower,
each past that of the goal. No others need be looked at.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.bounds.one_joint import OneJoint
from tominpmp.bounds.phase_plane import (
    ROUNDING,
    Branch,
    Slope,
    branches,
    meeting,
    mirrored,
    single_branch,
)
from tominpmp.bounds.straight_swing import straight_time
from tominpmp.stopping import check

# Cells of turning points.
CELLS = 240
# Turning points are looked for this far beyond start and goal: at first as a share of
# the way, at last in rad. Those farther away are one cell.
FIRST_SHARE = 1.0
FARTHEST = 4.0
# Positions may be this far beyond their limits, as the verification has it [rad].
BEYOND = 1e-2
# A bound that motions which go farther lower by less than this is good.
GOOD = 1e-3
# Sweeps over all cells until the shortest path is known.
SWEEPS = 200


@dataclass(frozen=True, eq=False)
class Swings:
    """Swings to the right between cells of a grid of positions.

    Cell i is from position i to position i + 1. Beside the cells there is what is left
    of the grid, index 0, and right of it, the last index.

    Attributes:
        between: Least times from cell to cell, shape (m + 2, m + 2).
        to_goal: From each cell to the goal, shape (m + 2,).
        from_start: From the start to each cell, shape (m + 2,).
    """

    between: Array
    to_goal: Array
    from_start: Array

    @classmethod
    def of(
        cls, arm: OneJoint, at: Array, nodes: tuple[int, int], v: tuple[float, float]
    ) -> Swings:
        """Look at the swings of an arm.

        Args:
            arm: The arm.
            at: Positions of the grid, shape (m + 1,).
            nodes: Which ones are the start and the goal.
            v: Velocities there.
        """
        m, h = at.size - 1, float(at[1] - at[0])
        cells, step = np.arange(m), np.arange(m)[:, None]
        # One position more on either side for the cells at the edges.
        more = np.concatenate([at, [at[-1] + h]])
        place = np.minimum(cells + step, m - 1)
        forward = branches(Slope(arm, False), more, np.zeros(m), h, place, True)
        less = np.concatenate([[at[0] - h], at])[::-1]
        place = np.minimum((m - 1 - cells) + step, m - 1)
        back = branches(Slope(arm, True), less, np.zeros(m), h, place, True)
        full = np.zeros((m + 2, m + 2))
        wanted = _past(m, nodes[0]) | _past(m, nodes[1])
        pairs = meeting(
            forward, back, cells + 1, cells, arm.strongest, wanted[1:-1, 1:-1]
        )
        full[1:-1, 1:-1] = pairs
        full[cells + 1, cells + 1] = 0.0
        full[1:-1, -1] = forward.t[m - cells - 1, cells]
        full[0, 1:-1] = back.t[cells, cells]
        full[-1], full[:, 0] = np.inf, np.inf
        start, goal = nodes
        to_goal = np.full(m + 2, np.inf)
        from_start = np.full(m + 2, np.inf)
        if v[1] >= 0.0:
            end = single_branch(arm, float(at[goal]), v[1], h, goal, True)
            left = cells[:goal]
            if goal:
                bundle = Branch(forward.E[:, :goal], forward.t[:, :goal])
                goals = meeting(bundle, end, left + 1, np.array([goal]), arm.strongest)
                to_goal[1 : goal + 1] = goals[:, 0]
            to_goal[0] = end.t[-1, 0]
        if v[0] >= 0.0:
            begin = single_branch(arm, float(at[start]), v[0], h, m - start, False)
            if start < m:
                bundle = Branch(back.E[:, start:], back.t[:, start:])
                there = meeting(
                    begin, bundle, np.array([start]), cells[start:], arm.strongest
                )
                from_start[start + 1 : -1] = there[0]
            from_start[-1] = begin.t[-1, 0]
        return cls(full, to_goal, from_start)


@dataclass(frozen=True, eq=False)
class Plane:
    """All swings between cells of turning points, to the right and to the left.

    Attributes:
        between: Times from cell to cell for both ways, shape (m + 2, m + 2) each; cells
            are numbered from the left.
        to_goal: From each cell to the goal.
        from_start: From the start to each cell.
        nodes: The positions of the start and the goal.
        h: Length of the cells.
        walls: Whether there is a limit to positions left of the cells, and right.
    """

    between: tuple[Array, Array]
    to_goal: tuple[Array, Array]
    from_start: tuple[Array, Array]
    nodes: tuple[int, int]
    h: float
    walls: tuple[bool, bool]

    @classmethod
    def of(cls, arm: OneJoint, q: Array, v: Array, reach: float) -> Plane:
        """Look at an arm; see :func:`least_swing_time`.

        Args:
            arm: The arm.
            q: Positions at start and goal, shape (2,).
            v: Velocities there, shape (2,).
            reach: How far beyond them turning points are told apart.
        """
        at, start, goal = _grid(arm, q, reach)
        m = at.size - 1
        right = Swings.of(arm, at, (start, goal), (float(v[0]), float(v[1])))
        ends = (m - start, m - goal), (-float(v[0]), -float(v[1]))
        left = Swings.of(mirrored(arm), -at[::-1], *ends)
        return cls(
            (right.between, left.between[::-1, ::-1]),
            (right.to_goal, left.to_goal[::-1]),
            (right.from_start, left.from_start[::-1]),
            (start, goal),
            float(at[1] - at[0]),
            (at[0] <= arm.position[0] - BEYOND, at[-1] >= arm.position[1] + BEYOND),
        )

    def time(self, closed: bool, without_little: bool) -> float:
        """Least time of motions that turn at least once.

        Args:
            closed: Whether they stay among the cells that are told apart.
            without_little: Leave out those that turn in no other cells than those
                beside the start and the goal.
        """
        m = self.to_goal[0].size - 2
        blocked = np.zeros(m + 2)
        blocked[[0, -1]] = [np.inf if closed or wall else 0.0 for wall in self.walls]
        past_start, past_goal = (_past(m, node) for node in self.nodes)
        narrow = self._shortest(past_goal, self.to_goal, blocked)
        wide = self._shortest(past_start, narrow, blocked)
        if without_little:
            little = np.zeros(m + 2, dtype=bool)
            for node in self.nodes:
                little[node : node + 2] = True
            only = np.where(little, 0.0, np.inf)
            away = np.where(little, np.inf, blocked)
            after = self._swung(past_goal, narrow, away)
            narrow = self._shortest(past_goal, after, only)
            after = self._swung(past_start, wide, away)
            after = np.minimum(after[0], narrow[0]), np.minimum(after[1], narrow[1])
            among = self._shortest(past_start, after, only)
            wide = (
                np.where(little, among[0], wide[0]),
                np.where(little, among[1], wide[1]),
            )
        return min(
            float(np.min(self.from_start[way] + wide[1 - way] + blocked))
            for way in (0, 1)
        )

    def _swung(
        self, allowed: BoolArray, after: tuple[Array, Array], blocked: Array
    ) -> tuple[Array, Array]:
        """Least times from rest in each cell, of which the first is for one swing."""
        right = np.where(allowed, self.between[0], np.inf) + blocked
        left = np.where(allowed.T, self.between[1], np.inf) + blocked
        return np.min(right + after[1], axis=1), np.min(left + after[0], axis=1)

    def _shortest(
        self, allowed: BoolArray, after: tuple[Array, Array], blocked: Array
    ) -> tuple[Array, Array]:
        """Least times from rest in each cell, about to go right or left.

        Args:
            allowed: Which pairs of cells, left and right, swings may join.
            after: Times if no such swing follows.
            blocked: Infinite for cells that are out of bounds.
        """
        right = np.where(allowed, self.between[0], np.inf) + blocked
        left = np.where(allowed.T, self.between[1], np.inf) + blocked
        found = after
        for _ in range(SWEEPS):
            check()
            there = np.minimum(after[0], np.min(right + found[1], axis=1))
            back = np.minimum(after[1], np.min(left + there, axis=1))
            if np.array_equal(there, found[0]) and np.array_equal(back, found[1]):
                return found
            found = there, back
        return np.zeros_like(after[0]), np.zeros_like(after[1])


def _past(m: int, node: int) -> BoolArray:
    """Which pairs of cells, left and right, have a position between them."""
    number = np.arange(m + 2)
    # Cell number k is from position k - 1 to position k.
    return np.asarray((number <= node)[:, None] & (number > node)[None, :])


def _grid(arm: OneJoint, q: Array, reach: float) -> tuple[Array, int, int]:
    """Positions of a grid on which start and goal are, and which ones they are."""
    low, high = float(np.min(q)), float(np.max(q))
    first = max(low - reach, min(arm.position[0] - BEYOND, low))
    last = min(high + reach, max(arm.position[1] + BEYOND, high))
    h = max(last - first, 1e-9) / CELLS
    if high > low:
        h = (high - low) / max(round((high - low) / h), 1)
    before = math.ceil((low - first) / h - 1e-9)
    after = math.ceil((last - high) / h - 1e-9)
    between = round((high - low) / h)
    at = np.asarray(low + h * np.arange(-before, between + after + 1))
    ends = before, before + between
    return (at, *ends) if q[0] <= q[1] else (at, ends[1], ends[0])


def least_swing_time(arm: OneJoint, q: Array, v: Array) -> float:
    """Time that no motion of a joint in gravity can beat.

    Args:
        arm: The arm.
        q: Positions at start and goal, shape (2,).
        v: Velocities there, shape (2,).

    Returns:
        The time [s]; infinite if the goal cannot be reached.
    """
    strongest = arm.strongest
    stop = float(np.max(v**2)) / strongest if strongest > 0.0 else 0.0
    reach = min(max(FIRST_SHARE * abs(float(q[1] - q[0])), stop, 1e-3), FARTHEST)
    while True:
        plane = Plane.of(arm, q, v, reach)
        straight = straight_time(arm, q, v, plane.h)
        settled = math.isfinite(straight.T) and straight.saved < GOOD * straight.T
        best, near = (
            min(
                straight.T - (straight.saved if settled else 0.0),
                plane.time(closed, settled),
            )
            for closed in (False, True)
        )
        if reach >= FARTHEST or best >= near * (1.0 - GOOD):
            return best * (1.0 - ROUNDING)
        reach = min(2.0 * reach, FARTHEST)
