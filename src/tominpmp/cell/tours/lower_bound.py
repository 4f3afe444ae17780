"""A time that no tour beats, whatever its order, configurations and motions.

Between two stations no leg is faster than the joints can carry what the goals ask for:
of two configurations the time of the slowest joint; of goals on frames, the time in
which joints bring the frame as far as the stations are apart. In any order each station
is entered and left once, so that a shortest spanning tree with one more edge (a 1-tree,
Held and Karp 1970) of these times bounds the tour; for few stations the best order
itself is found. Stays are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import cdist

from tominpmp.arrays import Array, IntArray
from tominpmp.bounds import LowerBound, lower_bound
from tominpmp.cell.tours.legs import JointTimes
from tominpmp.cell.tours.orders import exact_order
from tominpmp.cell.tours.station import Rules, Station, least_stays
from tominpmp.exceptions import ProblemError
from tominpmp.goals import Goal, JointGoal
from tominpmp.kinematics import RobotKinematics
from tominpmp.problem import Problem
from tominpmp.robot import Robot

# Halvings of intervals of times, and the longest time [s].
HALVINGS = 50
LONGEST = 1e4


def frame_times(
    robot: Robot, times: JointTimes, goals: Sequence[Goal], rests: Sequence[bool]
) -> Array:
    """Least times between goals on frames, of any configurations that meet them.

    While the joints go from one configuration to another, a frame comes no farther than
    each joint turns times how far the frame is from its axis, at the most: along the
    straight line between both, too, which no motion undercuts in any joint.

    Args:
        robot: The robot.
        times: Limits of its joints.
        goals: The goals.
        rests: Whether the arm is at rest at each.

    Returns:
        Times [s], shape (m, m); zero where nothing is known.
    """
    m = len(goals)
    out = np.zeros((m, m))
    resting = np.add.outer(np.array(rests, dtype=int), np.array(rests, dtype=int))
    names = {a.frame_name for goal in goals for a in goal.alternatives}
    for name in sorted(name for name in names if name is not None):
        apart = _distances(robot, goals, name)
        levers = _levers(robot, name)
        for count in range(3):
            which = (resting == count) & (apart > 0.0)
            if np.any(which):
                found = _carrying_times(times, apart[which], levers, count)
                out[which] = np.maximum(out[which], found)
    np.fill_diagonal(out, 0.0)
    return out


def _distances(robot: Robot, goals: Sequence[Goal], frame: str) -> Array:
    """How far a frame has to go between goals at least, shape (m, m) [m]."""
    kinematics = RobotKinematics(robot)
    owner, centre, radius = list[int](), list[Array](), list[float]()
    for g, goal in enumerate(goals):
        for one in goal.alternatives:
            # It may be anywhere, unless the goal says where.
            point, around = np.zeros(3), np.inf
            if one.configuration is not None:
                place = kinematics.placement(one.configuration, frame)
                point, around = np.array(place.translation), 0.0
            elif one.frame_name == frame and one.ball is not None:
                point, around = np.array(one.ball.centre), one.ball.radius
            owner.append(g)
            centre.append(point)
            radius.append(around)
    way = cdist(centre, centre) - np.add.outer(radius, radius)
    out = np.full((len(goals), len(goals)), np.inf)
    np.minimum.at(out, np.ix_(owner, owner), way)
    return np.asarray(np.maximum(out, 0.0))


def _carrying_times(
    times: JointTimes, way: Array, levers: Array, resting: int
) -> Array:
    """Least times by which joints, at their levers, cover ways, shape (k,) both."""
    if not np.any(levers > 0.0):
        return np.zeros_like(way)
    low, high = np.zeros_like(way), np.full_like(way, LONGEST)
    for _ in range(HALVINGS):
        T = 0.5 * (low + high)
        near = _covered(times, T, levers, resting) < way
        low, high = np.where(near, T, low), np.where(near, high, T)
    return low


def _covered(times: JointTimes, T: Array, levers: Array, resting: int) -> Array:
    """Farthest that a point gets in times, shape (k,) [m]."""
    v, a, T = times.velocity, times.acceleration, T[:, None]
    way = v * T
    if resting:
        finite = np.isfinite(a)
        top = np.where(finite, a, 1.0)
        # Up to the speed limit, or as long as there is time to slow down.
        ramp = np.minimum(resting * v / top, T)
        limited = top * ramp * (T - 0.5 * ramp) / resting
        way = np.where(finite, limited, way)
    used = levers > 0.0
    return np.asarray(np.sum(way[:, used] * levers[used], axis=1))


def _levers(robot: Robot, frame: str) -> Array:
    """How far a frame is from the axis of each joint at the most, shape (n,).

    Both are on one chain, and no farther apart than its links are long; where a joint
    slides, the frame goes as far as the joint: 1.
    """
    model = robot.model
    item = model.frames[robot.frame_id(frame)]
    levers = np.zeros(model.nv)
    ahead = float(np.linalg.norm(item.placement.translation))
    for j in reversed([j for j in model.supports[item.parentJoint] if j]):
        joint = model.joints[j]
        slide = str(joint.shortname()).startswith("JointModelP")
        levers[joint.idx_v] = 1.0 if slide else ahead
        ahead += float(np.linalg.norm(model.jointPlacements[j].translation))
        if slide:
            range_of = model.lowerPositionLimit, model.upperPositionLimit
            ahead += max(abs(float(limit[joint.idx_q])) for limit in range_of)
    S = robot.expansion_matrix
    return levers if S is None else np.asarray(levers @ np.abs(S))


# Steps of the ascent on the multipliers of the 1-tree.
ASCENT = 300
# Stations for which the best order of the bounds is found.
FEW = 11
# Pairs of configurations whose bound takes torques into account, if it has to.
MOST_PAIRS = 400
# Share by which the bound is lowered for rounding.
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
    ends = q_end is not None
    if len(stations) <= FEW:
        reason, ones = "the best order", [1] * len(stations)
        total = exact_order(
            ones, lambda i, j: least[i : i + 1, j : j + 1], rules, ends
        )[0]
        total = total if np.isfinite(total) else 0.0
    else:
        reason, total = "a 1-tree", _one_tree(np.minimum(least, least.T), ends)
    return LowerBound(
        total * (1.0 - ROUNDING) + stays,
        f"{reason} of the times that no leg can beat, and all stays",
    )


def _least_times(
    problem: Problem, stations: Sequence[Station], q_end: Array | None
) -> Array:
    """Times that no leg between two places beats: start, stations, end."""
    end = [] if q_end is None else [JointGoal(q_end)]
    goals: list[Goal] = [JointGoal(problem.q_start), *(s.goal for s in stations), *end]
    rests = [True, *(station.stop for station in stations), *(True for _ in end)]
    loaded = {k for k, s in enumerate(stations, 1) if s.payload is not None}
    times = JointTimes.of(problem)
    out = frame_times(problem.robot, times, goals, rests)
    # Ranges of the joints of each alternative of a goal.
    ranges = [
        [g.joint_ranges(problem.robot) for g in goal.alternatives] for goal in goals
    ]
    low, high = ([np.stack([r[k] for r in some]) for some in ranges] for k in (0, 1))
    told = [bool(np.any(np.isfinite(rows))) for rows in low]
    sharp = _torques_count(problem, goals)
    for i, j in permutations(range(len(goals)), 2):
        if not (told[i] and told[j]):
            continue
        resting = int(rests[i]) + int(rests[j])
        way = np.maximum(low[j][None] - high[i][:, None], 0.0)
        way = np.maximum(way, low[i][:, None] - high[j][None])
        way = np.where(np.isfinite(way), way, 0.0)
        each = np.max(times.of_joints(way, resting), axis=-1, initial=0.0)
        out[i, j] = max(float(np.min(each)), float(out[i, j]))
        # Loads change the accelerations that torques allow.
        if sharp and resting == 2 and i not in loaded:
            out[i, j] = max(out[i, j], _by_torques(problem, goals[i], goals[j]))
    return out


def _torques_count(problem: Problem, goals: Sequence[Goal]) -> bool:
    """Whether torques are worth a look: limits of acceleration say nearly all."""
    limits, given = problem.motion_limits, [g.configuration is not None for g in goals]
    return (
        not np.all(np.isfinite(JointTimes.of(problem).acceleration))
        and sum(given) ** 2 <= MOST_PAIRS
        and (limits is None or not limits.continuous)
    )


def _by_torques(problem: Problem, goal: Goal, other: Goal) -> float:
    """Time that no motion between two configurations beats, torques included."""
    begin, end = goal.configuration, other.configuration
    if begin is None or end is None:
        return 0.0
    try:
        return lower_bound(problem.with_ends(begin, JointGoal(end))).T
    except ProblemError:
        return 0.0


def _one_tree(least: Array, ends: bool) -> float:
    """Bound by trees, with multipliers that make them look like circles."""
    if not ends:
        # A way that ends anywhere is a tree that spans all places.
        return _spanning_tree(least)[0]
    # Start and end are one place, left by one of its legs and entered by the other.
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
    """Length of the shortest spanning tree, and the degrees of the places."""
    # For SciPy a time of zero is no edge.
    shift = 1.0 - float(np.min(cost))
    tree = minimum_spanning_tree(cost + shift).tocoo()
    ends = np.concatenate([tree.row, tree.col])
    degree = np.bincount(ends, minlength=len(cost))
    return float(np.sum(tree.data)) - shift * tree.nnz, degree
