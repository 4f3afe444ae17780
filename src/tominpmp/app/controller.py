"""Between page and planning: what is asked for now, and what was found for it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

from tominpmp.app.choice import RobotChoice, loaded
from tominpmp.app.first_request import first_request
from tominpmp.app.jobs import Exported
from tominpmp.app.outcome import Outcome
from tominpmp.app.reach import Reach
from tominpmp.app.request import Request
from tominpmp.app.worker import Worker


class Planning(Protocol):
    """Where requests are planned: a :class:`~tominpmp.app.worker.Worker` or alike."""

    def plan(self, number: int, request: Request) -> None:
        """Plan a request; what is planned before it is out of date."""

    def export(
        self, ending: str, dt: float | None, message: str | None, patience: float = ...
    ) -> Exported:
        """Write the last motion to a file, and wait for it."""

    def close(self) -> None:
        """End planning."""


class Controller:
    """Keeps the request, has it planned, and tells of outcomes.

    It may be called from several threads.

    Args:
        request: What is asked for first.
        on_outcome: Called with every outcome that is not older than the last one told.
        planning: Makes what plans, from functions that take outcomes and a sentence on
            its end; by default a process.
    """

    def __init__(
        self,
        request: Request,
        on_outcome: Callable[[Outcome], None],
        planning: Callable[
            [Callable[[Outcome], None], Callable[[str], None]], Planning
        ] = Worker,
    ) -> None:
        self._lock = threading.RLock()
        self._on_outcome = on_outcome
        self._request = request
        self._number = 0
        self._told = 0
        self._outcome: Outcome | None = None
        self._reach: tuple[RobotChoice, str, Reach] | None = None
        self._planning = planning(self._take, self._ended)

    @property
    def request(self) -> Request:
        """What is asked for now."""
        return self._request

    @property
    def outcome(self) -> Outcome | None:
        """The last outcome; None before the first."""
        return self._outcome

    @property
    def busy(self) -> bool:
        """Whether an outcome for what is asked for now is still to come."""
        last = self._outcome
        return last is None or last.number < self._number or not last.final

    def start(self) -> None:
        """Plan what is asked for now."""
        self.ask(self._request, anew=True)

    def ask(self, request: Request, *, anew: bool = False) -> None:
        """Ask for something else.

        Args:
            request: What is asked for.
            anew: Whether to plan it even if it is what was asked for already.
        """
        with self._lock:
            if request == self._request and not anew:
                return
            self._request = request
            self._number += 1
            self._planning.plan(self._number, request)

    def change(self, **changes: Any) -> None:
        """Ask for the same with some fields changed.

        Raises:
            ProblemError: If a value is wrong.
        """
        with self._lock:
            self.ask(replace(self._request, **changes))

    def choose(self, choice: RobotChoice) -> None:
        """Ask for a motion of another robot, with start and goal of its own.

        Raises:
            TominpmpError: If it cannot be loaded, or has no start and goal.
        """
        request = first_request(choice)
        with self._lock:
            self.ask(request)

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
            near = getattr(self._request, end)
            found = self.reach().solve(position, quaternion, near)
            self.change(**{end: found.q})
        return 0.0 if found.ok else found.miss

    def reach(self) -> Reach:
        """Inverse kinematics of the frame that handles move."""
        with self._lock:
            robot, frame = self._request.robot, self._request.frame
            if self._reach is None or self._reach[:2] != (robot, frame):
                self._reach = robot, frame, Reach(loaded(robot), frame)
            return self._reach[2]

    def export(
        self, ending: str, dt: float | None = None, message: str | None = None
    ) -> Exported:
        """Write the motion that was found last to a file.

        Args:
            ending: What its name ends with: ".csv", ".npz", ".yaml", ...
            dt: Time between rows [s]; None for the nodes.
            message: Which ROS message, if it is one.
        """
        return self._planning.export(ending, dt, message)

    def close(self) -> None:
        """End planning."""
        self._planning.close()

    def _take(self, outcome: Outcome) -> None:
        with self._lock:
            if outcome.number < self._told:
                return
            self._told = outcome.number
            self._outcome = outcome
        self._on_outcome(outcome)

    def _ended(self, sentence: str) -> None:
        with self._lock:
            outcome = Outcome(self._number, self._request, sentence)
        self._take(outcome)
