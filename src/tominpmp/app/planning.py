"""Planning for the page: from the last motion, then proofs, then a second look."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from tominpmp.app.numbers import plain_name
from tominpmp.app.outcome import Outcome, show
from tominpmp.app.request import Request
from tominpmp.exceptions import ProblemError, TominpmpError, TominpmpWarning
from tominpmp.files.export_check import check_export
from tominpmp.planner.planning import plan
from tominpmp.problem import Problem
from tominpmp.solution import Solution
from tominpmp.status import IterationRecord

# Nobody waits longer for a page [s].
MOST_SECONDS = 20.0
# A motion found afresh takes the place of the one shown if it is faster by this share.
BETTER = 1e-3


class Superseded(Exception):
    """The request that is planned for is out of date."""


class Session:
    """Plans one request after the other, each from the motion found before.

    Attributes:
        solution: The last motion that was found; None before the first.
    """

    def __init__(self) -> None:
        self.solution: Solution | None = None

    def outcomes(
        self, number: int, request: Request, superseded: Callable[[], bool]
    ) -> Iterator[Outcome]:
        """Plan, and tell what is found as soon as it is.

        A motion is shown first, then what holds it back; where it came from a former
        one, a faster one is looked for afresh.

        Args:
            number: Number of the request, for its outcomes.
            request: What is asked for.
            superseded: Tells whether the request is out of date, which ends it.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TominpmpWarning)
            try:
                yield from self._outcomes(number, request, superseded)
            except Superseded:
                return
            except TominpmpError as error:
                yield Outcome(number, request, str(error))

    def _outcomes(
        self, number: int, request: Request, superseded: Callable[[], bool]
    ) -> Iterator[Outcome]:
        problem = request.problem()
        former = self._former(problem)
        found = _plan(problem, superseded, former)
        if not found.success:
            yield Outcome(number, request, found.message)
            return
        self.solution = found
        yield self._outcome(number, request, certified=False)
        _check(superseded)
        yield self._outcome(number, request, certified=True, final=former is None)
        if former is None:
            return
        _check(superseded)
        again = _plan(problem, superseded)
        if again.success and again.T < (1.0 - BETTER) * found.T:
            self.solution = again
        yield self._outcome(number, request, certified=True, final=True)

    def _outcome(
        self, number: int, request: Request, *, certified: bool, final: bool = False
    ) -> Outcome:
        solution = self.solution
        assert solution is not None  # noqa: S101
        shown = show(solution, request.frame, certified=certified)
        return Outcome(number, request, solution.message, shown, final)

    def _former(self, problem: Problem) -> Solution | None:
        """The last motion, if one can begin with it."""
        last = self.solution
        if last is None or len(problem.segments) != len(last.problem.segments):
            return None
        same = last.problem.robot.joint_names == problem.robot.joint_names
        return last if same else None

    def exported(
        self, ending: str, dt: float | None, message: str | None = None
    ) -> tuple[str, bytes, str]:
        """Write the last motion to a file.

        Args:
            ending: What its name ends with: ".csv", ".npz", ".yaml", ...
            dt: Time between rows [s]; None for the nodes.
            message: Which ROS message, if it is one.

        Returns:
            Name and content of the file, and what its check says.

        Raises:
            TominpmpError: If there is no motion, or the file cannot be written.
        """
        if self.solution is None:
            raise ProblemError("there is no motion to export yet", "solution")
        with tempfile.TemporaryDirectory(prefix="tominpmp-") as folder:
            name = f"{plain_name(self.solution.problem.robot.name)}_motion{ending}"
            path = Path(folder) / name
            self.solution.export(path, dt=dt, message=message, verify=False)
            found = check_export(self.solution, path, dt=dt)
            return name, path.read_bytes(), found.message


def _check(superseded: Callable[[], bool]) -> None:
    if superseded():
        raise Superseded


def _plan(
    problem: Problem, superseded: Callable[[], bool], former: Solution | None = None
) -> Solution:
    """Plan quickly.

    Raises:
        Superseded: As soon as the request is out of date.
    """

    def look(record: IterationRecord) -> None:
        _check(superseded)

    solution = plan(
        problem,
        start=former,
        effort="quick",
        max_planning_time=MOST_SECONDS,
        callback=look,
    )
    # What is kept needs no callback, which refers to this request.
    return replace(solution, options=replace(solution.options, callback=None))
