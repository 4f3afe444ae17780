"""Controller between page and planning: the present request and its outcomes."""

from __future__ import annotations

import pickle
import tempfile
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.app.first_request import first_request
from tominpmp.app.planning import Outcome, ShownMotion, plain_name
from tominpmp.app.request import MODERATE, Request, RobotChoice, loaded
from tominpmp.app.worker import Worker
from tominpmp.exceptions import ProblemError
from tominpmp.files.export_check import check_export
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.initial_guess.inverse_kinematics import Target
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem.problem import Problem
from tominpmp.transcription.problem_functions import ProblemFunctions

# Distance between handle and frame up to which the pose counts as reached [m, rad].
REACHED = 2e-3


@lru_cache(maxsize=4)
def _functions(choice: RobotChoice) -> ProblemFunctions:
    """Kinematics and position limits of a robot."""
    robot = loaded(choice)
    q = np.clip(0.0, robot.limits.position_lower, robot.limits.position_upper)
    # Kinematic robots need a limit of accelerations, whatever it is. Collisions are not
    # checked: users may drag the arm through obstacles.
    goal, limits = JointGoal(q), MotionLimits(acceleration=MODERATE)
    problem = Problem(robot, q, goal, motion_limits=limits, self_collision=False)
    return ProblemFunctions.of(problem)


class Controller:
    """Keeps the present request, has it planned, and passes on outcomes.

    Its methods may be called from several threads.

    Args:
        request: The first request.
        on_outcome: Called with every outcome for the robot of the present request.
        planning: Makes the planner, from a callback that takes outcomes; by default a
            process.

    Attributes:
        request: The present request.
        outcome: The last outcome; None before the first of the robot.
        shown: The last motion of the robot; None before the first.
        busy: Whether the last outcome of the present request is still to come.
    """

    def __init__(
        self,
        request: Request,
        on_outcome: Callable[[Outcome], None],
        planning: Callable[..., Any] = Worker,
    ) -> None:
        self.request = request
        self.outcome: Outcome | None = None
        self.shown: ShownMotion | None = None
        self.busy = True
        self._lock = threading.RLock()
        self._on_outcome = on_outcome
        self._planning = planning(self._take)

    def plan(self, request: Request) -> None:
        """Plan a request, which becomes the present one."""
        with self._lock:
            self.request, self.busy = request, True
            self._planning.plan(request)

    def change(self, **changes: Any) -> None:
        """Change fields of the request, and plan it if it differs.

        Raises:
            ProblemError: If a value is wrong.
        """
        with self._lock:
            changed = replace(self.request, **changes)
            if changed != self.request:
                self.plan(changed)

    def choose(self, choice: RobotChoice) -> None:
        """Request a motion of another robot, with default start and goal.

        Raises:
            TominpmpError: If the robot cannot be loaded, or no start and goal are
                found.
        """
        request = first_request(choice)
        with self._lock:
            # The motion of another robot is neither shown nor exported.
            self.outcome = self.shown = None
            self.plan(request)

    def drag(self, end: str, position: Any, quaternion: Any) -> str:
        """Bring the frame at the start or the goal as near to a pose as possible.

        Args:
            end: "q_start" or "q_goal".
            position: Position of the handle [m], shape (3,).
            quaternion: Orientation of the handle (x, y, z, w), shape (4,).

        Returns:
            Remaining distance of the frame from the pose, as "0.2 m and 0.1 rad"; empty
            if it is reached.
        """
        with self._lock:
            request = self.request
            goal: PoseGoal | PositionGoal = PositionGoal(request.frame, position)
            if request.turns:
                goal = PoseGoal(request.frame, (position, quaternion))
            near = np.array(getattr(request, end))
            target = Target(_functions(request.robot), goal)
            q, missing = target.solve(near)
            self.change(**{end: q})
        return "" if missing <= REACHED else target.miss(q)

    def export(
        self, ending: str, dt: float | None = None, message: str | None = None
    ) -> tuple[str, bytes, str]:
        """Write the latest motion to a file.

        Args:
            ending: Ending of the file: ".csv", ".npz", ".yaml", ...
            dt: Time between rows [s]; None for the nodes.
            message: Type of the ROS message, for a file of ROS messages.

        Returns:
            Name and content of the file, and the message of its check.

        Raises:
            TominpmpError: If there is no motion, or the file cannot be written.
        """
        shown = self.shown
        if shown is None:
            raise ProblemError("there is no motion to export yet", "solution")
        solution = pickle.loads(shown.solution)
        name = f"{plain_name(solution.problem.robot.name)}_motion{ending}"
        with tempfile.TemporaryDirectory(prefix="tominpmp-") as folder:
            path = Path(folder) / name
            solution.export(path, dt=dt, message=message, verify=False)
            judgement = replace(check_export(solution, path, dt=dt), path=Path(name))
            return name, path.read_bytes(), judgement.message

    def close(self) -> None:
        """End the planning process."""
        self._planning.close()

    def _take(self, outcome: Outcome) -> None:
        with self._lock:
            if outcome.request.robot != self.request.robot:
                return
            self.outcome, self.shown = outcome, outcome.shown or self.shown
            if outcome.request == self.request:
                self.busy = not outcome.final
        self._on_outcome(outcome)
