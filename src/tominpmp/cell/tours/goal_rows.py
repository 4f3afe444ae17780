"""What goals ask of many configurations at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray
from tominpmp.collision.placements import Placements
from tominpmp.goals import Goal
from tominpmp.goals.targets import FrameTarget, frame_target
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot


class GoalRows:
    """Residuals of goals at configurations, each with its own goal.

    Poses, directions and positions are taken as exact, without their tolerances; what
    they lack is a turn and a shift that would bring the frame there, to first order.

    Attributes:
        robot: The robot.
        goals: The goals.
        rows: Numbers of a residual; shorter ones are filled up with zeros.
    """

    def __init__(self, robot: Robot, goals: Sequence[Goal]) -> None:
        self.robot, self.goals = robot, tuple(goals)
        self.kinematics = RobotKinematics(robot)
        self._placements = Placements(robot.model)
        targets = [frame_target(goal) for goal in goals]
        self._together = np.array([target is not None for target in targets])
        zero = np.zeros(robot.n)
        found = zip(goals, targets, strict=True)
        others = (goal for goal, target in found if target is None)
        sizes = [g.place(self.kinematics, zero).value.size for g in others]
        self.rows = max([6, *sizes])
        nothing = FrameTarget(np.zeros(3), np.zeros((3, 3)), np.zeros((6, 6)), False)
        known = [target or nothing for target in targets]
        self._places = np.stack([target.place for target in known])
        self._turns = np.stack([target.turn for target in known])
        self._counts = np.stack([target.counts for target in known])
        self._posed = np.array([target.posed for target in known])
        self._names = np.array([str(goal.frame_name) for goal in goals])

    def __call__(self, q: Array, which: IntArray) -> tuple[Array, Array]:
        """Evaluate residuals.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            which: Index of the goal of each, shape (m,).

        Returns:
            Residuals, shape (m, rows) [rad or m], and their Jacobians, shape (m, rows,
            n).
        """
        value = np.zeros((len(q), self.rows))
        jacobian = np.zeros((len(q), self.rows, self.robot.n))
        together = np.flatnonzero(self._together[which])
        if together.size:
            found = self._frames(q[together], which[together])
            value[together, :6], jacobian[together, :6] = found
        for i in np.flatnonzero(~self._together[which]).tolist():
            goal = self.goals[which[i]]
            lack, by_q = goal.place_residual(self.kinematics, q[i])
            value[i, : lack.size], jacobian[i, : lack.size] = lack, by_q
        return value, jacobian

    def _frames(self, q: Array, which: IntArray) -> tuple[Array, Array]:
        """Residuals of goals on frames."""
        model, robot = self.robot.model, self.robot
        placed = self._placements.joints(robot.expand(q))
        value = np.zeros((len(q), 6))
        jacobian = np.zeros((len(q), 6, robot.n))
        names = self._names[which]
        for name in np.unique(names).tolist():
            mine = np.flatnonzero(names == name)
            frame = model.frames[robot.frame_id(name)]
            joint, there = int(frame.parentJoint), frame.placement
            R, t = placed[0][mine], placed[1][mine]
            rotation = R[:, joint] @ np.array(there.rotation)
            origin = t[:, joint] + R[:, joint] @ np.array(there.translation)
            lack = self._lack(rotation, origin, which[mine])
            carried = self._carried(R, t, joint, origin)
            counts = self._counts[which[mine]]
            value[mine] = -np.einsum("mij,mj->mi", counts, lack)
            jacobian[mine] = counts @ carried
        return value, jacobian

    def _lack(self, rotation: Array, origin: Array, which: IntArray) -> Array:
        """Turn [rad] and shift [m] to the goal, shape (m, 6)."""
        out = np.zeros((len(rotation), 6))
        out[:, 3:] = self._places[which] - origin
        turns, posed = self._turns[which], self._posed[which]
        for i in np.flatnonzero(posed).tolist():
            out[i, :3] = pin.log3(turns[i] @ rotation[i].T)
        pointed = ~posed
        now = np.einsum("mij,mj->mi", rotation[pointed], turns[pointed, 0])
        out[pointed, :3] = _turns_between(now, turns[pointed, 1])
        return out

    def _carried(self, R: Array, t: Array, joint: int, origin: Array) -> Array:
        """Jacobian of a frame, turn above shift, shape (m, 6, n)."""
        model = self.robot.model
        out = np.zeros((len(R), 6, model.nv))
        for j in model.supports[joint]:
            if not j:
                continue
            slide, turn, column = self._placements.axes(j)
            axis = R[:, j] @ turn
            out[:, :3, column] = axis
            out[:, 3:, column] = np.cross(axis, origin - t[:, j]) + R[:, j] @ slide
        S = self.robot.expansion_matrix
        return out if S is None else out @ S


def _turns_between(a: Array, b: Array) -> Array:
    """Rotation vectors that turn unit vectors into others, shapes (m, 3) [rad]."""
    normal = np.cross(a, b)
    sine = np.linalg.norm(normal, axis=1)
    angle = np.arctan2(sine, np.sum(a * b, axis=1))
    # To the opposite any way is as short.
    opposite = (sine < 1e-9) & (angle > 1.0)
    normal[opposite] = np.cross(a[opposite], np.roll(a[opposite], 1, axis=1) + 0.1)
    length = np.where(opposite, np.linalg.norm(normal, axis=1), sine)
    return np.asarray(normal * (angle / np.maximum(length, 1e-300))[:, None])
