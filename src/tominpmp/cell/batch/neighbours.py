"""Which problem of a batch begins with the motion of which other.

It is decided beforehand, by the problems alone, so that what comes out does not depend
on which plan happens to be ready first. Problems are put into an order in which each is
as far as can be from all before it; so the first ones are spread over all of them, and
the nearest of those before a problem comes nearer and nearer. They are planned in
rounds, each as large as all before it: a problem begins with the nearest motion of
former rounds, unless neighbours lead different ways.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem

# This share of the problems begins with nothing.
FIRST = 0.125
# Problems farther than this from all before them [rad or m] begin with nothing: a
# motion from elsewhere does not help.
FAR = 3.0
# How distances of obstacles count against those of joints [rad/m].
LENGTH = 2.0
# Motions of problems that are so far from each other lead one way if they differ by no
# more than this [rad or m], and this times that distance, at some instants.
TURN, STRETCH, LOOKS = 0.3, 1.0, 7


@dataclass(frozen=True, eq=False)
class Rounds:
    """In which order the problems of a batch are planned.

    Attributes:
        rounds: Numbers of the problems of each round.
        near: Numbers of the problems whose motions a problem may begin with, and how
            far they are from it, the nearest first; by the number of the problem.
    """

    rounds: tuple[IntArray, ...]
    near: dict[int, list[tuple[int, float]]]

    def start(self, number: int, motions: Mapping[int, Trajectory]) -> int | None:
        """The problem whose motion another one begins with; None for none.

        That is the nearest one which has a motion, unless the next one's leads another
        way: only a search can tell which of the ways is the faster one here.

        Args:
            number: The problem that is to begin.
            motions: What was found of others, by their numbers.
        """
        found = [item for item in self.near[number] if item[0] in motions]
        if not found:
            return None
        (first, apart), *others = found
        for second, away in others[:1]:
            ways = [_way(motions[one]) for one in (first, second)]
            if np.max(np.abs(ways[0] - ways[1])) > TURN + STRETCH * (apart + away):
                return None
        return first


def _way(motion: Trajectory) -> Array:
    """Configurations on the way, at equal shares of the time, shape (k, n)."""
    return motion(np.linspace(0.0, motion.duration, LOOKS)).q


def rounds_of(problems: Sequence[Problem | None]) -> Rounds:
    """Order the problems of a batch.

    Args:
        problems: The problems; None where there is none.
    """
    groups: defaultdict[Any, list[int]] = defaultdict(list)
    rounds: defaultdict[int, list[int]] = defaultdict(list)
    places: dict[int, Array] = {}
    near: dict[int, list[tuple[int, float]]] = {}
    for index, problem in enumerate(problems):
        key, places[index] = _place(problem)
        groups[key].append(index)
    for members in groups.values():
        table = np.array([places[index] for index in members])
        order = _spread(table)
        size = max(int(np.ceil(FIRST * len(order))), 1)
        for place, k in enumerate(order.tolist()):
            # Each round is as large as all before it, from the second one on.
            number = (place // size).bit_length()
            before = order[: size << number - 1] if number else order[:0]
            rounds[number].append(members[k])
            near[members[k]] = _nearest(table, k, before, members)
    return Rounds(tuple(np.array(sorted(rounds[k])) for k in sorted(rounds)), near)


def _nearest(
    table: Array, own: int, before: IntArray, members: list[int]
) -> list[tuple[int, float]]:
    """The problems before one that are nearest to it, three at most; how far."""
    away = np.linalg.norm(table[before] - table[own], axis=1)
    order = np.argsort(away, kind="stable")[:3]
    found = [(members[before[k]], float(away[k])) for k in order.tolist()]
    return [item for item in found if item[1] <= FAR]


def _spread(table: Array) -> IntArray:
    """An order in which each row is as far as can be from those before it."""
    away = np.linalg.norm(table - table.mean(axis=0), axis=1)
    order = [int(np.argmin(away))]
    away = np.linalg.norm(table - table[order[0]], axis=1)
    for _ in table[1:]:
        away[order] = -1.0
        order.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(table - table[order[-1]], axis=1))
    return np.array(order)


def _place(problem: Problem | None) -> tuple[Any, Array]:
    """Which problems it may be compared with, and where it is among them."""
    if problem is None or problem.segments:
        # Motions of segments do not begin with others.
        return ("alone", id(problem)), np.zeros(1)
    robot, goal, parts = problem.robot, problem.goal, [problem.q_start]
    if goal.configuration is not None:
        parts.append(goal.configuration)
    elif goal.ball is not None:
        parts.append(LENGTH * goal.ball.centre)
    parts += [LENGTH * item.position for item in problem.scene]
    obstacles = tuple(item.name for item in problem.scene)
    key = robot.joint_names, robot.name, type(goal).__name__, goal.frame_name, obstacles
    return key, np.concatenate(parts)
