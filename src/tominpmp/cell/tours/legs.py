"""Legs of a tour: motions from one configuration to the next, each verified.

A direct motion is one that the joints make on their own: every joint speeds up, runs
and slows down so that all arrive together, in the least time that limits of speed and
acceleration allow. Where torques and obstacles do not forbid it, which a replay tells,
it is the fastest there is, and no planning is needed.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.result import LowerBound
from tominpmp.cell.tours.leg_times import JointTimes, Leg, LegTable
from tominpmp.cell.tours.station import Station
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError
from tominpmp.goals import JointGoal
from tominpmp.options import Options
from tominpmp.payload import Payload
from tominpmp.planner.planning import plan
from tominpmp.problem import Problem
from tominpmp.segments import Segment, known_names
from tominpmp.solution import Solution
from tominpmp.status import Status
from tominpmp.stopping import Stop, check, seconds_left
from tominpmp.trajectory import Trajectory
from tominpmp.verification import verify

# Ways below this are none [rad or m], and shares of the duration that are the same.
NO_WAY = 1e-9
SAME = 1e-9


def direct_motion(problem: Problem) -> Trajectory | None:
    """Make the fastest motion that limits of speed and acceleration allow.

    Args:
        problem: A problem from rest to a configuration at rest.

    Returns:
        The motion, with a constant acceleration on each interval; None where it would
        jump in velocity, or accelerations may not jump, or there is no way to go.
    """
    limits, goal = problem.motion_limits, problem.goal.configuration
    if goal is None or problem.segments or (limits is not None and limits.continuous):
        return None
    times, way = JointTimes.of(problem), goal - problem.q_start
    far = np.abs(way)
    moves = far > NO_WAY
    T = float(times.between(problem.q_start, goal))
    sudden = moves & ~np.isfinite(times.acceleration)
    if not np.any(moves) or np.any(sudden) or not 0.0 < T < np.inf:
        return None
    ramp = _ramps(times, far, T)
    t = np.unique(np.concatenate([[0.0, T], ramp, T - ramp]))
    t = t[np.append(True, np.diff(t) > SAME * T)]
    t[-1] = T
    speed = way / (T - ramp)
    q, v = _states(t, T, ramp, speed)
    q += problem.q_start
    q[-1] = goal
    middle = 0.5 * (t[1:] + t[:-1])[:, None]
    a = np.where(middle < ramp, 1.0, np.where(middle > T - ramp, -1.0, 0.0))
    a = a * speed / ramp
    dynamics = RobotDynamics(problem.robot).inverse
    joints = problem.robot.joint_names
    motion = Trajectory(joints, t, q, v, np.zeros_like(q), a=a)
    return motion.with_torques(dynamics)


def _ramps(times: JointTimes, far: Array, T: float) -> Array:
    """How long each joint speeds up, shape (n,) [s]: all alike if that is possible.

    Then the way is a straight line. The longer the ramp, the less acceleration it
    takes, up to half of the duration.
    """
    run = np.where(np.isfinite(times.velocity), far / times.velocity, 0.0)
    own = np.minimum(T - run, 0.5 * T)
    common = float(np.min(own))
    needed = far / (common * (T - common))
    if np.all(needed <= times.acceleration * (1.0 + 1e-9)):
        return np.full_like(far, common)
    return np.asarray(own)


def _states(t: Array, T: float, ramp: Array, speed: Array) -> tuple[Array, Array]:
    """Ways and velocities at times, shapes (m, n)."""
    t = t[:, None]
    first = np.minimum(t, ramp)
    run = np.clip(t - ramp, 0.0, T - 2.0 * ramp)
    last = np.clip(t - (T - ramp), 0.0, ramp)
    way = 0.5 * first**2 / ramp + run + last - 0.5 * last**2 / ramp
    return way * speed, (first - last) / ramp * speed


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


@dataclass(eq=False)
class KnownLegs:
    """What is known of legs, and how more is found out.

    Attributes:
        table: Times of the legs, which are written down there.
        planner: Plans the legs.
        motions: Motions of the legs that were replayed or planned.
        detours: What blocked legs have taken, as shares of their direct times.
    """

    table: LegTable
    planner: LegPlanner
    motions: dict[Leg, Solution] = field(default_factory=dict)
    detours: list[float] = field(default_factory=list)
    _looked_at: set[Leg] = field(default_factory=set)
    _unverified: dict[Leg, Trajectory] = field(default_factory=dict)

    def _ends(self, leg: Leg) -> tuple[int | None, int | None, Array, Array]:
        """Stations where a leg begins and ends, and the configurations there."""
        begin, end = self.table.station(leg[0]), self.table.station(leg[2])
        return begin, end, *self.table.rows(leg)

    def resting(self, leg: Leg) -> bool:
        """Whether the arm is at rest at both ends of a leg."""
        return bool(self.table.rests[leg[0]] and self.table.rests[leg[2]])

    def direct(self, leg: Leg) -> bool:
        """Look for the direct motion of a leg; False where its way is found blocked."""
        check()
        if leg in self._looked_at or leg in self.table.known or not self.resting(leg):
            return True
        self._looked_at.add(leg)
        if self.stays(leg):
            self.table.learn(leg, 0.0)
            return True
        found = self.planner.direct(*self._ends(leg))
        if isinstance(found, Trajectory):
            self._unverified[leg] = found
            self.table.learn(leg, found.duration)
        elif not found:
            self.table.block_way(leg)
        return bool(found)

    def verified(self, leg: Leg) -> bool:
        """Replay the direct motion of a leg; False where that is not all right."""
        motion = self._unverified.pop(leg, None)
        if motion is None:
            return True
        found = self.planner.verified(*self._ends(leg), motion)
        if found is None:
            self.table.forget(leg)
            self.table.block_way(leg)
            return False
        self.motions[leg] = found
        return True

    def stays(self, leg: Leg) -> bool:
        """Whether a leg leads nowhere."""
        begin, end = self.table.rows(leg)
        return float(np.max(np.abs(begin - end), initial=0.0)) < NO_WAY

    def seconds(self, leg: Leg) -> float:
        """Time of a leg that is not known yet, infinite where there is no motion."""
        if leg not in self._looked_at:
            self.direct(leg)
        if leg in self.table.known and self.verified(leg):
            return self.table.known[leg]
        found = self.planned(leg)
        if found is None or not found.success:
            return np.inf
        self.motions[leg] = found
        if self.table.is_blocked(leg):
            least = float(self.table.times.between(*self.table.rows(leg)))
            self.detours.append(found.T / least)
        return found.T

    def planned(self, leg: Leg) -> Solution | None:
        """Plan a leg; None where it is not possible at all."""
        self.limit_time()
        found = self.planner.leg(*self._ends(leg))
        if found is not None and found.status is Status.INTERRUPTED:
            raise Stop(True)
        if found is not None and not found.success:
            self.planner.errors.append(found.message)
        return found

    def limit_time(self) -> None:
        """Give what is planned next the time that is left."""
        left = seconds_left()
        if np.isfinite(left):
            options = replace(self.planner.options, max_planning_time=left)
            self.planner.options = options

    def factor(self) -> float:
        """How much longer legs take than by the estimates of the joints."""
        ratios = []
        for leg, seconds in self.table.known.items():
            guess = float(self.table.times.between(*self.table.rows(leg)))
            if guess > 0.0 and np.isfinite(seconds):
                ratios.append(seconds / guess)
        return max(1.0, float(np.median(ratios))) if ratios else 1.0
