"""Lower bounds from the distance of a frame to its goal, and its fastest motion."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.least_time import last_bracket
from tominpmp.bounds.result import LowerBound
from tominpmp.goals.base import Goal
from tominpmp.kinematics import FrameMotions, RobotKinematics, prismatic_joints
from tominpmp.problem.problem import Problem
from tominpmp.stopping import check

# Largest number of boxes of configurations in a proof that a frame cannot be at its
# goal at a time, and numbers of bisections for the least times of its translation and
# its rotation.
MAX_BOXES = 128
BISECTIONS = 5
TURNING_BISECTIONS = 40
# Tolerance of the final pose: goals that are out of reach by less have a finite bound
# [m or rad].
POSE_TOLERANCE = 1e-3
# First and largest time of the searches [s].
SHORTEST, LONGEST = 1e-2, 100.0

# Function from a time to the largest displacement of each joint in it, shape (n,).
ReachInTime = Callable[[float], Array]


def frame_bounds(
    problem: Problem, goal: Goal, frame: str, reach: ReachInTime, longest: float
) -> list[LowerBound]:
    """Bounds for a goal on a frame, from its rotation and from its translation.

    Args:
        problem: The problem.
        goal: The goal.
        frame: Name of the frame.
        reach: Largest displacement of each joint in a time.
        longest: Largest time of the search [s].
    """
    bounds, longest = [], min(longest, LONGEST)
    place = RobotKinematics(problem.robot).placement(problem.q_start, frame)
    angle = goal.angle_to_go(np.asarray(place.rotation))
    if angle > POSE_TOLERANCE:
        # A smaller angle may be rounding, and prismatic joints cannot turn a frame.
        T = _turning_time(problem, frame, angle, reach, longest)
        bounds.append(LowerBound(T, f"frame {frame} has {angle:.4g} rad to turn"))
    if goal.distances(np.zeros((1, 3))) is not None:
        T = _carrying_time(problem, goal, frame, reach, longest)
        reason = f"the joints cannot bring frame {frame} there sooner"
        bounds.append(LowerBound(T, reason))
    return bounds


def tool_speed_bounds(problem: Problem, goal: Goal) -> list[LowerBound]:
    """Bounds from speed limits of frames, along straight lines.

    Args:
        problem: The problem.
        goal: The goal, or one of its alternatives.
    """
    kinematics, bounds = RobotKinematics(problem.robot), []
    for frame, top in filter(None, (item.top_speed for item in problem.constraints)):
        begin = np.asarray(kinematics.placement(problem.q_start, frame).translation)
        if goal.configuration is not None:
            end = kinematics.placement(goal.configuration, frame).translation
            far = float(np.linalg.norm(end - begin))
        else:
            on_frame = [item for item in goal.members if item.frame_name == frame]
            apart = [item.distances(begin[None]) for item in on_frame]
            far = max((float(row[0]) for row in apart if row is not None), default=0.0)
        reason = f"frame {frame} has {far:.4g} m to go, at {top:.4g} m/s at most"
        bounds.append(LowerBound(far / top, reason))
    return bounds


def _turning_time(
    problem: Problem, frame: str, angle: float, reach: ReachInTime, longest: float
) -> float:
    """Largest time in which the joints cannot turn a frame by an angle [s]."""
    robot, placements = problem.robot, problem.checker.placements
    carrier = robot.model.frames[robot.frame_id(frame)].parentJoint
    revolute = placements.moves[carrier] & np.any(placements.turn[1:], axis=1)
    share = np.abs(robot.expand_tangent(np.eye(robot.n))) @ revolute
    turning = share > 0.0
    shares = share[turning]

    def excluded(T: float) -> bool:
        """Whether the joints turn the frame by less than the angle in a time."""
        return float(shares @ reach(T)[turning]) < angle

    return last_bracket(excluded, SHORTEST, longest, TURNING_BISECTIONS)[0]


def _carrying_time(
    problem: Problem, goal: Goal, frame: str, farthest: ReachInTime, longest: float
) -> float:
    """Largest time for which a proof shows that no motion brings a frame to its goal.

    Args:
        problem: The problem.
        goal: The goal.
        frame: Name of the frame.
        farthest: Largest displacement of each joint in a time.
        longest: Largest time of the search [s].
    """
    robot, q, limits = problem.robot, problem.q_start, problem.robot.limits
    item = robot.model.frames[robot.frame_id(frame)]
    place = np.array([item.parentJoint]), np.array([item.placement.translation])
    placements, frames = problem.checker.placements, FrameMotions(robot, frame)
    spread = np.abs(robot.expand_tangent(np.eye(robot.n)))
    slides = prismatic_joints(robot)
    if not np.any(np.isfinite(farthest(1.0))):
        return 0.0

    def excluded(T: float) -> bool:
        """Whether a proof shows that the frame is not at its goal before a time."""
        reach = farthest(T)
        # A joint without a limit may be anywhere; for a revolute joint half a turn to
        # either side covers all placements.
        free = ~np.isfinite(reach)
        if np.any(slides & free):
            return False
        reach = np.where(free, math.pi, reach)
        low = np.maximum(q - reach, np.minimum(limits.position_lower, q))
        high = np.minimum(q + reach, np.maximum(limits.position_upper, q))
        middle, half = 0.5 * (low + high)[None], 0.5 * (high - low)[None]
        for _ in range(MAX_BOXES):
            check()
            box = robot.expand(middle), half @ spread
            shifts = placements.displacements(*box, *place, np.zeros(1))[:, 0]
            apart = goal.distances(frames.placements(middle).origin)
            near = np.asarray(apart) <= np.sum(shifts, axis=1) + POSE_TOLERANCE
            if not near.any():
                return True
            if 2 * int(near.sum()) > MAX_BOXES:
                return False
            share = np.abs(robot.reduce_tangent(shifts[near]))
            middle, half = _halves(middle[near], half[near], share)
        return False

    return last_bracket(excluded, SHORTEST, longest, BISECTIONS)[0]


def _halves(q: Array, half: Array, shares: Array) -> tuple[Array, Array]:
    """Bisect boxes across the joint of the largest share: middles and half edges."""
    widest = np.eye(q.shape[1])[np.argmax(shares, axis=1)]
    half = half * (1.0 - 0.5 * widest)
    step = half * widest
    return np.concatenate([q - step, q + step]), np.concatenate([half, half])
