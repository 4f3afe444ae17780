"""The best order and configurations of a few stations, by dynamic programming.

The generalised travelling salesman problem as Held and Karp (1962) solve that of single
cities: the best way through a set of stations that ends at a configuration of one of
them is found from the sets with one station less.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.cell.tours.leg_table import LegTable
from tominpmp.cell.tours.station import Rules
from tominpmp.stopping import check

# Numbers that may be compared: 2^n times the square of all configurations.
MOST_WORK = 4e8
MOST_STATIONS = 14


def small_enough(table: LegTable) -> bool:
    """Whether the best order of a tour can be found in seconds."""
    n = table.stations
    count = sum(map(len, table.nodes[1 : n + 1]))
    return n <= MOST_STATIONS and 2.0**n * count**2 <= MOST_WORK


def exact_order(
    table: LegTable, rules: Rules
) -> tuple[float, tuple[int, ...], tuple[int, ...]]:
    """Find the best order of stations, with their configurations.

    Args:
        table: Times of the legs.
        rules: Orders that are allowed.

    Returns:
        Time of all legs [s], infinite if there is no such order; the order of the
        stations, from 0; and the configuration of each node of the tour, with the
        start and the end.
    """
    search = _Subsets(table, rules)
    return search.best()


class _Subsets:
    """Best ways through sets of stations."""

    def __init__(self, table: LegTable, rules: Rules) -> None:
        self.table, self.rules, self.n = table, rules, table.stations
        sizes = [len(rows) for rows in table.nodes[1 : self.n + 1]]
        self.first = np.concatenate([[0], np.cumsum(sizes)]).astype(int).tolist()
        self.station = np.repeat(np.arange(self.n), sizes)
        self.between = self._between()
        # By set (bits): best time by last configuration, and the one before that.
        self.cost: dict[int, Array] = {}
        self.came: dict[tuple[int, int], Array] = {}

    def part(self, i: int) -> slice:
        """Where the configurations of a station are among all."""
        return slice(self.first[i], self.first[i + 1])

    def _between(self) -> Array:
        """Times between all configurations of all stations."""
        total = self.first[-1]
        out = np.full((total, total), np.inf)
        for i in range(self.n):
            for j in range(self.n):
                if i != j and self.rules.follows(i, j):
                    out[self.part(i), self.part(j)] = self.table.block(i + 1, j + 1)
        return out

    def best(self) -> tuple[float, tuple[int, ...], tuple[int, ...]]:
        """The best way through all of them."""
        full, total = (1 << self.n) - 1, self.first[-1]
        need = [sum(1 << i for i in needed) for needed in self.rules.needs]
        for j in range(self.n):
            if not need[j]:
                row = np.full(total, np.inf)
                row[self.part(j)] = np.min(self.table.block(0, j + 1), axis=0)
                self.cost[1 << j] = row
        for done in range(1, full):
            check()
            cost = self.cost.get(done)
            if cost is None:
                continue
            for j in range(self.n):
                if not done >> j & 1 and need[j] & done == need[j]:
                    self._extend(done, cost, j)
            if done & (done - 1):
                del self.cost[done]
        last = self.cost.get(full)
        if last is None:
            return np.inf, (), ()
        return self._traced(full, last)

    def _extend(self, done: int, cost: Array, j: int) -> None:
        """Go on from a set of stations to one more."""
        part = self.part(j)
        alive = np.flatnonzero(np.isfinite(cost))
        through = cost[alive, None] + self.between[alive, part]
        if not through.size:
            return
        found = np.min(through, axis=0)
        if not np.any(np.isfinite(found)):
            return
        now = done | 1 << j
        row = self.cost.setdefault(now, np.full(self.first[-1], np.inf))
        row[part] = found
        self.came[now, j] = alive[np.argmin(through, axis=0)]

    def _traced(
        self, full: int, last: Array
    ) -> tuple[float, tuple[int, ...], tuple[int, ...]]:
        """The way that ends with the best configuration."""
        table, last, final = self.table, last.copy(), 0
        for i in range(self.n):
            if not self.rules.may_end(i):
                last[self.part(i)] = np.inf
        if table.ends:
            home = np.concatenate(
                [table.block(i + 1, self.n + 1) for i in range(self.n)]
            )
            last = last + np.min(home, axis=1)
        at = int(np.argmin(last))
        if not np.isfinite(last[at]):
            return np.inf, (), ()
        if table.ends:
            final = int(np.argmin(home[at]))
        way, done, total = [at], full, float(last[at])
        while done & (done - 1):
            j = int(self.station[at])
            before = int(self.came[done, j][at - self.first[j]])
            done ^= 1 << j
            at = before
            way.append(at)
        way.reverse()
        order = tuple(int(self.station[k]) for k in way)
        chosen = [k - self.first[i] for k, i in zip(way, order, strict=True)]
        begin = int(np.argmin(table.block(0, order[0] + 1)[:, chosen[0]]))
        return total, order, (begin, *chosen, *([final] if table.ends else []))
