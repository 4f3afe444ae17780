"""Least times in which the joints carry a frame from one place to another."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.goals import Goal
from tominpmp.kinematics import RobotKinematics, prismatic_joints
from tominpmp.robot import Robot
from tominpmp.tours.joint_times import JointTimes


class FrameTimes:
    """Times in which joints carry a frame from one place to another."""

    def __init__(self, robot: Robot, times: JointTimes) -> None:
        self.robot, self.times = robot, times
        self._levers: dict[str, _Levers] = {}

    def between(self, one: Goal, other: Goal, resting: int) -> float:
        """Least time from a goal to another, of any configurations."""
        return min(
            self._between(a, b, resting)
            for a in one.alternatives
            for b in other.alternatives
        )

    def _between(self, one: Goal, other: Goal, resting: int) -> float:
        frame = other.frame_name or one.frame_name
        if frame is None:
            return 0.0
        here, there = (self._ball(goal, frame) for goal in (one, other))
        if here is None or there is None:
            return 0.0
        (p, r), (q, s) = here, there
        way = float(np.linalg.norm(p - q)) - r - s
        if way <= 0.0:
            return 0.0
        if frame not in self._levers:
            self._levers[frame] = _Levers(self.robot, frame)
        levers = self._levers[frame].between(p, q, r + s)
        return self._time(way, levers, resting)

    def _ball(self, goal: Goal, frame: str) -> tuple[Array, float] | None:
        """Where a frame is at a goal: centre and radius of a ball [m]."""
        if goal.configuration is not None:
            place = RobotKinematics(self.robot).placement(goal.configuration, frame)
            return np.array(place.translation), 0.0
        if goal.frame_name != frame or goal.ball is None:
            return None
        return goal.ball.centre, goal.ball.radius

    def _time(self, way: float, levers: Array, resting: int) -> float:
        """Least time by which the joints, at their levers, cover a way."""
        used = levers > 0.0
        if not np.any(used):
            return 0.0
        low, high = 0.0, 1e-3
        while self._covered(high, levers, used, resting) < way and high < 1e4:
            low, high = high, 2.0 * high
        for _ in range(40):
            T = 0.5 * (low + high)
            near = self._covered(T, levers, used, resting) < way
            low, high = (T, high) if near else (low, T)
        return low

    def _covered(self, T: float, levers: Array, used: BoolArray, resting: int) -> float:
        """Farthest that a point gets in a time."""
        v, a = self.times.velocity, self.times.acceleration
        if resting == 0:
            way = v * T
        else:
            ramp = np.where(np.isfinite(a), v / a, 0.0)
            with np.errstate(invalid="ignore"):
                short = 0.5 * a * T * T / resting
                long = v * np.maximum(T - 0.5 * resting * ramp, 0.0)
                way = np.where(T * a < resting * v, short, long)
            way = np.where(np.isfinite(a), way, v * T)
        return float(np.sum((way * levers)[used]))


class _Levers:
    """How far from the axis of each joint a frame is, at the most.

    The frame and the joint are on one chain, so that they are no farther apart than its
    links are long; and no farther than the frame from the first joint of the chain that
    does not move, plus what is between that and the joint.
    """

    def __init__(self, robot: Robot, frame: str) -> None:
        self.robot, model = robot, robot.model
        item = model.frames[robot.frame_id(frame)]
        chain = [j for j in model.supports[item.parentJoint] if j]
        limits = robot.limits
        S = (
            np.eye(robot.n)
            if robot.expansion_matrix is None
            else robot.expansion_matrix
        )
        widest = np.maximum(
            np.abs(limits.position_lower), np.abs(limits.position_upper)
        )
        offset = 0.0 if robot.expansion_offset is None else robot.expansion_offset
        slides = np.abs(S) @ np.where(prismatic_joints(robot), widest, 0.0)
        slides = slides + np.abs(offset)
        self.S = np.abs(S)
        self.chain, self.slide = chain, np.zeros(len(chain), dtype=bool)
        lengths = []
        for k, j in enumerate(chain):
            length = float(np.linalg.norm(model.jointPlacements[j].translation))
            joint = model.joints[j]
            self.slide[k] = str(joint.shortname()).startswith("JointModelP")
            if self.slide[k]:
                length += float(slides[joint.idx_v])
            lengths.append(length)
        lengths.append(float(np.linalg.norm(item.placement.translation)))
        # From the origin of each joint to the frame, and from the first one to each.
        self.ahead = np.cumsum(lengths[::-1])[::-1][1:]
        self.behind = np.concatenate([[0.0], np.cumsum(lengths[1:-1])])
        first = model.jointPlacements[chain[0]] if chain else None
        self.base = np.zeros(3) if first is None else np.array(first.translation)
        self.columns = [model.joints[j].idx_v for j in chain]

    def between(self, p: Array, q: Array, spread: float) -> Array:
        """Levers of the joints for a way between two points, shape (n,).

        On the way the frame is anywhere that it can be carried to; what counts is that
        it has to come from the one point to the other, for which the straight line in
        the space of the joints will do: along it no joint moves farther than in any
        other motion. There, too, it is within reach.
        """
        model_levers = np.zeros(self.robot.model.nv)
        for k, column in enumerate(self.columns):
            model_levers[column] = 1.0 if self.slide[k] else self.ahead[k]
        return np.asarray(model_levers @ self.S)
