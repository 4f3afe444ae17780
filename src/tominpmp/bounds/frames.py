"""Bounds from the motion of a frame to its goal, as its joints carry it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.least_time import last_bracket
from tominpmp.bounds.result import LowerBound
from tominpmp.collision.placements import Placements
from tominpmp.goals.base import Goal
from tominpmp.kinematics import FrameMotions, RobotKinematics, prismatic_joints
from tominpmp.problem.problem import Problem
from tominpmp.stopping import check

# Largest number of boxes of configurations in a proof that a frame cannot be at its
# goal at a time, and steps of the searches for the times of its arrival and its turn.
MAX_BOXES = 128
BISECTIONS = 5
TURNING_BISECTIONS = 40
# Tolerance of the final place: goals out of reach by less have a finite bound [m or
# rad].
ACCEPTED = 1e-3
# Shortest and longest time of the searches [s].
SHORTEST, LONGEST = 1e-2, 100.0

# Largest displacement of each joint in a time, shape (n,).
Reach = Callable[[float], Array]


def frame_bounds(
    problem: Problem, goal: Goal, frame: str, reach: Reach, longest: float
) -> list[LowerBound]:
    """Bounds for a goal on a frame.

    Args:
        problem: The problem.
        goal: The goal.
        frame: Name of the frame.
        reach: Largest displacement of each joint in a time.
        longest: Longest time of the search [s].
    """
    found, longest = [], min(longest, LONGEST)
    place = RobotKinematics(problem.robot).placement(problem.q_start, frame)
    angle = goal.angle_to_go(np.asarray(place.rotation))
    if angle > ACCEPTED:
        # Less may be rounding, and an arm of sliding joints turns no frame.
        T = _turning_time(problem, frame, angle, reach, longest)
        found.append(LowerBound(T, f"frame {frame} has {angle:.4g} rad to turn"))
    if goal.distances(np.zeros((1, 3))) is not None:
        T = _carrying_time(problem, goal, frame, reach, longest)
        reason = f"no sooner do the joints carry frame {frame} there"
        found.append(LowerBound(T, reason))
    return found


def tool_speed_bounds(problem: Problem, goal: Goal) -> list[LowerBound]:
    """Bounds from limits of the speed of frames, along straight lines.

    Args:
        problem: The problem.
        goal: One of its goals.
    """
    kinematics, found = RobotKinematics(problem.robot), []
    for frame, top in filter(None, (item.top_speed for item in problem.constraints)):
        begin = np.asarray(kinematics.placement(problem.q_start, frame).translation)
        if goal.configuration is not None:
            end = kinematics.placement(goal.configuration, frame).translation
            far = float(np.linalg.norm(end - begin))
        else:
            asked = [item for item in goal.members if item.frame_name == frame]
            apart = [item.distances(begin[None]) for item in asked]
            far = max((float(row[0]) for row in apart if row is not None), default=0.0)
        if far > 0.0:
            reason = f"frame {frame} has {far:.4g} m to go, at {top:.4g} m/s at most"
            found.append(LowerBound(far / top, reason))
    return found


def _turning_time(
    problem: Problem, frame: str, angle: float, reach: Reach, longest: float
) -> float:
    """Time in which the joints cannot turn a frame by an angle."""
    robot, model = problem.robot, problem.robot.model
    turns = np.zeros(model.nv)
    for joint in model.supports[model.frames[robot.frame_id(frame)].parentJoint]:
        item = model.joints[joint]
        if joint > 0 and not str(item.shortname()).startswith("JointModelP"):
            turns[item.idx_v] = 1.0
    share = np.abs(robot.expand_tangent(np.eye(robot.n))) @ turns
    turning = share > 0.0
    ways = share[turning]

    def excluded(T: float) -> bool:
        return float(ways @ reach(T)[turning]) < angle

    return last_bracket(excluded, SHORTEST, longest, TURNING_BISECTIONS)[0]


def _carrying_time(
    problem: Problem, goal: Goal, frame: str, farthest: Reach, longest: float
) -> float:
    """Largest time found within which no motion brings a frame to its goal."""
    robot, q, limits = problem.robot, problem.q_start, problem.robot.limits
    item = robot.model.frames[robot.frame_id(frame)]
    place = np.array([item.parentJoint]), np.array([item.placement.translation])
    placements, frames = Placements(robot.model), FrameMotions(robot, frame)
    spread = np.abs(robot.expand_tangent(np.eye(robot.n)))
    slides = prismatic_joints(robot)
    if not np.any(np.isfinite(farthest(1.0))):
        return 0.0

    def excluded(T: float) -> bool:
        """Whether a proof excludes that the frame is at its goal before a time."""
        swing = farthest(T)
        # Joints without a limit may be anywhere; turning ones need one turn.
        free = ~np.isfinite(swing)
        if np.any(slides & free):
            return False
        swing = np.where(free, math.pi, swing)
        low = np.maximum(q - swing, np.minimum(limits.position_lower, q))
        high = np.minimum(q + swing, np.maximum(limits.position_upper, q))
        middle, half = 0.5 * (low + high)[None], 0.5 * (high - low)[None]
        for _ in range(MAX_BOXES):
            check()
            box = robot.expand(middle), half @ spread
            shifts = placements.displacements(*box, *place, np.zeros(1))[:, 0]
            apart = goal.distances(frames.placements(middle).origin)
            near = np.asarray(apart) <= np.sum(shifts, axis=1) + ACCEPTED
            if not near.any():
                return True
            if 2 * int(near.sum()) > MAX_BOXES:
                return False
            share = np.abs(robot.reduce_tangent(shifts[near]))
            middle, half = _halves(middle[near], half[near], share)
        return False

    return last_bracket(excluded, SHORTEST, longest, BISECTIONS)[0]


def _halves(q: Array, half: Array, shares: Array) -> tuple[Array, Array]:
    """Cut boxes across the joints of the largest shares: middles, and half edges."""
    widest = np.eye(q.shape[1])[np.argmax(shares, axis=1)]
    half = half * (1.0 - 0.5 * widest)
    step = half * widest
    return np.concatenate([q - step, q + step]), np.concatenate([half, half])
