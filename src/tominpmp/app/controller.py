"""Between page and planning: what is asked for now, and what was found for it."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.app.first_request import first_request
from tominpmp.app.planning import Outcome, exported
from tominpmp.app.request import Request, RobotChoice, loaded, rounded
from tominpmp.app.worker import Worker
from tominpmp.exceptions import ProblemError
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.initial_guess.inverse_kinematics import solve_inverse_kinematics
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot
from tominpmp.transcription.problem_functions import ProblemFunctions

# With fewer joints an arm cannot take any orientation at any place.
JOINTS_OF_A_POSE = 6
# A handle this far from the frame, in m and rad, is out of reach.
REACHED = 2e-3


class Reach:
    """Inverse kinematics of one robot's frame, from the configuration at hand.

    Args:
        robot: The robot.
        frame: Name of the frame.

    Attributes:
        turns: Whether the frame's orientation is reached too, not its position only.

    Raises:
        FrameNotFound: If there is no such frame.
    """

    def __init__(self, robot: Robot, frame: str) -> None:
        self.turns = robot.n >= JOINTS_OF_A_POSE
        self._frame = frame
        limits = robot.limits
        q = np.clip(np.zeros(robot.n), limits.position_lower, limits.position_upper)
        goal = PositionGoal(frame, np.zeros(3))
        # Whether it collides is not asked: one may drag it through obstacles.
        problem = Problem(robot, q, goal, self_collision=False)
        self._functions = ProblemFunctions.of(problem)

    def pose(self, q: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] and quaternion (x, y, z, w) of the frame."""
        kinematics = self._functions.kinematics
        both = pin.SE3ToXYZQUAT(kinematics.placement(np.array(q), self._frame))
        return both[:3], both[3:]

    def solve(
        self, position: np.ndarray, quaternion: np.ndarray, near: tuple[float, ...]
    ) -> tuple[tuple[float, ...], float]:
        """The configuration at a pose that is next to another one.

        Args:
            position: Where the frame is to be [m], shape (3,).
            quaternion: How it is to be turned (x, y, z, w), shape (4,).
            near: Where to begin, n numbers [rad or m].

        Returns:
            The configuration, n numbers [rad or m], and how far the frame is from the
            pose, in m and rad together; 0 if it is there.
        """
        goal: PoseGoal | PositionGoal = PositionGoal(self._frame, np.array(position))
        if self.turns:
            unit = np.asarray(quaternion) / np.linalg.norm(quaternion)
            place = pin.XYZQUATToSE3(np.concatenate([position, unit]))
            goal = PoseGoal(self._frame, place)
        q, miss = solve_inverse_kinematics(self._functions, goal, np.array(near))
        return rounded(q), 0.0 if miss <= REACHED else miss


@lru_cache(maxsize=4)
def _reach_of(robot: RobotChoice, frame: str) -> Reach:
    return Reach(loaded(robot), frame)


class Controller:
    """Keeps the request, has it planned, and tells of outcomes.

    It may be called from several threads.

    Args:
        request: What is asked for first.
        on_outcome: Called with every outcome that is not older than the last one.
        planning: Makes what plans, from a function that takes outcomes; by default a
            process.

    Attributes:
        request: What is asked for now.
        outcome: The last outcome; None before the first.
    """

    def __init__(
        self,
        request: Request,
        on_outcome: Callable[[Outcome], None],
        planning: Callable[..., Any] = Worker,
    ) -> None:
        self.request = request
        self.outcome: Outcome | None = None
        self._lock = threading.RLock()
        self._on_outcome = on_outcome
        self._number = 0
        self._solution = b""
        self._planning = planning(self._take)

    @property
    def busy(self) -> bool:
        """Whether an outcome for what is asked for now is still to come."""
        last = self.outcome
        return last is None or last.number < self._number or not last.final

    def start(self) -> None:
        """Plan what is asked for now."""
        self._plan(self.request)

    def _plan(self, request: Request) -> None:
        with self._lock:
            self.request = request
            self._number += 1
            self._planning.plan(self._number, request)

    def change(self, **changes: Any) -> None:
        """Ask for the same with some fields changed.

        Raises:
            ProblemError: If a value is wrong.
        """
        with self._lock:
            changed = replace(self.request, **changes)
            if changed != self.request:
                self._plan(changed)

    def choose(self, choice: RobotChoice) -> None:
        """Ask for a motion of another robot, with start and goal of its own.

        Raises:
            TominpmpError: If it cannot be loaded, or has no start and goal.
        """
        request = first_request(choice)
        if request != self.request:
            self._plan(request)

    def drag(self, end: str, position: Any, quaternion: Any) -> float:
        """Bring the frame at the start or the goal to a pose, as near as it goes.

        Args:
            end: "q_start" or "q_goal".
            position: Where its handle is [m], shape (3,).
            quaternion: How it is turned (x, y, z, w), shape (4,).

        Returns:
            How far from there the frame remains, in m and rad; 0 if it is there.
        """
        with self._lock:
            near = getattr(self.request, end)
            q, miss = self.reach().solve(position, quaternion, near)
            self.change(**{end: q})
        return miss

    def reach(self) -> Reach:
        """Inverse kinematics of the frame that handles move."""
        return _reach_of(self.request.robot, self.request.frame)

    def export(
        self, ending: str, dt: float | None = None, message: str | None = None
    ) -> tuple[str, bytes, str]:
        """Write the motion that was found last to a file.

        Args:
            ending: What its name ends with: ".csv", ".npz", ".yaml", ...
            dt: Time between rows [s]; None for the nodes.
            message: Which ROS message, if it is one.

        Returns:
            Name and content of the file, and what its check says.

        Raises:
            TominpmpError: If there is no motion, or the file cannot be written.
        """
        if not self._solution:
            raise ProblemError("there is no motion to export yet", "solution")
        return exported(pickle.loads(self._solution), ending, dt, message)

    def close(self) -> None:
        """End planning."""
        self._planning.close()

    def _take(self, outcome: Outcome) -> None:
        with self._lock:
            if self.outcome is not None and outcome.number < self.outcome.number:
                return
            self.outcome = outcome
            self._solution = outcome.solution or self._solution
        self._on_outcome(outcome)
