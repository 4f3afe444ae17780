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
from tominpmp.goals import Goal, JointGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem import Problem
from tominpmp.problem.segments import Segment, known_names
from tominpmp.robot.payload import Payload
from tominpmp.solution import Solution
from tominpmp.status import Status
from tominpmp.stopping import Stop, check, seconds_left
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
    middle, dt = 0.5 * (t[1:] + t[:-1])[:, None], np.diff(t)[:, None]
    a = np.where(middle < ramp, 1.0, np.where(middle > T - ramp, -1.0, 0.0))
    a = a * speed / ramp
    q, v = np.tile(problem.q_start, (t.size, 1)), np.zeros((t.size, way.size))
    v[1:-1] = np.cumsum(a * dt, axis=0)[:-1]
    q[1:] += np.cumsum((v[:-1] + 0.5 * a * dt) * dt, axis=0)
    q[-1] = goal
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


# Instants of a direct motion at which obstacles are looked for first.
CHECKS = 24
# What is said of a motion that the joints make on their own.
DIRECT = (
    "The fastest motion that limits of speed and acceleration allow; torques and "
    "obstacles do not forbid it."
)


def carrying(
    problem: Problem, payload: Payload | None, touch: Sequence[tuple[str, str]]
) -> Problem:
    """A problem with something carried, and more pairs that may touch."""
    robot = problem.robot
    if payload is not None:
        robot = robot.with_payload(payload)
    known = known_names(robot, problem.scene)
    # What is carried elsewhere is not there to touch anything.
    pairs = [pair for pair in touch if set(pair) <= known]
    return replace(problem, robot=robot, may_touch=(*problem.may_touch, *pairs))


@dataclass(eq=False)
class Legs:
    """What is known of the legs of a tour, and how more is found out.

    Attributes:
        problem: Robot, obstacles and limits.
        stations: The stations.
        options: How legs are planned that are not direct.
        table: Times of the legs, which are written down there.
        planned: How many legs were planned.
        errors: Sentences on legs that cannot be.
        motions: Motions of the legs that were replayed or planned.
        detours: What blocked legs have taken, as shares of their direct times.
    """

    problem: Problem
    stations: tuple[Station, ...]
    options: Options
    table: LegTable
    planned: int = 0
    errors: list[str] = field(default_factory=list)
    motions: dict[Leg, Solution] = field(default_factory=dict)
    detours: list[float] = field(default_factory=list)
    _looked_at: set[Leg] = field(default_factory=set)
    _unverified: dict[Leg, Trajectory] = field(default_factory=dict)
    _settings: dict[tuple[int | None, int | None], Problem] = field(
        default_factory=dict
    )

    # -- problems of legs --------------------------------------------------------------

    def _carried(
        self, begin: int | None, end: int | None
    ) -> tuple[Payload | None, list[tuple[str, str]]]:
        """What is carried between two stations, and the pairs that may touch.

        Args:
            begin: Index of the station where the leg begins; None for the start.
            end: Where it ends; None for the end of the tour.
        """
        ends = [self.stations[index] for index in (begin, end) if index is not None]
        payload = None if begin is None else self.stations[begin].payload
        return payload, [pair for station in ends for pair in station.may_touch]

    def _problem(self, leg: Leg) -> Problem | None:
        """The problem of a leg; None where there cannot be such a leg."""
        begin, end = self.table.station(leg[0]), self.table.station(leg[2])
        payload, touch = self._carried(begin, end)
        q_start, q_end = self.table.rows(leg)
        try:
            setting = self.problem
            if payload is not None or touch:
                key = begin, end if touch else None
                if key not in self._settings:
                    self._settings[key] = carrying(setting, payload, touch)
                setting = self._settings[key]
            return setting.with_ends(q_start, JointGoal(q_end))
        except ProblemError as error:
            self.errors.append(str(error))
            return None

    def resting(self, leg: Leg) -> bool:
        """Whether the arm is at rest at both ends of a leg."""
        return bool(self.table.rests[leg[0]] and self.table.rests[leg[2]])

    def stays(self, leg: Leg) -> bool:
        """Whether a leg leads nowhere."""
        begin, end = self.table.rows(leg)
        return float(np.max(np.abs(begin - end), initial=0.0)) < NO_WAY

    # -- direct motions ----------------------------------------------------------------

    def direct(self, leg: Leg) -> bool:
        """Look for the direct motion of a leg; False where its way is found blocked."""
        check()
        if leg in self._looked_at or leg in self.table.known or not self.resting(leg):
            return True
        self._looked_at.add(leg)
        if self.stays(leg):
            self.table.learn(leg, 0.0)
            return True
        problem = self._problem(leg)
        # The knots of a direct motion are on no clock.
        clocked = self.options.control_period is not None
        if problem is not None:
            motion = None if clocked else direct_motion(problem)
            if motion is None:
                return True
            if _looks_clear(problem, motion):
                self._unverified[leg] = motion
                self.table.learn(leg, motion.duration)
                return True
        self.table.block_way(leg)
        return False

    def verified(self, leg: Leg) -> bool:
        """Replay the direct motion of a leg; False where that is not all right."""
        motion = self._unverified.pop(leg, None)
        if motion is None:
            return True
        started = time.perf_counter()
        problem = self._problem(leg)
        tolerances = self.options.tolerances
        judged = None if problem is None else verify(problem, motion, tolerances)
        if problem is None or judged is None or not judged.ok:
            self.table.forget(leg)
            self.table.block_way(leg)
            return False
        self.motions[leg] = Solution(
            problem=problem,
            options=self.options,
            status=Status.CONVERGED,
            message=f"{Status.CONVERGED.value} {DIRECT}",
            feasible=True,
            trajectory=motion,
            planning_time=time.perf_counter() - started,
            verification=judged,
            lower_bound=LowerBound(motion.duration, "limits of speed and acceleration"),
        )
        return True

    # -- planned motions ---------------------------------------------------------------

    def seconds(self, leg: Leg) -> float:
        """Time of a leg that is not known yet, infinite where there is no motion."""
        self.direct(leg)
        if leg in self.table.known and self.verified(leg):
            return self.table.known[leg]
        found = self.motion(leg)
        if found is None:
            return np.inf
        if self.table.is_blocked(leg):
            least = float(self.table.times.between(*self.table.rows(leg)))
            self.detours.append(found.T / least)
        return found.T

    def motion(self, leg: Leg) -> Solution | None:
        """The motion of a leg, planned unless it is known; None where there is none."""
        if leg not in self.motions:
            problem = self._problem(leg)
            found = None if problem is None else self._plan(problem)
            if found is None:
                return None
            self.motions[leg] = found
        return self.motions[leg]

    def _plan(self, problem: Problem) -> Solution | None:
        """Plan a motion in the time that is left; None where none is found."""
        left = seconds_left()
        if np.isfinite(left):
            self.options = replace(self.options, max_planning_time=left)
        self.planned += 1
        try:
            found = plan(problem, self.options)
        except ProblemError as error:
            self.errors.append(str(error))
            return None
        if found.status is Status.INTERRUPTED:
            raise Stop(True)
        if not found.success:
            self.errors.append(found.message)
            return None
        return found

    def passing(self, nodes: Sequence[int], q: Sequence[Array]) -> Solution | None:
        """Plan legs without stops between them.

        Args:
            nodes: Nodes, the arm being at rest at the first and the last of them only.
            q: Configurations there, shape (n,) each.

        Returns:
            The better one of two motions: through these configurations, and through any
            that meet the goals on the way; None where none was found.
        """
        way = [self.table.station(node) for node in nodes]
        passed = [self.stations[k] for k in way if k is not None]
        free = any(s.goal.configuration is None for s in passed if not s.stop)
        found = []
        for exactly in (True, False) if free else (True,):
            try:
                found.append(self._plan(self._passing_problem(way, q, exactly)))
            except ProblemError as error:
                self.errors.append(str(error))
        motions = [motion for motion in found if motion is not None]
        return min(motions, key=lambda motion: motion.T, default=None)

    def _passing_problem(
        self, way: Sequence[int | None], q: Sequence[Array], exactly: bool
    ) -> Problem:
        segments = []
        for begin, end, there in zip(way[:-1], way[1:], q[1:], strict=True):
            payload, touch = self._carried(begin, end)
            goal: Goal = JointGoal(there)
            if end is not None and not self.stations[end].stop and not exactly:
                goal = self.stations[end].goal
            segments.append(Segment(goal, payload=payload, may_touch=touch))
        last = segments[-1].goal
        return replace(self.problem, q_start=q[0], goal=last, segments=segments)

    def factor(self) -> float:
        """How much longer legs take than by the estimates of the joints."""
        ratios = []
        for leg, seconds in self.table.known.items():
            guess = float(self.table.times.between(*self.table.rows(leg)))
            if guess > 0.0 and np.isfinite(seconds):
                ratios.append(seconds / guess)
        return max(1.0, float(np.median(ratios))) if ratios else 1.0


def _looks_clear(problem: Problem, motion: Trajectory) -> bool:
    """Whether a motion is clear at some instants, before all are looked at."""
    checker = problem.checker
    margins = problem.margins - 1e-6  # ends may be at the margin
    instants = np.linspace(0.0, motion.duration, CHECKS)
    return all(
        checker.hulls_clear(q) or checker.is_free(q, margins)
        for q in np.concatenate([motion.q, motion(instants).q])
    )
