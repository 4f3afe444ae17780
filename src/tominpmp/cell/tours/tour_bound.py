"""A time that no tour beats, whatever its order, configurations and motions.

Between two stations no leg is faster than the joints can carry what the goals ask for:
of two configurations the time of the slowest joint; of goals on frames, the time in
which joints bring the frame as far as the stations are apart. In any order each station
is entered and left once, so that a shortest spanning tree with one more edge (a 1-tree,
Held and Karp 1970) of these times bounds the tour, as does the best assignment of
successors; for few stations the best order itself is found. Stays are added.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from tominpmp.arrays import Array
from tominpmp.bounds import LowerBound, lower_bound
from tominpmp.cell.tours.arms import least_stays
from tominpmp.cell.tours.exact_order import exact_order
from tominpmp.cell.tours.frame_times import frame_times
from tominpmp.cell.tours.joint_times import JointTimes
from tominpmp.cell.tours.leg_table import LegTable
from tominpmp.cell.tours.station import Rules, Station
from tominpmp.exceptions import ProblemError
from tominpmp.goals import Goal, JointGoal
from tominpmp.problem import Problem
from tominpmp.robot import Robot

# Steps of the ascent on the multipliers of the 1-tree.
ASCENT = 300
# Stations for which the best order of the bounds is found.
FEW = 11
# Pairs of configurations whose bound takes torques into account, if it has to.
MOST_PAIRS = 400
# What is granted to rounding, as a share.
ROUNDING = 1e-9


def tour_bound(
    problem: Problem,
    stations: Sequence[Station],
    rules: Rules,
    q_end: Array | None,
) -> LowerBound:
    """Bound the duration of every tour.

    Args:
        problem: Robot, start and limits.
        stations: The stations.
        rules: Orders that are allowed.
        q_end: Configuration at the end, shape (n,) [rad or m]; None for any.
    """
    least = _least_times(problem, stations, q_end)
    stays = least_stays(problem.robot, [(s.goal, s.dwell) for s in stations])
    found = [
        LowerBound(_assigned(least, rules, q_end is not None), "an assignment"),
        LowerBound(
            _one_tree(np.minimum(least, least.T), q_end is not None), "a 1-tree"
        ),
    ]
    if len(stations) <= FEW:
        best = _best_order(least, rules, q_end is not None)
        found.append(LowerBound(best, "the best order"))
    best_of = max(found, key=lambda bound: bound.T)
    return LowerBound(
        best_of.T * (1.0 - ROUNDING) + stays,
        f"{best_of.reason} of the times that no leg can beat, and all stays",
    )


def _least_times(
    problem: Problem, stations: Sequence[Station], q_end: Array | None
) -> Array:
    """Times that no leg between two places beats: start, stations, end."""
    goals: list[Goal] = [JointGoal(problem.q_start), *(s.goal for s in stations)]
    rests = [True, *(station.stop for station in stations)]
    if q_end is not None:
        goals.append(JointGoal(q_end))
        rests.append(True)
    n = len(goals)
    out = np.zeros((n, n))
    times, joints = JointTimes.of(problem), problem.robot
    ranges = [_ranges(goal, joints) for goal in goals]
    low = [np.stack([lo for lo, _ in r]) for r in ranges]
    high = [np.stack([hi for _, hi in r]) for r in ranges]
    frames = frame_times(problem.robot, times, goals, rests)
    sharp = _Sharp(problem, goals)
    told = [bool(np.any(np.isfinite(rows))) for rows in low]
    for i in range(n):
        for j in range(n):
            if i == j:
                continue
            if not (told[i] and told[j]):
                out[i, j] = frames[i, j]
                continue
            resting = int(rests[i]) + int(rests[j])
            way = np.maximum(low[j][None] - high[i][:, None], 0.0)
            way = np.maximum(way, low[i][:, None] - high[j][None])
            way = np.where(np.isfinite(way), way, 0.0)
            each = np.max(times.of_joints(way, resting), axis=-1, initial=0.0)
            out[i, j] = max(float(np.min(each)), float(frames[i, j]))
            # What is carried changes what torques can do.
            loaded = 0 < i <= len(stations) and stations[i - 1].payload is not None
            if resting == 2 and not loaded:
                out[i, j] = max(out[i, j], sharp.between(i, j))
    return out


def _ranges(goal: Goal, robot: Robot) -> list[tuple[Array, Array]]:
    """Ranges of the joints of each alternative of a goal."""
    return [one.joint_ranges(robot) for one in goal.alternatives]


class _Sharp:
    """Bounds between configurations that take torques into account."""

    def __init__(self, problem: Problem, goals: Sequence[Goal]) -> None:
        self.problem, self.goals = problem, goals
        given = [g.configuration is not None for g in goals]
        limits = problem.motion_limits
        accelerations = JointTimes.of(problem).acceleration
        # Where accelerations are limited, they say nearly all there is to say.
        self.on = (
            not np.all(np.isfinite(accelerations))
            and sum(given) ** 2 <= MOST_PAIRS
            and (limits is None or not limits.continuous)
        )

    def between(self, i: int, j: int) -> float:
        """Time that no motion between two goals beats."""
        begin, end = self.goals[i].configuration, self.goals[j].configuration
        if not self.on or begin is None or end is None:
            return 0.0
        try:
            leg = self.problem.with_ends(begin, JointGoal(end))
        except ProblemError:
            return 0.0
        return lower_bound(leg).T


def _assigned(least: Array, rules: Rules, ends: bool) -> float:
    """Cheapest successors of all places, circles allowed."""
    cost = _closed(least, ends)
    n = rules.count
    big = 1.0 + 1e3 * float(np.max(cost))
    cost = cost.copy()
    np.fill_diagonal(cost, big)
    for i, j in rules.before:
        cost[j + 1, i + 1] = big
        cost[0, j + 1] = big
    for i, allowed in rules.then.items():
        for j in range(n):
            if j not in allowed:
                cost[i + 1, j + 1] = big
    rows, columns = linear_sum_assignment(cost)
    total = float(np.sum(cost[rows, columns]))
    return total if total < big else 0.0


def _closed(least: Array, ends: bool) -> Array:
    """Times of a circle: the end and the start taken as one place."""
    if not ends:
        circle = least.copy()
        circle[:, 0] = 0.0
        return circle
    circle = least[:-1, :-1].copy()
    circle[1:, 0] = least[1:-1, -1]
    return circle


def _one_tree(least: Array, ends: bool) -> float:
    """Bound by trees, with multipliers that make them look like circles."""
    n = len(least) - ends
    if n < 4:
        return 0.0
    if not ends:
        # A way that ends anywhere is a tree that spans all places.
        return _spanning_tree(least)[0]
    cost = least[:-1, :-1].copy()
    home = least[1:-1, -1]
    # Start and end are one place, left by one of its legs and entered by the other.
    depart = least[0, 1:-1]
    cost[0, 1:] = cost[1:, 0] = np.minimum(depart, home)
    weights, best = np.zeros(n), 0.0
    step = 0.1 * float(np.mean(cost))
    for _ in range(ASCENT):
        shifted = cost + weights[:, None] + weights[None]
        total, degree = _tree(shifted)
        best = max(best, total - 2.0 * float(np.sum(weights)))
        off = degree - 2
        if not np.any(off):
            break
        weights = weights + step * off
        step *= 0.985
    return best


def _tree(cost: Array) -> tuple[float, Array]:
    """Shortest tree over all places but the first, and the two edges of that."""
    total, degree = _spanning_tree(cost[1:, 1:])
    degree = np.concatenate([[2], degree])
    two = np.argsort(cost[0, 1:], kind="stable")[:2]
    degree[two + 1] += 1
    return total + float(np.sum(cost[0, 1:][two])), degree


def _spanning_tree(cost: Array) -> tuple[float, Array]:
    """Shortest spanning tree (Prim): its length and the degrees of the places."""
    n = len(cost)
    degree = np.zeros(n, dtype=int)
    inside = np.zeros(n, dtype=bool)
    inside[0] = True
    near, parent = cost[0].copy(), np.zeros(n, dtype=int)
    near[0] = np.inf
    total = 0.0
    for _ in range(n - 1):
        k = int(np.argmin(near))
        total += float(near[k])
        degree[k] += 1
        degree[parent[k]] += 1
        inside[k] = True
        closer = (cost[k] < near) & ~inside
        near[closer], parent[closer] = cost[k][closer], k
        near[k] = np.inf
    return total, degree


def _best_order(least: Array, rules: Rules, ends: bool) -> float:
    """The best order for these times."""
    nodes = [np.array([[float(i)]]) for i in range(len(least))]
    one = np.ones(1)
    table = LegTable(nodes, [True] * len(nodes), JointTimes(one, one, one), ends)
    for i in range(len(least)):
        for j in range(len(least)):
            if i != j:
                table.learn((i, 0, j, 0), float(least[i, j]))
    total = exact_order(table, rules)[0]
    return total if np.isfinite(total) else 0.0
