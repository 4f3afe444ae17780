"""Legs of a tour: motions from one configuration to the next, each verified."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.result import LowerBound
from tominpmp.cell.tours.direct_motion import direct_motion
from tominpmp.cell.tours.station import Station
from tominpmp.exceptions import ProblemError
from tominpmp.goals import JointGoal
from tominpmp.options import Options
from tominpmp.payload import Payload
from tominpmp.planner.planning import plan
from tominpmp.problem import Problem
from tominpmp.segments import Segment, known_names
from tominpmp.solution import Solution
from tominpmp.status import Status
from tominpmp.trajectory import Trajectory
from tominpmp.verification import verify

# Instants of a direct motion at which obstacles are looked for first.
CHECKS = 24
# What is said of a motion that the joints make on their own.
DIRECT = (
    "The fastest motion that limits of speed and acceleration allow; torques and "
    "obstacles do not forbid it."
)


@dataclass(eq=False)
class LegPlanner:
    """Plans the legs of a tour, each of them once.

    Attributes:
        problem: Robot, obstacles and limits.
        stations: The stations.
        options: How legs are planned that are not direct.
        planned: How many were planned.
        errors: Sentences on legs that cannot be.
    """

    problem: Problem
    stations: tuple[Station, ...]
    options: Options
    planned: int = 0
    errors: list[str] = field(default_factory=list)
    _margins: dict[int, Array] = field(default_factory=dict)
    _settings: dict[tuple[int | None, int | None], Problem] = field(
        default_factory=dict
    )
    _found: dict[tuple[int | None, int | None, bytes, bytes], Solution | None] = field(
        default_factory=dict
    )

    def setting(self, begin: int | None, end: int | None) -> Problem:
        """The problem with what is carried and may touch between two stations.

        Args:
            begin: Index of the station where it begins; None for the start.
            end: Where it ends; None for the end of the tour.
        """
        payload, touch = self._carried(begin, end)
        if payload is None and not touch:
            return self.problem
        key = begin, end if touch else None
        if key not in self._settings:
            self._settings[key] = self._with(payload, touch)
        return self._settings[key]

    def _with(
        self, payload: Payload | None, touch: Sequence[tuple[str, str]]
    ) -> Problem:
        """The problem with something carried, and more that may touch."""
        robot = self.problem.robot
        if payload is not None:
            robot = robot.with_payload(payload)
        known = known_names(robot, self.problem.scene)
        # What is carried elsewhere is not there to touch anything.
        pairs = [pair for pair in touch if set(pair) <= known]
        allowed = (*self.problem.may_touch, *pairs)
        return replace(self.problem, robot=robot, may_touch=allowed)

    @property
    def leaving(self) -> dict[int, Problem]:
        """By station from which something is carried, the problem with that.

        What may touch on the way to any other station may touch in it.
        """
        touch = [pair for station in self.stations for pair in station.may_touch]
        return {
            k: self._with(station.payload, touch)
            for k, station in enumerate(self.stations)
            if station.payload is not None
        }

    def _carried(
        self, begin: int | None, end: int | None
    ) -> tuple[Payload | None, list[tuple[str, str]]]:
        """What is carried between two stations, and the pairs that may touch."""
        ends = [self.stations[index] for index in (begin, end) if index is not None]
        payload = None if begin is None else self.stations[begin].payload
        return payload, [pair for station in ends for pair in station.may_touch]

    def leg(
        self, begin: int | None, end: int | None, q_start: Array, q_end: Array
    ) -> Solution | None:
        """Plan a leg from rest to rest.

        Args:
            begin: Station where it begins; None for the start.
            end: Where it ends; None for the end of the tour.
            q_start: Configuration there, shape (n,) [rad or m].
            q_end: The one at its end.

        Returns:
            What was found; None where a leg is not possible at all.
        """
        key = begin, end, q_start.tobytes(), q_end.tobytes()
        if key not in self._found:
            found = self._planned(self._problem(begin, end, q_start, q_end))
            if found is not None and found.status is Status.INTERRUPTED:
                return found  # nothing is known of it
            self._found[key] = found
        return self._found[key]

    def _planned(self, problem: Problem | None) -> Solution | None:
        if problem is None:
            return None
        self.planned += 1
        try:
            return plan(problem, self.options)
        except ProblemError as error:
            self.errors.append(str(error))
            return None

    def _problem(
        self, begin: int | None, end: int | None, q_start: Array, q_end: Array
    ) -> Problem | None:
        try:
            setting = self.setting(begin, end)
            return setting.with_ends(q_start, JointGoal(q_end))
        except ProblemError as error:
            self.errors.append(str(error))
            return None

    def direct(
        self, begin: int | None, end: int | None, q_start: Array, q_end: Array
    ) -> Trajectory | bool:
        """The motion that the joints make on their own, if nothing seems in its way.

        The arguments are those of :meth:`leg`.

        Returns:
            The motion; False where something is on its way, True where there is no
            such motion in any case.
        """
        problem = self._problem(begin, end, q_start, q_end)
        if problem is None:
            return False
        # The knots of a direct motion are on no clock.
        clocked = self.options.control_period is not None
        motion = None if clocked else direct_motion(problem)
        if motion is None:
            return True
        instants = np.linspace(0.0, motion.duration, CHECKS)
        if not self._looks_clear(problem, motion.q, motion(instants).q):
            return False
        return motion

    def verified(
        self,
        begin: int | None,
        end: int | None,
        q_start: Array,
        q_end: Array,
        motion: Trajectory,
    ) -> Solution | None:
        """A leg with its direct motion; None if the replay is not all right.

        The arguments are those of :meth:`leg`, and the motion.
        """
        started = time.perf_counter()
        problem = self._problem(begin, end, q_start, q_end)
        if problem is None:
            return None
        judged = verify(problem, motion, self.options.tolerances)
        if not judged.ok:
            return None
        bound = LowerBound(motion.duration, "limits of speed and acceleration")
        return Solution(
            problem=problem,
            options=self.options,
            status=Status.CONVERGED,
            message=f"{Status.CONVERGED.value} {DIRECT}",
            feasible=True,
            trajectory=motion,
            planning_time=time.perf_counter() - started,
            verification=judged,
            lower_bound=bound,
        )

    def _looks_clear(self, problem: Problem, *rows: Array) -> bool:
        """Whether some configurations are clear, before all are looked at."""
        checker = problem.checker
        # Ends may be at the margin; the checker knows margins by their identity.
        margins = self._margins.setdefault(id(checker), problem.margins - 1e-6)
        for q in np.concatenate(rows):
            if not checker.hulls_clear(q) and not checker.is_free(q, margins):
                return False
        return True

    def passing(self, way: Sequence[int | None], q: Sequence[Array]) -> Solution | None:
        """Plan legs without stops between them.

        Args:
            way: Stations, the arm being at rest at the first and the last of them only;
                None for the start and the end of the tour.
            q: Configurations there, shape (n,) each.

        Returns:
            The better one of two motions: through these configurations, and through any
            that meet the goals on the way; None where none was found.
        """
        best: Solution | None = None
        stations = [self.stations[k] for k in way if k is not None]
        free = any(s.goal.configuration is None for s in stations if not s.stop)
        for exactly in (True, False) if free else (True,):
            try:
                problem = self._passing_problem(way, q, exactly)
                found = plan(problem, self.options)
            except ProblemError as error:
                self.errors.append(str(error))
                continue
            self.planned += 1
            if found.success and (best is None or found.T < best.T):
                best = found
        return best

    def _passing_problem(
        self, way: Sequence[int | None], q: Sequence[Array], exactly: bool
    ) -> Problem:
        segments = []
        for begin, end, there in zip(way[:-1], way[1:], q[1:], strict=True):
            station = None if end is None else self.stations[end]
            payload, touch = self._carried(begin, end)
            goal = JointGoal(there)
            if station is not None and not station.stop and not exactly:
                goal = station.goal  # type: ignore[assignment]
            segments.append(Segment(goal, payload=payload, may_touch=touch))
        base = self.problem
        last = segments[-1].goal
        return replace(base, q_start=q[0], goal=last, segments=segments)
