"""Good orders of many stations: stretches are turned round and moved elsewhere.

For given configurations this is a travelling salesman problem with 2-opt moves (a
stretch is turned round) and Or-opt moves (a stretch of one to three stations goes
elsewhere, either way round), until none is better; then a kick, and again. For a given
order the best configurations are found by dynamic programming. The two take turns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.cell.tours.leg_table import LegTable
from tominpmp.cell.tours.station import Rules
from tominpmp.stopping import check

# What a leg costs that is not allowed [s], so that differences stay numbers.
FORBIDDEN = 1e7
# Longest stretch that is moved elsewhere.
STRETCH = 3
# Gain below which a move is none [s].
LEAST_GAIN = 1e-9
# Moves that are tried of those that promise most, where not all orders are allowed.
TRIED = 200
# Kicks of a search, at the most.
MOST_KICKS = 300
# Turns of order and configurations.
ROUNDS = 12


class OrderSearch:
    """Search for the order of nodes with one configuration each.

    Attributes:
        cost: Times between the nodes, shape (m, m); the start is node 0.
        rules: Orders that are allowed.
        ends: Whether the last node is the end.
    """

    def __init__(self, cost: Array, rules: Rules, ends: bool) -> None:
        self.rules, self.ends = rules, ends
        cost = np.where(np.isfinite(cost), cost, FORBIDDEN)
        if not ends:
            # An end that is reached from anywhere in no time.
            cost = np.pad(cost, ((0, 1), (0, 1)))
        for i, allowed in rules.then.items():
            for j in range(rules.count):
                if j not in allowed:
                    cost[i + 1, j + 1] = FORBIDDEN
            cost[i + 1, -1] = FORBIDDEN
        self.cost = cost
        self.symmetric = bool(np.array_equal(cost[1:-1, 1:-1], cost[1:-1, 1:-1].T))

    def length(self, way: IntArray) -> float:
        """Time of a way over nodes."""
        return float(np.sum(self.cost[way[:-1], way[1:]]))

    def way(self, order: Sequence[int]) -> IntArray:
        """Nodes of an order of stations, with start and end."""
        middle = np.array(order, dtype=np.int64) + 1
        return np.concatenate([[0], middle, [self.rules.count + 1]])

    def order(self, way: IntArray) -> list[int]:
        """Stations of a way."""
        return [int(node) - 1 for node in way[1:-1]]

    def greedy(self) -> list[int]:
        """Always go to the nearest station that is allowed."""
        left, order = set(range(self.rules.count)), list[int]()
        here = 0
        while left:
            may = sorted(j for j in left if not self.rules.needs[j] & left)
            nearest = may[int(np.argmin(self.cost[here, np.array(may) + 1]))]
            order.append(nearest)
            left.discard(nearest)
            here = nearest + 1
        return order

    def improved(self, order: Sequence[int]) -> list[int]:
        """Make an order better until no move does so any more."""
        way = self.way(order)
        while True:
            check()
            better = self._step(way)
            if better is None:
                return self.order(way)
            way = better

    def kicked(
        self, order: Sequence[int], kicks: int, rng: np.random.Generator
    ) -> list[int]:
        """Look for better orders beyond kicks (Martin, Otto and Felten, 1991)."""
        best = list(order)
        shortest = self.length(self.way(best))
        n = len(best)
        if n < 5:
            return best
        for _ in range(kicks):
            # Cuts near each other: what is far away need not be mended again.
            width = min(n, 50)
            begin = int(rng.integers(0, n - width + 1))
            cut = np.sort(rng.choice(np.arange(1, width), 3, replace=False)) + begin
            a, b, c = cut.tolist()
            other = best[:a] + best[b:c] + best[a:b] + best[c:]
            if self.rules.before and not self.rules.in_turn(other):
                continue
            other = self.improved(other)
            length = self.length(self.way(other))
            if length < shortest - LEAST_GAIN:
                best, shortest = other, length
        return best

    def _step(self, way: IntArray) -> IntArray | None:
        """The best move that is allowed; None if none gains."""
        found = [self._turning(way), *self._moving(way)]
        if not self.rules.before:
            best = min(found, key=lambda item: float(item[0].min(initial=0.0)))
            if float(best[0].min(initial=0.0)) > -LEAST_GAIN:
                return None
            k = int(np.argmin(best[0]))
            a, b = divmod(k, best[0].shape[1])
            return self._moved(way, best[1], a, b)
        for gain, kind, i, j in self._promising(found):
            if gain > -LEAST_GAIN:
                return None
            other = self._moved(way, kind, i, j)
            if self.rules.in_turn(self.order(other)):
                return other
        return None

    def _promising(
        self, found: Sequence[tuple[Array, int]]
    ) -> Iterator[tuple[float, int, int, int]]:
        """Moves in the order of what they gain."""
        rows = []
        for gains, kind in found:
            flat = gains.ravel()
            for k in np.argsort(flat, kind="stable")[:TRIED].tolist():
                i, j = np.unravel_index(k, gains.shape)
                rows.append((float(flat[k]), kind, int(i), int(j)))
        return iter(sorted(rows))

    def _turning(self, way: IntArray) -> tuple[Array, int]:
        """Gains of turning round the stretch from place i to place j, both inner."""
        D, m = self.cost, len(way)
        inner = np.arange(1, m - 1)
        before, here, after = way[inner - 1], way[inner], way[inner + 1]
        gain = (
            D[before[:, None], here[None]]
            + D[here[:, None], after[None]]
            - D[before, here][:, None]
            - D[here, after][None]
        )
        if not self.symmetric:
            forth = np.concatenate([[0.0], np.cumsum(D[here[:-1], here[1:]])])
            back = np.concatenate([[0.0], np.cumsum(D[here[1:], here[:-1]])])
            gain += (back - forth)[None] - (back - forth)[:, None]
        gain[np.tril_indices(len(inner))] = 0.0
        return gain, 0

    def _moving(self, way: IntArray) -> Iterator[tuple[Array, int]]:
        """Gains of moving the stretch at place i to behind place j, either way round.

        Kinds are 1, 2, ... for stretches as they are, -1, -2, ... turned round.
        """
        D, m = self.cost, len(way)
        for size in range(1, min(STRETCH, m - 3) + 1):
            first = np.arange(1, m - size)
            last = first + size - 1
            a, s, e, b = way[first - 1], way[first], way[last], way[last + 1]
            taken = D[a, b] - D[a, s] - D[e, b]
            behind = np.arange(0, m - 1)
            c, d = way[behind], way[behind + 1]
            gap = D[c, d]
            own = (behind[None] >= first[:, None] - 1) & (behind[None] <= last[:, None])
            gain = D[c[None], s[:, None]] + D[e[:, None], d[None]] - gap[None]
            gain = np.where(own, 0.0, gain + taken[:, None])
            yield gain, size
            if size == 1:
                continue
            inside = np.zeros(len(first))
            for k in range(size - 1):
                one, two = way[first + k], way[first + k + 1]
                inside += D[two, one] - D[one, two]
            gain = D[c[None], e[:, None]] + D[s[:, None], d[None]] - gap[None]
            yield np.where(own, 0.0, gain + (taken + inside)[:, None]), -size

    def _moved(self, way: IntArray, kind: int, i: int, j: int) -> IntArray:
        """A way after a move."""
        if kind == 0:
            other = way.copy()
            other[i + 1 : j + 2] = way[i + 1 : j + 2][::-1]
            return other
        first, size = i + 1, abs(kind)
        stretch = way[first : first + size]
        if kind < 0:
            stretch = stretch[::-1]
        rest = np.concatenate([way[:first], way[first + size :]])
        behind = j if j < first else j - size
        return np.concatenate([rest[: behind + 1], stretch, rest[behind + 1 :]])


def search_order(
    table: LegTable,
    rules: Rules,
    rng: np.random.Generator,
    *,
    begin: Sequence[int] | None = None,
    kicks: int | None = None,
) -> tuple[float, tuple[int, ...], tuple[int, ...]]:
    """Find a good order of stations, with their configurations.

    Args:
        table: Times of the legs.
        rules: Orders that are allowed.
        rng: Random numbers.
        begin: An order to begin with.
        kicks: How many kicks an order gets; None for a number that fits.

    Returns:
        As :func:`~tominpmp.cell.tours.exact_order.exact_order`.
    """
    n = table.stations
    kicks = min(max(20, 3 * n), MOST_KICKS) if kicks is None else kicks
    orders = [list(begin)] if begin is not None else _first_orders(table, rules)
    best: tuple[float, tuple[int, ...], tuple[int, ...]] = (np.inf, (), ())
    for order in orders:
        length, chosen = table.best_configurations(table.way(order))
        for turn in range(ROUNDS):
            at = np.zeros(len(table.nodes), dtype=int)
            at[table.way(order)] = chosen
            search = OrderSearch(table.fixed(at.tolist()), rules, table.ends)
            order = search.improved(order)
            if turn < 3:
                order = search.kicked(order, kicks, rng)
            now, chosen = table.best_configurations(table.way(order))
            if turn >= 3 and now > length - LEAST_GAIN:
                break
            length = now
        if rules.allow(order) and length < best[0]:
            best = length, tuple(order), tuple(chosen)
    return best


def _first_orders(table: LegTable, rules: Rules) -> list[list[int]]:
    """Orders to begin with: by the least times between stations."""
    n = len(table.nodes)
    least = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1, n):
            # Few configurations will do for a first order.
            a, b = table.nodes[i][:8], table.nodes[j][:8]
            least[i, j] = least[j, i] = table.factor * np.min(table.times.matrix(a, b))
    for i, j in table.learned:
        least[i, j] = np.min(table.block(i, j))
    search = OrderSearch(least, rules, table.ends)
    return [search.improved(search.greedy())]
