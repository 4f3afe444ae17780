"""Configurations improved for a given order: spins and reaches are not on a grid.

Near the configuration of each station others are tried: those nearest to where the arm
comes from and goes to, half way between, and some at random. The best of all stations
together are found by dynamic programming, and the next ones are looked for nearer by.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tominpmp.arrays import Array
from tominpmp.cell.tours.configurations import Configurations
from tominpmp.cell.tours.leg_table import LegTable

# Rounds unless others are asked for; random trials of a station in each, and the radius
# of the first ones [rad].
ROUNDS = 24
TRIALS = 4
RADIUS = 0.4
# Shrinking of the radius where a round brings less than this share of the time.
SHRINK, LITTLE = 0.6, 2e-3
SMALLEST = 2e-3


def refined(
    configurations: Configurations,
    table: LegTable,
    nodes: Sequence[int],
    way: Sequence[Array],
    rng: np.random.Generator,
    rounds: int = ROUNDS,
) -> list[Array]:
    """Improve the configurations of a tour in a given order.

    Args:
        configurations: What is allowed at stations.
        table: Estimates of the times of legs.
        nodes: The nodes of the tour in their order.
        way: Their configurations, shape (n,) each.
        rng: Random numbers.
        rounds: How often better ones are looked for.

    Returns:
        Configurations of all places.
    """
    goals = configurations.goals
    stations = [table.station(node) for node in nodes]
    open_ones = [
        k
        for k, g in enumerate(stations)
        if g is not None and goals[g].configuration is None
    ]
    way, radius = [np.array(q) for q in way], RADIUS
    if not open_ones:
        return way
    before = np.inf
    for _ in range(rounds):
        way, now = _round(
            configurations, table, nodes, way, stations, open_ones, radius, rng
        )
        if now > before * (1.0 - LITTLE):
            radius *= SHRINK
        if radius < SMALLEST:
            break
        before = now
    return way


def _round(
    configurations: Configurations,
    given: LegTable,
    order: Sequence[int],
    way: list[Array],
    stations: Sequence[int | None],
    open_ones: Sequence[int],
    radius: float,
    rng: np.random.Generator,
) -> tuple[list[Array], float]:
    """Try other configurations of all places, and take the best of them."""
    starts, places = [], []
    for k in open_ones:
        around = [way[k - 1]]
        if k + 1 < len(way):
            around += [way[k + 1], 0.5 * (way[k - 1] + way[k + 1])]
        else:
            around += [way[k - 1]]
        here = way[k]
        # No farther than the radius, so that the arm does not fold elsewhere.
        reach = [here + _cut(q - here, 2.0 * radius) for q in around]
        random = here + radius * rng.uniform(-1.0, 1.0, (TRIALS, here.size))
        rows = np.concatenate([np.stack(reach), random])
        starts.append(rows)
        places.append(np.full(len(rows), k))
    q, place = np.concatenate(starts), np.concatenate(places)
    which = np.array([stations[k] for k in place.tolist()], dtype=np.int64)
    q, good = configurations.projected(q, which)
    q, place = q[good], place[good]
    nodes = [row[None] for row in way]
    for k in open_ones:
        nodes[k] = np.concatenate([nodes[k], q[place == k]])
    while True:
        table = given.along(order, nodes)
        duration, chosen = table.best_configurations(range(len(nodes)))
        # Whether they are clear is asked of those that would be taken.
        bad = [
            (k, c)
            for k, c in enumerate(chosen)
            if c and not configurations.free(nodes[k][c : c + 1], stations[k])[0]
        ]
        if not bad:
            return [nodes[k][c] for k, c in enumerate(chosen)], duration
        for k, c in bad:
            nodes[k] = np.delete(nodes[k], c, axis=0)


def _cut(step: Array, most: float) -> Array:
    longest = float(np.max(np.abs(step), initial=0.0))
    return step if longest <= most else step * (most / longest)
