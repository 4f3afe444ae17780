"""Orders of stations, with a configuration for each.

For few stations the best order is found by dynamic programming over sets, as in the
travelling salesman problem (Held and Karp 1962): the best path through a set of
stations that ends at a configuration of one of them follows from the sets with one
station less. For many stations, stretches of an order are removed and their stations
reinserted one by one where each costs least (ruin and recreate; Christiaens and Vanden
Berghe 2020); simulated annealing accepts worse orders at first. The configurations are
fixed in this search; the best configurations for an order are found by dynamic
programming, and the two steps alternate.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import pairwise, permutations

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.cell.tours.legs import LegTable, Place
from tominpmp.cell.tours.station import Rules
from tominpmp.stopping import check

# Limits of the exact search: comparisons, which are 2^n times the square of the number
# of configurations, and stations.
EXACT_WORK, EXACT_STATIONS = 4e8, 14
# Cost of a forbidden leg [s]; finite, so that differences of costs are numbers.
FORBIDDEN = 1e7
# Gain below which an order does not count as shorter [s].
LEAST_GAIN = 1e-9
# Largest number of stations removed at once, and share of the insertion places that are
# skipped at random. Orders of 24 to 245 places in the plane came out as short as with
# 2-opt and Or-opt moves with kicks, or shorter, in less time.
MOST_REMOVED, SKIPPED = 8, 0.03
# Initial and final temperature, as shares of the mean leg, and steps for each station,
# of a search from scratch; initial temperature and steps of a warm start.
HOT, COLD = 3.0, 0.01
STEPS, WARM, FEW_STEPS = 60, 0.1, 10
# Alternations of order and configurations; configurations of each station that a search
# from scratch begins with.
ROUNDS, FEW = 12, 8

# Places of a tour in their order; empty if no order is allowed.
Route = list[Place]


def best_order(table: LegTable, rng: np.random.Generator, before: Route) -> Route:
    """The best order of few stations, a good one of many; see :func:`search_order`."""
    n = table.rules.count
    sizes = [len(rows) for rows in table.nodes[1 : n + 1]]
    if n <= EXACT_STATIONS and 2.0**n * sum(sizes) ** 2 <= EXACT_WORK:
        return exact_order(sizes, table.block, table.rules)[1]
    return search_order(table, rng, before)[1]


def exact_order(
    sizes: Sequence[int], block: Callable[[int, int], Array], rules: Rules
) -> tuple[float, Route]:
    """Find the best order of stations, with their configurations.

    Args:
        sizes: Number of configurations of each station.
        block: Times from each configuration of a node to each of another, shape (k, m)
            [s]; nodes are the start (0), the stations from 1, and the end.
        rules: Orders that are allowed; without an end, the tour ends at any station.

    Returns:
        Time of all legs [s], infinite if no order is allowed, and the route.
    """
    n, ends, full = len(sizes), rules.ends, (1 << len(sizes) + 2) - 1
    # Configurations of all nodes stand one after the other; an open end is a node that
    # every station reaches in zero time.
    edges = np.cumsum([0, 1, *sizes, 1]).tolist()
    block_of = [slice(a, b) for a, b in pairwise(edges)]
    node = np.repeat(np.arange(len(block_of)), np.diff(edges))
    # Sets of nodes are bit masks: here the nodes that have to precede each node.
    before_end = full >> 1
    need = [sum(1 << i for i in needed) for needed in rules.needs]
    between = np.full((edges[-1], edges[-1]), np.inf)
    for i, j in permutations(range(n + 2), 2):
        if j and i <= n and rules.follows[i, j]:
            times = block(i, j) if ends or j <= n else 0.0
            between[block_of[i], block_of[j]] = times
    # By set: best time for each last configuration.
    never = np.full(edges[-1], np.inf)
    cost = defaultdict[int, Array](never.copy)
    cost[1][block_of[0]] = 0.0
    for visited in range(1, before_end + 1, 2):
        check()
        row = cost.get(visited, never)
        alive = np.flatnonzero(np.isfinite(row))
        if not alive.size:
            continue
        through = between[alive]
        through += row[alive, None]
        least = np.min(through, axis=0)
        for j in range(1, len(block_of)):
            if not (visited >> j & 1 or need[j] & ~visited):
                cost[visited | 1 << j][block_of[j]] = least[block_of[j]]
    total = cost.get(full, never)
    path, visited = [int(np.argmin(total))], full
    if not np.isfinite(total[path[0]]):
        return np.inf, []
    while visited > 1:
        # The configuration before is found anew: that takes less time than to note all.
        visited ^= 1 << int(node[path[-1]])
        path.append(int(np.argmin(cost[visited] + between[:, path[-1]])))
    places = path[::-1][: n + 1 + ends]
    nodes = node[places].tolist()
    chosen = [place - edges[k] for k, place in zip(nodes, places, strict=True)]
    return float(total[path[0]]), list(zip(nodes, chosen, strict=True))


def search_order(
    table: LegTable, rng: np.random.Generator, before: Sequence[Place] = ()
) -> tuple[float, Route]:
    """Find a good order of stations, with their configurations.

    Args:
        table: Times of the legs, and the orders that are allowed.
        rng: Random numbers.
        before: Route of a warm start; empty for a search from scratch.

    Returns:
        Time of all legs [s], infinite if no order was found that is allowed, and the
        route.
    """
    length, rules = np.inf, table.rules
    order = [node for node, _ in before[1 : rules.count + 1]]
    if not order:
        nodes = range(len(table.nodes))
        few = table.along(nodes, [rows[:FEW] for rows in table.nodes])
        least = np.array([[few.block(i, j).min() for j in nodes] for i in nodes])
        order = _OrderSearch(least, rules, rng).improved([], HOT, STEPS)
    for left in range(ROUNDS, -1, -1):
        former = length
        way = rules.along(0, order, rules.count + 1)
        length, route = table.best_configurations(way)
        if length > former - LEAST_GAIN or not left:
            break
        chosen = [c for _, c in sorted(route)]
        search = _OrderSearch(table.fixed(chosen), rules, rng)
        order = search.improved(order, WARM, FEW_STEPS)
    if not rules.allow(order) or not np.isfinite(length):
        return np.inf, []
    return length, route


class _OrderSearch:
    """Ruin and recreate for the order of nodes with one configuration each.

    Args:
        cost: Times between the nodes, shape (m, m); the start is node 0.
        rules: Orders that are allowed, and whether the last node is the end.
        rng: Random numbers.
    """

    def __init__(self, cost: Array, rules: Rules, rng: np.random.Generator) -> None:
        n = rules.count
        cost = np.where(np.isfinite(cost), cost, FORBIDDEN)
        if not rules.ends:
            # An open end is a node that every station reaches in zero time.
            cost = np.pad(cost, ((0, 1), (0, 1)))
        cost[~rules.follows] = FORBIDDEN
        self.cost, self.n, self.rng = cost, n, rng
        inner = cost[1 : n + 1, 1 : n + 1]
        self.near = np.argsort(inner + inner.T, axis=1, kind="stable") + 1
        self.earlier = rules.needs

    def length(self, path: Sequence[int]) -> float:
        """Time of a path over nodes, from the start to the end."""
        return float(np.sum(self.cost[path[:-1], path[1:]]))

    def improved(self, order: Sequence[int], hot: float, steps: int) -> list[int]:
        """A shorter order of the stations, or the same order.

        Args:
            order: The stations in their order; missing stations are inserted first.
            hot: Initial temperature, as a share of the mean leg.
            steps: Number of removals, for each station.
        """
        rng, path = self.rng, [0, *order, self.n + 1]
        missing = sorted({*range(1, self.n + 1)} - {*path})
        none_skipped = np.zeros((len(missing), self.n + 2), dtype=bool)
        self._insert(path, rng.permutation(missing).tolist(), none_skipped)
        best, length = path, self.length(path)
        least, mean = length, min(length, FORBIDDEN) / (self.n + 1)
        for step in range(steps * self.n if self.n > 1 else 0):
            check()
            removed = self._stretches(path)
            trial = [node for node in path if node not in removed]
            skipped = rng.random((len(removed), len(path))) < SKIPPED
            self._insert(trial, rng.permutation(sorted(removed)).tolist(), skipped)
            trial_length = self.length(trial)
            share = step / (steps * self.n)
            temperature = mean * hot * (COLD / hot) ** share
            if trial_length < length - temperature * np.log(1.0 - rng.random()):
                path, length = trial, trial_length
                if length < least - LEAST_GAIN:
                    best, least = path, length
        return best[1:-1]

    def _stretches(self, path: Sequence[int]) -> set[int]:
        """Nodes to be removed: stretches of the path about neighbours of one node."""
        most = int(self.rng.integers(1, min(self.n, MOST_REMOVED) + 1))
        size = int(self.rng.integers(1, most + 1))
        place = {node: k for k, node in enumerate(path)}
        removed: set[int] = set()
        for node in self.near[self.rng.integers(self.n)].tolist():
            if len(removed) >= most:
                break
            if node not in removed:
                first = max(1, place[node] - int(self.rng.integers(size)))
                removed.update(path[first : min(first + size, len(path) - 1)])
        return removed

    def _insert(
        self, path: list[int], nodes: Sequence[int], skipped: BoolArray
    ) -> None:
        """Insert nodes into a path, each at the allowed place where it costs least.

        Args:
            path: Nodes in their order; changed in place.
            nodes: The nodes to be inserted, one after the other.
            skipped: Whether a node skips a place, shape (nodes, places at least).
        """
        for number, node in enumerate(nodes):
            here = np.array(path)
            before, after = here[:-1], here[1:]
            D = self.cost
            more = D[before, node] + D[node, after] - D[before, after]
            more = more + FORBIDDEN * skipped[number, : more.size]
            first, last = 0, more.size
            for k, other in enumerate(path):
                if other in self.earlier[node]:
                    first = k
                elif node in self.earlier[other]:
                    last = min(last, k)
            path.insert(first + int(np.argmin(more[first:last])) + 1, node)
