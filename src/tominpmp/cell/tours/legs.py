"""Legs of a tour: their times, estimated or known, and their motions, each verified.

Without torque limits and obstacles the joints do not know of each other: the least time
between two configurations at rest is that of the slowest joint, which speeds up, runs
at its speed limit and slows down. It is what no motion beats, and near what is planned
where limits of speed and acceleration rule.

A direct motion is one that the joints make on their own: all arrive together, in that
time. Where torques and obstacles do not forbid it, which a replay tells, it is the
fastest there is, and no planning is needed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np

from tominpmp.arrays import Array
from tominpmp.cell.tours.station import Station
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError
from tominpmp.goals.base import Goal
from tominpmp.goals.joints import JointGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import Options
from tominpmp.planner.conclusion import without_search
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment, known_names
from tominpmp.robot.payload import Payload
from tominpmp.solution import Solution
from tominpmp.status import Status
from tominpmp.stopping import Stop, check, seconds_left

# Differences of configurations that are taken at once, for the sake of memory.
CHUNK = 2_000_000
# Displacements that count as zero [rad or m], and differences of instants as shares of
# the duration that count as zero.
NO_WAY = 1e-9
SAME = 1e-9


@dataclass(frozen=True, eq=False)
class JointTimes:
    """Limits of the joints, shape (n,) each, possibly infinite.

    Attributes:
        velocity: Speed limits [rad/s or m/s].
        acceleration: Acceleration limits [rad/s^2 or m/s^2].
        jerk: Jerk limits [rad/s^3 or m/s^3].
    """

    velocity: Array
    acceleration: Array
    jerk: Array

    @classmethod
    def of(cls, problem: Problem) -> JointTimes:
        """Take the limits of a problem."""
        names, limits = problem.robot.joint_names, problem.motion_limits
        limits = MotionLimits() if limits is None else limits
        found = (limits.by_joint(name, names) for name in ("acceleration", "jerk"))
        return cls(problem.robot.limits.velocity, *found)

    @property
    def weights(self) -> Array:
        """Weights by which displacements of joints take about equal time, shape (n,).

        Those of short ways where accelerations are limited: their square roots count.
        """
        slow = 1.0 / self.velocity
        slow = np.maximum(slow, 1e-3 * max(float(slow.max()), 1e-3))
        if not np.all(np.isfinite(self.acceleration)):
            return np.asarray(slow)
        return np.asarray(np.sqrt(slow**2 + 1.0 / self.acceleration))

    def between(self, a: Array, b: Array, resting: int = 2) -> Array:
        """Least times between configurations.

        Args:
            a: Configurations, shape (..., n) [rad or m].
            b: Others, of a shape that fits.
            resting: At how many of both ends the arm is at rest.

        Returns:
            Times [s], shape (...).
        """
        times = self.of_joints(np.abs(b - a), resting)
        return np.asarray(np.max(times, axis=-1, initial=0.0))

    def matrix(self, a: Array, b: Array, resting: int = 2) -> Array:
        """Least times from each of some configurations to each of others.

        Args:
            a: Shape (k, n) [rad or m].
            b: Shape (m, n).
            resting: At how many of both ends the arm is at rest.

        Returns:
            Times [s], shape (k, m).
        """
        out = np.empty((len(a), len(b)))
        rows = max(1, CHUNK // max(1, b.size))
        for begin in range(0, len(a), rows):
            part = slice(begin, begin + rows)
            out[part] = self.between(a[part, None], b[None], resting)
        return out

    def of_joints(self, way: Array, resting: int = 2) -> Array:
        """Least times by joint for distances to go, shape (..., n) both."""
        v, a, jerky = self.velocity, self.acceleration, np.isfinite(self.jerk)
        # Without limits a joint takes no time, whatever the way.
        with np.errstate(divide="ignore", invalid="ignore"):
            cruise = way / v
            if resting == 0:
                return np.asarray(cruise)
            ramps = float(resting)
            short = way * a < 0.5 * ramps * v * v
            peak = np.sqrt(2.0 * ramps * way / a)
            speeding = np.where(np.isfinite(a), 0.5 * ramps * v / a, 0.0)
            times = np.where(short, peak, cruise + speeding)
            if resting == 2 and np.any(jerky):
                limits = (limit[jerky] for limit in (v, a, self.jerk))
                times[..., jerky] = _with_jerk(way[..., jerky], *limits)
            return times


def _with_jerk(way: Array, v: Array, a: Array, jerk: Array) -> Array:
    """Least times from rest to rest, where accelerations begin and end with zero."""
    ramp = np.where(v * jerk >= a * a, v / a + a / jerk, 2.0 * np.sqrt(v / jerk))
    # From this speed on the full acceleration is reached; without a limit of it never.
    knee = a * a / jerk
    # Peak speed of a motion that reaches it, but not the speed limit.
    full = 0.5 * (np.sqrt(knee * knee + 4.0 * a * way) - knee)
    part = (0.5 * way * np.sqrt(jerk)) ** (2.0 / 3.0)
    peaked = np.where(
        full >= knee, 2.0 * (full / a + a / jerk), 4.0 * np.sqrt(part / jerk)
    )
    long = np.isfinite(v) & (v * ramp <= way)
    return np.where(way > 0.0, np.where(long, way / v + ramp, peaked), 0.0)


# A leg: node and configuration it begins at, node and configuration it ends at.
Leg = tuple[int, int, int, int]
# Nodes of a leg, or configurations there.
Pair = tuple[int, int]


@dataclass(eq=False)
class LegTable:
    """Times of legs between the nodes of a tour.

    Nodes are the start (0), the stations (1 to n) and, if it is given, the end (n + 1);
    each has some configurations. Times that are not known are estimates.

    Attributes:
        nodes: Configurations of each node, shape (k, n) each.
        rests: Whether the arm is at rest at each node.
        times: Estimates.
        ends: Whether the last node is the end of the tour, else it ends anywhere.
        factor: What estimates are multiplied by.
        known: Times that were found, by the nodes of a leg and by the configurations
            there; infinite where there is no motion [s].
    """

    nodes: list[Array]
    rests: Sequence[bool]
    times: JointTimes
    ends: bool
    factor: float = 1.0
    known: dict[Pair, dict[Pair, float]] = field(default_factory=dict)

    @property
    def stations(self) -> int:
        """Number of stations."""
        return len(self.nodes) - 1 - self.ends

    def station(self, node: int) -> int | None:
        """Index of the station at a node; None for the start and the end."""
        return node - 1 if 0 < node <= self.stations else None

    def way(self, order: Sequence[int]) -> list[int]:
        """Nodes of an order of stations, with the start and the end."""
        end = [self.stations + 1] if self.ends else []
        return [0, *(i + 1 for i in order), *end]

    def rows(self, leg: Leg) -> tuple[Array, Array]:
        """Configurations that a leg begins and ends at, shape (n,) each."""
        i, a, j, b = leg
        return self.nodes[i][a], self.nodes[j][b]

    def resting(self, i: int, j: int) -> int:
        """At how many of two nodes the arm is at rest."""
        return int(self.rests[i]) + int(self.rests[j])

    def block(self, i: int, j: int) -> Array:
        """Times from each configuration of a node to each of another, shape (k, m)."""
        nodes, resting = self.nodes, self.resting(i, j)
        times = self.factor * self.times.matrix(nodes[i], nodes[j], resting)
        for pair, value in self.known.get((i, j), {}).items():
            times[pair] = value
        return times

    def learn(self, leg: Leg, seconds: float) -> None:
        """Take down the time of a leg."""
        i, a, j, b = leg
        self.known.setdefault((i, j), {})[a, b] = seconds

    def found(self, leg: Leg) -> float | None:
        """Time of a leg that was found [s]; None where it is not known."""
        i, a, j, b = leg
        return self.known.get((i, j), {}).get((a, b))

    def time(self, leg: Leg) -> float:
        """Time of a leg, known or estimated [s]."""
        known, resting = self.found(leg), self.resting(leg[0], leg[2])
        if known is not None:
            return known
        return self.factor * float(self.times.between(*self.rows(leg), resting))

    def calibrate(self) -> None:
        """Take the factor of the estimates from the times that are known."""
        ratios = []
        for (i, j), known in self.known.items():
            for (a, b), seconds in known.items():
                guess = float(self.times.between(*self.rows((i, a, j, b))))
                if guess > 0.0 and np.isfinite(seconds):
                    ratios.append(seconds / guess)
        self.factor = max(1.0, float(np.median(ratios))) if ratios else 1.0

    def along(self, order: Sequence[int], rows: list[Array]) -> LegTable:
        """A table of other configurations for the nodes of a tour, in their order."""
        rests = [self.rests[node] for node in order]
        return replace(self, nodes=rows, rests=rests, ends=True, known={})

    def fixed(self, chosen: Sequence[int]) -> Array:
        """Times between the nodes with one configuration each, shape (nodes, nodes)."""
        rows = zip(self.nodes, chosen, strict=True)
        q = np.stack([rows_of[c] for rows_of, c in rows])
        out = np.empty((len(q), len(q)))
        rests = np.array(self.rests, dtype=int)
        resting = rests[:, None] + rests
        for count in np.unique(resting).tolist():
            which = resting == count
            out[which] = self.factor * self.times.matrix(q, q, count)[which]
        for (i, j), known in self.known.items():
            out[i, j] = known.get((chosen[i], chosen[j]), out[i, j])
        np.fill_diagonal(out, 0.0)
        return out

    def best_configurations(self, order: Sequence[int]) -> tuple[float, list[int]]:
        """Best configurations for nodes in a given order, by dynamic programming.

        Args:
            order: Nodes, the start and the end among them.

        Returns:
            Time of all legs [s], and the configuration of each.
        """
        cost = np.zeros(len(self.nodes[order[0]]))
        came: list[Array] = []
        for i, j in pairwise(order):
            through = cost[:, None] + self.block(i, j)
            came.append(np.argmin(through, axis=0))
            cost = np.min(through, axis=0)
        chosen = [int(np.argmin(cost))]
        for back in reversed(came):
            chosen.append(int(back[chosen[-1]]))
        return float(np.min(cost)), chosen[::-1]


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
    # The longer joints speed up, at most half of the time, the slower they need to.
    ramp = np.minimum(T - far / times.velocity, 0.5 * T)
    alike = float(np.min(ramp))
    if np.all(far <= alike * (T - alike) * times.acceleration * (1.0 + 1e-9)):
        # Then the way is a straight line.
        ramp = np.full_like(far, alike)
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
    motion = Trajectory(problem.robot.joint_names, t, q, v, np.zeros_like(q), a=a)
    return motion.with_torques(RobotDynamics(problem.robot).inverse)


# Message of direct motions.
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
    # Loads of other legs are not there to touch anything.
    pairs = [pair for pair in touch if set(pair) <= known]
    return replace(problem, robot=robot, may_touch=(*problem.may_touch, *pairs))


@dataclass(eq=False)
class Legs:
    """The motions of the legs of a tour, direct or planned.

    Attributes:
        problem: Robot, obstacles and limits.
        stations: The stations.
        options: How legs are planned that are not direct.
        table: The nodes of the tour.
        planned: How many legs were planned.
        errors: Sentences on legs that cannot be.
        motions: Motions of the legs that were looked at; None where there is none.
    """

    problem: Problem
    stations: tuple[Station, ...]
    options: Options
    table: LegTable
    planned: int = 0
    errors: list[str] = field(default_factory=list)
    motions: dict[Leg, Solution | None] = field(default_factory=dict)
    _settings: dict[tuple[int | None, int | None], Problem] = field(
        default_factory=dict
    )

    # -- problems of legs --------------------------------------------------------------

    def _load(self, station: int | None) -> Payload | None:
        """What is carried from a station, by its index; None for the start."""
        return None if station is None else self.stations[station].payload

    def _setting(self, begin: int | None, end: int | None) -> Problem:
        """The problem with the load between two stations, and what may touch there.

        Args:
            begin: Index of the station where the leg begins; None for the start.
            end: Where it ends; None for the end of the tour.
        """
        ends = [self.stations[index] for index in (begin, end) if index is not None]
        touch = [pair for station in ends for pair in station.may_touch]
        payload, key = self._load(begin), (begin, end if touch else None)
        if payload is None and not touch:
            return self.problem
        if key not in self._settings:
            self._settings[key] = carrying(self.problem, payload, touch)
        return self._settings[key]

    def _problem(self, leg: Leg) -> Problem:
        """The problem of a leg.

        Raises:
            ProblemError: If there cannot be such a leg.
        """
        begin, end = self.table.station(leg[0]), self.table.station(leg[2])
        q_start, q_end = self.table.rows(leg)
        goal = JointGoal(q_end, wrap=False)
        return self._setting(begin, end).with_ends(q_start, goal)

    def stays(self, leg: Leg) -> bool:
        """Whether a leg leads nowhere."""
        begin, end = self.table.rows(leg)
        return float(np.max(np.abs(begin - end), initial=0.0)) < NO_WAY

    # -- motions -----------------------------------------------------------------------

    def seconds(self, leg: Leg) -> float:
        """Time of a leg, infinite where there is no motion."""
        if self.stays(leg):
            return 0.0
        found = self.motion(leg)
        return np.inf if found is None else found.T

    def motion(self, leg: Leg) -> Solution | None:
        """The motion of a leg from rest to rest; None where none is found."""
        if leg not in self.motions:
            check()
            self.motions[leg] = self._found(partial(self._problem, leg))
        return self.motions[leg]

    def _found(self, made: Callable[[], Problem]) -> Solution | None:
        """The direct motion, or one that is planned in the time that is left.

        Args:
            made: Makes the problem.
        """
        try:
            problem = made()
            found = self._direct(problem)
            if found is not None:
                return found
            left = seconds_left()
            if np.isfinite(left):
                self.options = replace(self.options, max_planning_time=left)
            self.planned += 1
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

    def _direct(self, problem: Problem) -> Solution | None:
        """The direct motion; None where there is none, or its replay refuses it."""
        started = time.perf_counter()
        # The knots of a direct motion are on no clock.
        clocked = self.options.control_period is not None
        motion = None if clocked else direct_motion(problem)
        if motion is None:
            return None
        reason = "limits of speed and acceleration"
        return without_search(problem, self.options, motion, DIRECT, reason, started)

    def passing(self, nodes: Sequence[int], q: Sequence[Array]) -> Solution | None:
        """Plan legs without stops between them; None where no motion is found.

        Args:
            nodes: Nodes, the arm being at rest at the first and the last of them only.
            q: Configurations there, shape (n,) each; between them others will do that
                meet the goals.
        """
        way = [self.table.station(node) for node in nodes]
        goals: list[Goal] = [JointGoal(there, wrap=False) for there in q[1:]]
        for place, k in enumerate(way[1:-1]):
            if k is not None:
                goals[place] = self.stations[k].goal

        def made() -> Problem:
            segments = [
                Segment(
                    goal,
                    payload=self._load(begin),
                    may_touch=self._setting(begin, end).may_touch,
                )
                for goal, (begin, end) in zip(goals, pairwise(way), strict=True)
            ]
            begin, end = q[0], goals[-1]
            return replace(self.problem, q_start=begin, goal=end, segments=segments)

        return self._found(made)
