"""What goals on frames ask for, exactly: for many configurations at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.goals.base import Goal
from tominpmp.goals.direction import across
from tominpmp.goals.frames import AxisGoal, PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal

# Goals that differ by less are at one place [rad or m].
SAME_PLACE = 1e-6


class FrameTarget(NamedTuple):
    """Where a frame is to be, without tolerances.

    Attributes:
        place: Position, shape (3,) [m].
        turn: Orientation, shape (3, 3); of a direction the axis in the frame in its
            first row, the direction in the second.
        counts: What counts of a turn above a shift, shape (6, 6).
        posed: Whether all of the orientation is asked for.
    """

    place: Array
    turn: Array
    counts: Array
    posed: bool


def frame_target(goal: Goal) -> FrameTarget | None:
    """Where a goal wants its frame; None for goals of other kinds."""
    counts, turn, place = np.zeros((6, 6)), np.zeros((3, 3)), np.zeros(3)
    if isinstance(goal, PoseGoal):
        counts[:] = np.eye(6)
        place, turn = np.array(goal.pose.translation), np.array(goal.pose.rotation)
        return FrameTarget(place, turn, counts, True)
    if isinstance(goal, PositionGoal):
        counts[3:, 3:] = np.eye(3)
        return FrameTarget(np.array(goal.position), turn, counts, False)
    if isinstance(goal, AxisGoal):
        counts[:2, :3] = across(np.array(goal.direction))
        turn[0], turn[1] = goal.axis, goal.direction
        if goal.position is not None:
            counts[3:, 3:] = np.eye(3)
            place = np.array(goal.position)
        return FrameTarget(place, turn, counts, False)
    return None


def place_of(goal: Goal) -> object:
    """What is equal for goals at one place, but for rounding."""

    def rounded(*values: Array | None) -> tuple[object, ...]:
        return tuple(
            None if x is None else tuple(np.round(np.ravel(x) / SAME_PLACE).tolist())
            for x in values
        )

    if isinstance(goal, JointGoal):
        return (JointGoal, *rounded(goal.q))
    if isinstance(goal, PoseGoal):
        return (PoseGoal, goal.frame, *rounded(goal.pose.homogeneous))
    if isinstance(goal, PositionGoal):
        return (PositionGoal, goal.frame, *rounded(goal.position))
    if isinstance(goal, AxisGoal):
        numbers = rounded(goal.axis, goal.direction, goal.position)
        return (AxisGoal, goal.frame, *numbers)
    return goal
