"""The configuration that brings a dragged handle's frame to where it was dragged."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from tominpmp.app.numbers import rounded
from tominpmp.goals import PoseGoal, PositionGoal
from tominpmp.initial_guess.inverse_kinematics import solve_inverse_kinematics
from tominpmp.kinematics import RobotKinematics
from tominpmp.problem import Problem
from tominpmp.robot import Robot
from tominpmp.transcription.problem_functions import ProblemFunctions

# With fewer joints an arm cannot take any orientation at any place.
JOINTS_OF_A_POSE = 6
# A handle this far from the frame, in m and rad, is out of reach.
REACHED = 2e-3


class Reached(NamedTuple):
    """Where an arm comes when it is to reach a pose.

    Attributes:
        q: Configuration, n numbers [rad or m].
        miss: How far its frame is from the pose, in m and rad together.
    """

    q: tuple[float, ...]
    miss: float

    @property
    def ok(self) -> bool:
        """Whether it is there."""
        return self.miss <= REACHED


class Reach:
    """Inverse kinematics of one robot's frame, from the configuration at hand.

    Args:
        robot: The robot.
        frame: Name of the frame.

    Raises:
        FrameNotFound: If there is no such frame.
    """

    def __init__(self, robot: Robot, frame: str) -> None:
        self.robot, self.frame = robot, frame
        robot.frame_id(frame)
        self._kinematics = RobotKinematics(robot)
        limits = robot.limits
        low, high = limits.position_lower, limits.position_upper
        q = np.clip(np.zeros(robot.n), low, high)
        goal = PositionGoal(frame, np.zeros(3))
        # Whether it collides is not asked: one may drag it through obstacles.
        problem = Problem(robot, q, goal, self_collision=False)
        self._functions = ProblemFunctions.of(problem)

    @property
    def turns(self) -> bool:
        """Whether the frame's orientation is reached too, not its position only."""
        return self.robot.n >= JOINTS_OF_A_POSE

    def pose(self, q: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] and quaternion (x, y, z, w) of the frame."""
        placement = self._kinematics.placement(np.array(q), self.frame)
        both = pin.SE3ToXYZQUAT(placement)
        return both[:3], both[3:]

    def solve(
        self, position: np.ndarray, quaternion: np.ndarray, near: tuple[float, ...]
    ) -> Reached:
        """The configuration at a pose that is next to another one.

        Args:
            position: Where the frame is to be [m], shape (3,).
            quaternion: How it is to be turned (x, y, z, w), shape (4,).
            near: Where to begin, n numbers [rad or m].
        """
        unit = np.asarray(quaternion) / np.linalg.norm(quaternion)
        place = pin.XYZQUATToSE3(np.concatenate([np.asarray(position), unit]))
        goal = (
            PoseGoal(self.frame, place)
            if self.turns
            else PositionGoal(self.frame, place.translation)
        )
        q, miss = solve_inverse_kinematics(self._functions, goal, np.array(near))
        return Reached(rounded(q), miss)
