"""A lower bound of the time of tours, over all orders, configurations and motions.

Between two stations no leg is faster than the slowest joint between the ranges of its
positions at the two goals; a leg from a configuration is no faster than the lower bound
of a single motion (:func:`~tominpmp.bounds.lower_bound`). In any order each station is
entered and left once, so that a minimum spanning tree with one more edge (a 1-tree,
Held and Karp 1970) of these times bounds the tour; for few stations the best order
itself is found. Dwell times are added.
"""

from __future__ import annotations

from contextlib import suppress
from itertools import permutations

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from tominpmp.arrays import Array, IntArray
from tominpmp.bounds.lower_bound import lower_bound
from tominpmp.bounds.result import LowerBound
from tominpmp.cell.tours.legs import JointTimes
from tominpmp.cell.tours.orders import exact_order
from tominpmp.cell.tours.station import TourTask, least_stays
from tominpmp.exceptions import ProblemError, quiet
from tominpmp.goals.base import Goal
from tominpmp.goals.joints import JointGoal

# Steps of the ascent on the multipliers of the 1-tree.
ASCENT = 300
# Largest number of stations for which the best order of the bounds is found.
MOST_EXACT = 11
# Largest numbers of legs between configurations, and from configurations to frames, for
# which the lower bound of a single motion is computed; for a frame it takes 0.3 s.
MOST_LEGS, MOST_FRAMES = 400, 8
# Share by which the bound is lowered for rounding.
ROUNDING = 1e-9


def tour_bound(task: TourTask) -> LowerBound:
    """Lower bound for the duration of every tour."""
    least, stations, rules = _least_times(task), task.stations, task.rules
    stays = least_stays(task.problem.robot, [(s.goal, s.dwell) for s in stations])
    if len(stations) <= MOST_EXACT:
        reason, sizes = "the best order", [1] * len(stations)
        total = exact_order(sizes, lambda i, j: least[i : i + 1, j : j + 1], rules)[0]
        total = total if np.isfinite(total) else 0.0
    else:
        reason, total = "a 1-tree", _one_tree(np.minimum(least, least.T), rules.ends)
    return LowerBound(
        total * (1.0 - ROUNDING) + stays,
        f"{reason} of the lower bounds of the legs, and all dwells",
    )


def _least_times(task: TourTask) -> Array:
    """Lower bounds of the times of legs between start, stations and end.

    Returns:
        Times [s], shape (m, m): from the place of the row to the place of the column.
    """
    problem, stations, rules = task.problem, task.stations, task.rules
    q_end = np.asarray(problem.goal.configuration)
    start, end = JointGoal(problem.q_start), JointGoal(q_end)
    goals: list[Goal] = rules.along(start, (s.goal for s in stations), end)
    rests = rules.along(True, (station.stop for station in stations), True)
    loaded = {k for k, s in enumerate(stations, 1) if s.payload is not None}
    fixed, times = [goal.configuration for goal in goals], JointTimes.of(problem)
    # Ranges of the joints of each alternative of a goal.
    ranges = [
        [g.joint_ranges(problem.robot) for g in goal.alternatives] for goal in goals
    ]
    low, high = ([np.stack([r[k] for r in some]) for some in ranges] for k in (0, 1))
    ranged = [bool(np.any(np.isfinite(rows))) for rows in low]
    known = sum(q is not None for q in fixed)
    # Between configurations, limits of acceleration alone give nearly the whole bound.
    limited = bool(np.all(np.isfinite(times.acceleration)))
    few_joints = not limited and known**2 <= MOST_LEGS
    few_frames = known * (len(goals) - known) <= MOST_FRAMES * (1 + rules.ends)
    out = np.zeros((len(goals), len(goals)))
    last = len(goals) - rules.ends
    for i, j in permutations(range(len(goals)), 2):
        if i == last or j == 0:
            continue  # no tour leaves its end or enters its start
        begin, resting = fixed[i], int(rests[i]) + int(rests[j])
        if ranged[i] and ranged[j]:
            distance = np.maximum(low[j][None] - high[i][:, None], 0.0)
            distance = np.maximum(distance, low[i][:, None] - high[j][None])
            out[i, j] = np.min(np.max(times.of_joints(distance, resting), axis=-1))
        # Loads change the accelerations that torques allow.
        few = few_frames if fixed[j] is None else few_joints
        if few and begin is not None and resting == 2 and i not in loaded:
            # The tour has warned of goals at limits already.
            with suppress(ProblemError), quiet():
                leg = problem.with_ends(begin, goals[j])
                out[i, j] = max(out[i, j], lower_bound(leg).T)
    out[:, 0], out[last:] = out[0], out[:, last:].T
    return out


def _one_tree(least: Array, ends: bool) -> float:
    """Bound by 1-trees, with multipliers that bring all degrees towards two."""
    if not ends:
        # A path with an open end is a spanning tree.
        return _spanning_tree(least)[0]
    # Start and end are merged into one place, with one leg out and one leg in.
    cost = least[:-1, :-1].copy()
    cost[0, 1:] = cost[1:, 0] = np.minimum(least[0, 1:-1], least[1:-1, -1])
    weights, best = np.zeros(len(cost)), 0.0
    step = 0.1 * float(np.mean(cost))
    for _ in range(ASCENT):
        shifted = cost + weights[:, None] + weights[None]
        total, degree = _spanning_tree(shifted[1:, 1:])
        two = np.argsort(shifted[0, 1:], kind="stable")[:2] + 1
        total += float(np.sum(shifted[0, two]))
        best = max(best, total - 2.0 * float(np.sum(weights)))
        off = np.concatenate([[0], degree - 2])
        off[two] += 1
        if not np.any(off):
            break
        weights = weights + step * off
        step *= 0.985
    return best


def _spanning_tree(cost: Array) -> tuple[float, IntArray]:
    """Length of the minimum spanning tree, and the degrees of the places."""
    # SciPy takes a time of zero as a missing edge.
    shift = 1.0 - float(np.min(cost))
    tree = minimum_spanning_tree(cost + shift).tocoo()
    ends = np.concatenate([tree.row, tree.col])
    degree = np.bincount(ends, minlength=len(cost))
    return float(np.sum(tree.data)) - shift * tree.nnz, degree
