"""Orders of stations, with a configuration for each.

For few stations the best order is found as Held and Karp (1962) solve the travelling
salesman problem: the best way through a set of stations that ends at a configuration
of one of them is found from the sets with one station less. For more, stretches of an
order are taken out and their stations put back one by one where each costs least
(ruin and recreate; Christiaens and Vanden Berghe 2020), worse orders being kept at
first as in simulated annealing. That is done for given configurations; the best
configurations along an order are found by dynamic programming, and the two take turns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations, pairwise, permutations

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.cell.tours.legs import LegTable
from tominpmp.cell.tours.station import Rules
from tominpmp.stopping import check

# Numbers that the exact search may compare: 2^n times the square of all configurations.
MOST_WORK, MOST_STATIONS = 4e8, 14
# What a leg costs that is not allowed [s], so that differences stay numbers.
FORBIDDEN = 1e7
# Gain below which an order is not shorter [s].
LEAST_GAIN = 1e-9
# Stations taken out at once, at the most; share of the places that are passed over when
# one is put back. Orders of 24 to 245 places in the plane came out as short as those of
# 2-opt and Or-opt moves with kicks, or shorter, in less time.
TAKEN_OUT, PASSED_OVER = 8, 0.03
# Temperatures at the beginning and at the end, as shares of the mean leg, and steps for
# each station: of a search from scratch, and of one that begins with an order.
HOT, COLD = 3.0, 0.01
STEPS, WARM, FEW_STEPS = 60, 0.1, 10
# Turns of order and configurations.
ROUNDS = 12

# Time of all legs [s], infinite where no order is allowed; stations, from 0, in their
# order; and the configuration of each node in that order, the start and the end too.
Found = tuple[float, tuple[int, ...], tuple[int, ...]]


def best_order(
    table: LegTable,
    rules: Rules,
    rng: np.random.Generator,
    begin: Sequence[int] = (),
) -> Found:
    """The best order of few stations, a good one of many; see :func:`search_order`."""
    n = table.stations
    sizes = [len(rows) for rows in table.nodes[1 : n + 1]]
    if n <= MOST_STATIONS and 2.0**n * sum(sizes) ** 2 <= MOST_WORK:
        return exact_order(sizes, table.block, rules, table.ends)
    return search_order(table, rules, rng, begin)


def exact_order(
    sizes: Sequence[int],
    block: Callable[[int, int], Array],
    rules: Rules,
    ends: bool,
) -> Found:
    """Find the best order of stations, with their configurations.

    Args:
        sizes: Number of configurations of each station.
        block: Times from each configuration of a node to each of another, shape (k, m)
            [s]; nodes are the start (0), the stations from 1, and the end.
        rules: Orders that are allowed.
        ends: Whether there is an end, else the tour ends at any station.
    """
    n = len(sizes)
    # Without an end there is one that is reached from anywhere in no time.
    last, full = block(1, n + 1).shape[1] if ends else 1, (1 << n + 2) - 1
    # Configurations of all nodes stand one after the other.
    edges = np.cumsum([0, len(block(0, 1)), *sizes, last]).tolist()
    part = [slice(a, b) for a, b in pairwise(edges)]
    node = np.repeat(np.arange(len(part)), np.diff(edges))
    # Sets of nodes are bits: of those that come before each.
    before_end = full >> 1
    need = [0, *(1 | sum(2 << i for i in needed) for needed in rules.needs), before_end]
    between = np.full((edges[-1], edges[-1]), np.inf)
    for i, j in permutations(range(len(part)), 2):
        inner = max(i, j) <= n
        allowed = rules.follows(i - 1, j - 1) if inner else rules.may_end(i - 1)
        if j and i <= n and (i == 0 or allowed):
            between[part[i], part[j]] = block(i, j) if inner or ends else 0.0
    # By set: best time by last configuration, and the one before that.
    never = np.full(edges[-1], np.inf)
    cost, came = {1: never.copy()}, dict[tuple[int, int], Array]()
    cost[1][part[0]] = 0.0
    for done in range(1, before_end + 1, 2):
        check()
        row = cost.pop(done, never)
        alive = np.flatnonzero(np.isfinite(row))
        if not alive.size:
            continue
        for j in range(1, len(part)):
            if done >> j & 1 or need[j] & ~done:
                continue
            through = row[alive, None] + between[alive, part[j]]
            came[done | 1 << j, j] = alive[np.argmin(through, axis=0)]
            after = cost.setdefault(done | 1 << j, never.copy())
            after[part[j]] = np.min(through, axis=0)
    total = cost.get(full, never)
    way, done = [int(np.argmin(total))], full
    if not np.isfinite(total[way[0]]):
        return np.inf, (), ()
    while done > 1:
        j = int(node[way[-1]])
        way.append(int(came[done, j][way[-1] - edges[j]]))
        done ^= 1 << j
    nodes = node[way[::-1]]
    chosen = (np.array(way[::-1]) - np.array(edges)[nodes])[: n + 1 + ends]
    order = nodes[1 : n + 1] - 1
    return float(total[way[0]]), tuple(order.tolist()), tuple(chosen.tolist())


def search_order(
    table: LegTable,
    rules: Rules,
    rng: np.random.Generator,
    begin: Sequence[int] = (),
) -> Found:
    """Find a good order of stations, with their configurations.

    Args:
        table: Times of the legs.
        rules: Orders that are allowed.
        rng: Random numbers.
        begin: An order to begin with; empty for a search from scratch.
    """
    order, length = list(begin), np.inf
    if not order:
        first = _OneEach(_least_times(table), rules, table.ends)
        order = first.improved([], HOT, STEPS, rng)
    for left in range(ROUNDS, -1, -1):
        before = length
        length, chosen = table.best_configurations(table.way(order))
        if length > before - LEAST_GAIN or not left:
            break
        by_node = np.zeros(len(table.nodes), dtype=int)
        by_node[table.way(order)] = chosen
        each = _OneEach(table.fixed(by_node.tolist()), rules, table.ends)
        order = each.improved(order, WARM, FEW_STEPS, rng)
    if not rules.allow(order):
        return np.inf, (), ()
    return length, tuple(order), tuple(chosen)


def _least_times(table: LegTable) -> Array:
    """Least times between nodes, over a few configurations of each."""
    n = len(table.nodes)
    least = np.zeros((n, n))
    few = [rows[:8] for rows in table.nodes]
    for i, j in combinations(range(n), 2):
        found = table.factor * np.min(table.times.matrix(few[i], few[j]))
        least[i, j] = least[j, i] = found
    return least


class _OneEach:
    """Orders of nodes with one configuration each.

    Args:
        cost: Times between the nodes, shape (m, m); the start is node 0.
        rules: Orders that are allowed.
        ends: Whether the last node is the end.
    """

    def __init__(self, cost: Array, rules: Rules, ends: bool) -> None:
        n = rules.count
        cost = np.where(np.isfinite(cost), cost, FORBIDDEN)
        if not ends:
            # An end that is reached from anywhere in no time.
            cost = np.pad(cost, ((0, 1), (0, 1)))
        for i, allowed in rules.then.items():
            others = [j + 1 for j in range(n) if j not in allowed]
            cost[i + 1, [*others, n + 1]] = FORBIDDEN
        self.cost, self.n = cost, n
        inner = cost[1 : n + 1, 1 : n + 1]
        self.near = np.argsort(inner + inner.T, axis=1, kind="stable") + 1
        # By node those that have to come before it.
        needs = [{i + 1 for i in needed} for needed in rules.all_needs]
        self.earlier: list[set[int]] = [set(), *needs, set()]

    def length(self, way: Sequence[int]) -> float:
        """Time of a way over nodes, from the start to the end."""
        return float(np.sum(self.cost[way[:-1], way[1:]]))

    def improved(
        self, order: Sequence[int], hot: float, steps: int, rng: np.random.Generator
    ) -> list[int]:
        """A shorter order of the stations, or the same.

        Args:
            order: The stations in their order; those that lack are put in first.
            hot: Temperature at the beginning, as a share of the mean leg.
            steps: Number of stretches taken out, for each station.
            rng: Random numbers.
        """
        way = [0, *(k + 1 for k in order), self.n + 1]
        lacking = sorted({*range(1, self.n + 1)} - {*way})
        self._put_in(way, rng.permutation(lacking).tolist())
        best, length = way, self.length(way)
        least, mean = length, min(length, FORBIDDEN) / (self.n + 1)
        for step in range(steps * self.n if self.n > 1 else 0):
            check()
            out = self._stretches(way, rng)
            other = [node for node in way if node not in out]
            over = rng.random((len(out), len(way))) < PASSED_OVER
            self._put_in(other, rng.permutation(sorted(out)).tolist(), over)
            now = self.length(other)
            share = step / (steps * self.n)
            temperature = mean * hot * (COLD / hot) ** share
            if now < length - temperature * np.log(1.0 - rng.random()):
                way, length = other, now
                if length < least - LEAST_GAIN:
                    best, least = way, length
        return [node - 1 for node in best[1:-1]]

    def _stretches(self, way: Sequence[int], rng: np.random.Generator) -> set[int]:
        """Nodes of a way to be taken out: stretches of it near to one of them."""
        most = int(rng.integers(1, min(self.n, TAKEN_OUT) + 1))
        size = int(rng.integers(1, most + 1))
        place = {node: k for k, node in enumerate(way)}
        out: set[int] = set()
        for node in self.near[rng.integers(self.n)].tolist():
            if len(out) >= most:
                break
            if node not in out:
                first = max(1, place[node] - int(rng.integers(size)))
                out.update(way[first : min(first + size, len(way) - 1)])
        return out

    def _put_in(
        self, way: list[int], nodes: Sequence[int], over: BoolArray | None = None
    ) -> None:
        """Put nodes into a way, each where it costs least of the places allowed."""
        for number, node in enumerate(nodes):
            here = np.array(way)
            before, after = here[:-1], here[1:]
            D = self.cost
            more = D[before, node] + D[node, after] - D[before, after]
            if over is not None:
                more = more + FORBIDDEN * over[number, : more.size]
            first, last = 0, more.size
            for k, other in enumerate(way):
                if other in self.earlier[node]:
                    first = k
                elif node in self.earlier[other]:
                    last = min(last, k)
            way.insert(first + int(np.argmin(more[first:last])) + 1, node)
