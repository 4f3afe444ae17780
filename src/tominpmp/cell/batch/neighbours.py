"""Warm starts between the problems of a batch: which motion each plan begins with.

The choice depends on the problems alone and is made beforehand, so that results do not
depend on the order in which plans finish. Problems are sorted by farthest-point
sampling: each is as far as possible from all before it, so that the first problems are
spread over the whole set, and later ones find ever nearer predecessors. They are
planned in rounds, each as large as all before it: a problem begins with the nearest
motion of earlier rounds, unless its two nearest neighbours take different paths.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.cell.farthest_points import spread_out
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem

# Share of comparable problems in the first round, with a cold start.
COLD_SHARE = 0.125
# Problems farther than this from all before them [rad or m] have a cold start: a motion
# of a distant problem does not help.
FAR = 3.0
# Weight of distances of obstacles relative to distances of joints [rad/m].
OBSTACLE_WEIGHT = 2.0
# Two motions take the same path if they differ at no sample by more than a constant
# [rad or m] plus a multiple of the distance of their problems; number of samples.
GAP, SLOPE, SAMPLES = 0.3, 1.0, 7


# A warm start: the number of the problem that the motion solves, and the motion.
Start = tuple[int, Trajectory]
# Numbers of the problems whose motions may be the warm start of a problem, and their
# distances, the nearest first.
Near = list[tuple[int, float]]


def nearest_start(near: Near, motions: Mapping[int, Trajectory]) -> Start | None:
    """The warm start of a problem; None for a cold one.

    It is the nearest problem that has a motion, unless the second nearest takes another
    path: only a search finds out which of two paths is the faster here.

    Args:
        near: Problems near the one to be planned.
        motions: Motions found so far, by the numbers of their problems.
    """
    solved = [item for item in near if item[0] in motions]
    if not solved:
        return None
    (first, apart), *others = solved
    for second, away in others[:1]:
        paths = [_path(motions[k]) for k in (first, second)]
        if np.max(np.abs(paths[0] - paths[1])) > GAP + SLOPE * (apart + away):
            return None
    return first, motions[first]


def _path(motion: Trajectory) -> Array:
    """Configurations of a motion, at equal shares of its time, shape (k, n)."""
    return motion(np.linspace(0.0, motion.duration, SAMPLES)).q


def rounds_of(
    problems: Sequence[Problem | None],
) -> tuple[list[list[int]], dict[int, Near]]:
    """Order the problems of a batch.

    Args:
        problems: The problems; None for a broken one.

    Returns:
        Numbers of the problems of each round; and by the number of a problem, those
        near it in earlier rounds.
    """
    groups: defaultdict[Any, dict[int, Array]] = defaultdict(dict)
    rounds: defaultdict[int, list[int]] = defaultdict(list)
    near: dict[int, Near] = {}
    for index, problem in enumerate(problems):
        key, place = _place(problem)
        groups[key][index] = place
    for group in groups.values():
        members, table = list(group), np.array(list(group.values()))
        from_middle = np.linalg.norm(table - table.mean(axis=0), axis=1)
        order = spread_out(table, int(np.argmin(from_middle)), len(table), 2)
        size = max(int(np.ceil(COLD_SHARE * len(order))), 1)
        for rank, k in enumerate(order.tolist()):
            # Each round is as large as all before it, from the second one on.
            number = (rank // size).bit_length()
            before = order[: size << number - 1] if number else order[:0]
            rounds[number].append(members[k])
            near[members[k]] = _nearest(table, k, before, members)
    return [sorted(rounds[k]) for k in sorted(rounds)], near


def _nearest(table: Array, index: int, before: IntArray, members: list[int]) -> Near:
    """The nearest of the earlier problems, three at most, with their distances."""
    away = np.linalg.norm(table[before] - table[index], axis=1)
    order = np.argsort(away, kind="stable")[:3]
    nearest = [(members[before[k]], float(away[k])) for k in order.tolist()]
    return [item for item in nearest if item[1] <= FAR]


def _place(problem: Problem | None) -> tuple[Any, Array]:
    """Key of the group of comparable problems, and coordinates of a problem in it."""
    if problem is None or problem.segments:
        # Problems of several segments take no warm start.
        return ("alone", id(problem)), np.zeros(1)
    robot, goal, parts = problem.robot, problem.goal, [problem.q_start]
    if goal.configuration is not None:
        parts.append(goal.configuration)
    elif goal.ball is not None:
        parts.append(OBSTACLE_WEIGHT * goal.ball.centre)
    parts += [OBSTACLE_WEIGHT * item.position for item in problem.scene]
    obstacles = tuple(item.name for item in problem.scene)
    key = robot.joint_names, robot.name, type(goal).__name__, goal.frame_name, obstacles
    return key, np.concatenate(parts)
