"""Which arm works at a station, where a robot was combined of several."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from tominpmp.arrays import Array
from tominpmp.goals import Goal
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot


def arm_at(robot: Robot, goal: Goal, q: Array) -> str | None:
    """Name of the arm that meets a goal at a configuration; None for all of them."""
    if not robot.parts:
        return None
    return arm_of(robot, goal.nearest(RobotKinematics(robot), q, np.zeros(robot.n)))


def arm_of(robot: Robot, goal: Goal) -> str | None:
    """Name of the arm that a goal is for; None where it is for all, or any."""
    names = {(one.frame_name or "").partition("/")[0] for one in goal.alternatives}
    return next(iter(names)) if len(names) == 1 and names <= set(robot.parts) else None


def together(stays: Iterable[tuple[str | None, float]]) -> float:
    """Time of stays that begin together: those of one arm come one after the other.

    Args:
        stays: Arms, None for all of them, and how long each stays [s].
    """
    every, alone = 0.0, dict[str, float]()
    for arm, stay in stays:
        if arm is None:
            every += stay
        else:
            alone[arm] = alone.get(arm, 0.0) + stay
    return every + max(alone.values(), default=0.0)


def least_stays(robot: Robot, stays: Sequence[tuple[Goal, float]]) -> float:
    """Time that no stays at stations beat, however arms share them.

    Args:
        robot: The robot.
        stays: Goals of the stations, and how long an arm stays at each [s].
    """
    if not robot.parts:
        return sum(stay for _, stay in stays)
    own, shared, every = dict[str, float](), 0.0, 0.0
    for goal, stay in stays:
        arm = arm_of(robot, goal)
        if arm is not None:
            own[arm] = own.get(arm, 0.0) + stay
        elif any(one.frame_name is not None for one in goal.alternatives):
            shared += stay
        else:
            every += stay
    even = (sum(own.values()) + shared) / len(robot.parts)
    return every + max(even, *own.values(), 0.0)
