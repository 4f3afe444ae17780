"""Least times in which the joints carry a frame from one place to another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tominpmp.arrays import Array
from tominpmp.cell.tours.joint_times import JointTimes
from tominpmp.goals import Goal
from tominpmp.kinematics import RobotKinematics, prismatic_joints
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
    centre, radius, owner = [], [], []
    for g, goal in enumerate(goals):
        for one in goal.alternatives:
            if one.configuration is not None:
                place = kinematics.placement(one.configuration, frame)
                centre.append(np.array(place.translation))
                radius.append(0.0)
            elif one.frame_name == frame and one.ball is not None:
                centre.append(np.array(one.ball.centre))
                radius.append(one.ball.radius)
            else:
                # It may be anywhere.
                centre.append(np.zeros(3))
                radius.append(np.inf)
            owner.append(g)
    points, around, of = np.array(centre), np.array(radius), np.array(owner)
    out = np.full((len(goals), len(goals)), np.inf)
    for k, point in enumerate(points):
        way = np.linalg.norm(points - point, axis=1) - around - around[k]
        np.minimum.at(out[of[k]], of, way)
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
        with np.errstate(invalid="ignore"):
            short = 0.5 * top * T * T / resting
            long = v * np.maximum(T - 0.5 * resting * v / top, 0.0)
            limited = np.where(T * top < resting * v, short, long)
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
    low, high = robot.limits.position_lower, robot.limits.position_upper
    S = robot.expansion_matrix
    S = np.eye(robot.n) if S is None else S
    offset = 0.0 if robot.expansion_offset is None else robot.expansion_offset
    widest = np.where(prismatic_joints(robot), np.maximum(np.abs(low), np.abs(high)), 0)
    slides = np.abs(S) @ widest + np.abs(offset)
    levers = np.zeros(model.nv)
    ahead = float(np.linalg.norm(item.placement.translation))
    for j in reversed([j for j in model.supports[item.parentJoint] if j]):
        joint = model.joints[j]
        slide = str(joint.shortname()).startswith("JointModelP")
        levers[joint.idx_v] = 1.0 if slide else ahead
        ahead += float(np.linalg.norm(model.jointPlacements[j].translation))
        ahead += float(slides[joint.idx_v]) if slide else 0.0
    return np.asarray(levers @ np.abs(S))
