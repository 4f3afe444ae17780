"""Legs of a tour: their times, estimated or known, and their motions, each verified.

Without torque limits and obstacles the joints are independent: the least time between
two configurations at rest is the least time of the slowest joint, which accelerates,
cruises at its speed limit and decelerates. It is a lower bound for every motion, and
close to the planned time where limits of speed and acceleration are active.

In a direct motion each joint moves independently, and all arrive together in that
time. If the replay finds no violated torque limit and no collision, the direct motion
is optimal, and no planning is needed.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.bounds.joints import tightest_limits
from tominpmp.cell.tours.station import Rules, Station, label_of
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError
from tominpmp.goals.joints import JointGoal
from tominpmp.initial_guess.timing import between_velocities
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.conclusion import without_search
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment, known_names
from tominpmp.robot.payload import Payload
from tominpmp.solution import Solution
from tominpmp.status import Status
from tominpmp.stopping import Stop, check, seconds_left

# Displacement below which a leg has zero length [rad or m], and difference below which
# instants are equal, as a share of the duration.
ZERO_LENGTH = 1e-9
SAME = 1e-9


# Number of ends at which the arm is at rest, of one motion or of each of several.
Resting: TypeAlias = int | IntArray


@dataclass(frozen=True, eq=False)
class JointTimes:
    """Least times of the joints, each by itself, from limits of its motion.

    The limits have shape (n,) each, and may be infinite.

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
        most = tightest_limits(problem)
        return cls(most["v"], most["a"], most["j"])

    @property
    def weights(self) -> Array:
        """Weights with which displacements of joints take about equal time, shape (n,).

        For short displacements the limits of acceleration count, and their square
        roots, as the time is the root of displacement over acceleration.
        """
        slow = 1.0 / self.velocity
        slow = np.maximum(slow, 1e-3 * max(float(slow.max()), 1e-3))
        if not np.all(np.isfinite(self.acceleration)):
            return np.asarray(slow)
        return np.asarray(np.sqrt(slow**2 + 1.0 / self.acceleration))

    def between(self, a: Array, b: Array, resting: Resting = 2) -> Array:
        """Least times between configurations.

        Args:
            a: Configurations, shape (..., n) [rad or m].
            b: Other configurations, of a shape that broadcasts against ``a``.
            resting: Number of ends, of the two, at which the arm is at rest; for all
                of them, or shape (...).

        Returns:
            Times [s], shape (...).
        """
        times = self.of_joints(np.abs(b - a), resting)
        return np.asarray(np.max(times, axis=-1, initial=0.0))

    def of_joints(self, distance: Array, resting: Resting = 2) -> Array:
        """Least times [s] of joints for distances [rad or m], shape (..., n) both."""
        v, a, rests = self.velocity, self.acceleration, np.asarray(resting)[..., None]
        jerky = np.isfinite(self.jerk) & (rests == 2)
        # Without limits a joint takes no time, whatever the distance.
        with np.errstate(divide="ignore", invalid="ignore"):
            short = distance * a < 0.5 * rests * v * v
            peak = np.sqrt(2.0 * rests * distance / a)
            speeding = np.where(np.isfinite(a) & (rests > 0), 0.5 * rests * v / a, 0.0)
            times = np.where(short, peak, distance / v + speeding)
            if np.any(jerky):
                times = np.where(jerky, _with_jerk(distance, v, a, self.jerk), times)
            return np.asarray(times)


def _with_jerk(distance: Array, v: Array, a: Array, jerk: Array) -> Array:
    """Least times from rest to rest with zero acceleration at both ends [s].

    They have the shape of the distances.
    """
    ramp = np.where(v * jerk >= a * a, v / a + a / jerk, 2.0 * np.sqrt(v / jerk))
    # Least peak speed at which the acceleration limit is reached; infinite without one.
    knee = a * a / jerk
    # Peak speed of a motion below the speed limit that reaches the acceleration limit,
    # and of a motion that does not.
    full = 0.5 * (np.sqrt(knee * knee + 4.0 * a * distance) - knee)
    low = (0.5 * distance * np.sqrt(jerk)) ** (2.0 / 3.0)
    peaked = np.where(
        full >= knee, 2.0 * (full / a + a / jerk), 4.0 * np.sqrt(low / jerk)
    )
    cruises = np.isfinite(v) & (v * ramp <= distance)
    return np.where(distance > 0.0, np.where(cruises, distance / v + ramp, peaked), 0.0)


# A node of a tour, and the index of one of its configurations.
Place = tuple[int, int]
# A leg: the places where it begins and ends.
Leg = tuple[Place, Place]


@dataclass(eq=False)
class LegTable:
    """Times of legs between the nodes of a tour.

    Nodes are the start (0), the stations (1 to n) and, if it is given, the end (n + 1):
    start and end have one configuration, stations one or more. Times that are not known
    are estimated.

    Attributes:
        nodes: Configurations of each node, shape (k, n) each.
        rests: Whether the arm is at rest at each node.
        times: Least times of the joints, from which times are estimated.
        rules: Orders of the stations that are allowed.
        factor: Factor of the estimates.
        known: Times of planned legs [s]; infinite where no motion was found.
    """

    nodes: list[Array]
    rests: Sequence[bool]
    times: JointTimes
    rules: Rules
    factor: float = 1.0
    known: dict[Leg, float] = field(default_factory=dict)

    def rows(self, leg: Leg) -> tuple[Array, Array]:
        """Configurations that a leg begins and ends at, shape (n,) each."""
        (i, a), (j, b) = leg
        return self.nodes[i][a], self.nodes[j][b]

    def resting(self, i: int, j: int) -> int:
        """Number of nodes, of the two, at which the arm is at rest."""
        return self.rests[i] + self.rests[j]

    def block(self, i: int, j: int) -> Array:
        """Times from each configuration of a node to each of another, shape (k, m)."""
        begins, ends = self.nodes[i][:, None], self.nodes[j]
        times = self.factor * self.times.between(begins, ends, self.resting(i, j))
        for ((begin, a), (end, b)), seconds in self.known.items():
            if (begin, end) == (i, j):
                times[a, b] = seconds
        return times

    def time(self, leg: Leg) -> float:
        """Time of a leg, known or estimated [s]."""
        (i, a), (j, b) = leg
        return float(self.block(i, j)[a, b])

    def calibrate(self) -> None:
        """Set the factor of estimates to the median of known over least times, or 1."""
        ratios = []
        for leg, seconds in self.known.items():
            guess = float(self.times.between(*self.rows(leg)))
            if guess > 0.0 and np.isfinite(seconds):
                ratios.append(seconds / guess)
        self.factor = max(1.0, float(np.median(ratios))) if ratios else 1.0

    def along(self, order: Sequence[int], rows: list[Array]) -> LegTable:
        """A table of the nodes of a tour in their order, with other configurations."""
        rests = [self.rests[node] for node in order]
        return replace(self, nodes=rows, rests=rests, known={})

    def fixed(self, chosen: Sequence[int]) -> Array:
        """Times between the nodes with one configuration each, shape (nodes, nodes)."""
        q = np.stack([self.nodes[k][c] for k, c in enumerate(chosen)])
        rests = np.array(self.rests, dtype=int)
        # Row by row, to bound the memory.
        rows = zip(q, rests, strict=True)
        each = [self.times.between(here, q, rest + rests) for here, rest in rows]
        out = self.factor * np.array(each)
        for ((i, a), (j, b)), seconds in self.known.items():
            if (a, b) == (chosen[i], chosen[j]):
                out[i, j] = seconds
        np.fill_diagonal(out, 0.0)
        return out

    def best_configurations(self, order: Sequence[int]) -> tuple[float, list[Place]]:
        """Best configurations for nodes in a given order, by dynamic programming.

        Args:
            order: Nodes, the start and the end included.

        Returns:
            Time of all legs [s], and the nodes with their configurations' indices.
        """
        cost = np.zeros(len(self.nodes[order[0]]))
        predecessors: list[Array] = []
        for i, j in pairwise(order):
            through = cost[:, None] + self.block(i, j)
            predecessors.append(np.argmin(through, axis=0))
            cost = np.min(through, axis=0)
        chosen = [int(np.argmin(cost))]
        for best in reversed(predecessors):
            chosen.append(int(best[chosen[-1]]))
        return float(np.min(cost)), list(zip(order, chosen[::-1], strict=True))


def direct_motion(problem: Problem) -> Trajectory | None:
    """Make the fastest motion that limits of speed and acceleration allow.

    Args:
        problem: A problem from rest to a configuration at rest.

    Returns:
        The motion, with a constant acceleration on each interval; None if its velocity
        would jump, if accelerations may not jump, or if start and goal are equal.
    """
    limits, goal = problem.motion_limits, problem.goal.configuration
    if goal is None or problem.segments or (limits is not None and limits.continuous):
        return None
    times, distance = JointTimes.of(problem), np.abs(goal - problem.q_start)
    moves = distance > ZERO_LENGTH
    T = float(times.between(problem.q_start, goal))
    sudden = moves & ~np.isfinite(times.acceleration)
    if not np.any(moves) or np.any(sudden) or not 0.0 < T < np.inf:
        return None
    # Longest ramp of each joint, at most half of T, for the least acceleration.
    ramp, top = np.minimum(T - distance / times.velocity, 0.5 * T), times.velocity
    alike = float(np.min(ramp))
    if np.all(distance <= alike * (T - alike) * times.acceleration * (1.0 + 1e-9)):
        # With equal ramps the path is a straight line.
        ramp, top = np.full_like(distance, alike), distance / (T - alike)
    t = np.unique(np.concatenate([[0.0, T], ramp, T - ramp]))
    t = t[np.append(True, np.diff(t) > SAME * T)]
    t[-1] = T
    rest = np.zeros_like(goal)
    ends = problem.q_start, rest, goal, rest
    _, q, v, *_ = between_velocities(ends, top, T, t)
    a = between_velocities(ends, top, T, 0.5 * (t[1:] + t[:-1])).a
    q[-1], v[-1] = goal, rest
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
    """A problem with a payload, and more pairs that may touch.

    Start and goal are not checked: a leg has others.
    """
    robot = problem.robot
    if payload is not None:
        robot = robot.with_payload(payload)
    known = known_names(robot, problem.scene)
    # Pairs with payloads of other legs do not apply to this leg.
    pairs = [*problem.may_touch, *(pair for pair in touch if set(pair) <= known)]
    stale = "checker", "margins", "ready_constraints"
    return problem._altered(*stale, robot=robot, may_touch=tuple(pairs))


@dataclass(eq=False)
class Legs:
    """The motions of the legs of a tour, direct or planned.

    Attributes:
        problem: Robot, obstacles and limits.
        stations: The station at each node; None for the start and the end.
        options: Options of the planner for legs without a direct motion.
        table: The nodes of the tour.
        planned: Number of legs that were planned.
        errors: Messages on legs without a motion, with their stations.
        motions: Motions of the legs looked at so far; None for a leg without a motion.
    """

    problem: Problem
    stations: Sequence[Station | None]
    options: Options
    table: LegTable
    planned: int = 0
    errors: list[str] = field(default_factory=list)
    motions: dict[Leg, Solution | None] = field(default_factory=dict)
    _settings: dict[tuple[int, int | None], Problem] = field(default_factory=dict)

    # -- problems of legs --------------------------------------------------------------

    def _load(self, node: int) -> Payload | None:
        """The payload from a node on."""
        station = self.stations[node]
        return None if station is None else station.payload

    def _setting(self, begin: int, end: int) -> Problem:
        """The problem with the payload and the allowed contacts between two nodes."""
        ends = filter(None, (self.stations[begin], self.stations[end]))
        touch = [pair for station in ends for pair in station.may_touch]
        payload, key = self._load(begin), (begin, end if touch else None)
        if payload is None and not touch:
            return self.problem
        if key not in self._settings:
            self._settings[key] = carrying(self.problem, payload, touch)
        return self._settings[key]

    # -- motions -----------------------------------------------------------------------

    def seconds(self, leg: Leg) -> float:
        """Time of a leg from rest to rest [s]; infinite if no motion is found."""
        q_start, q_end = self.table.rows(leg)
        if float(np.max(np.abs(q_start - q_end), initial=0.0)) < ZERO_LENGTH:
            return 0.0
        if leg not in self.motions:
            check()
            (begin, _), (end, _) = leg
            self.motions[leg] = self.motion((begin, end), (q_start, q_end))
        solution = self.motions[leg]
        return np.inf if solution is None else solution.T

    def motion(self, nodes: Sequence[int], q: Sequence[Array]) -> Solution | None:
        """The direct motion, or a motion planned in the remaining time.

        Args:
            nodes: Nodes, the arm being at rest at the first and the last of them only.
            q: Configurations there, shape (n,) each; at the nodes in between the motion
                may meet the goals at other configurations.

        Returns:
            The motion; None if none is found, with the reason among the errors.
        """
        first, last = self.stations[nodes[0]], self.stations[nodes[-1]]
        here = label_of(nodes[0], first.name) if first else "the start"
        there = label_of(nodes[-1], last.name) if last else "the end"
        where = f"from {here} to {there}: "
        try:
            problem = self._problem(nodes, q)
            solution = self._direct(problem)
            if solution is not None:
                return solution
            left = seconds_left()
            if np.isfinite(left):
                self.options = replace(self.options, max_planning_time=left)
            self.planned += 1
            solution = plan(problem, self.options)
        except ProblemError as error:
            self.errors.append(where + str(error))
            return None
        if solution.status is Status.INTERRUPTED:
            raise Stop(True)
        if not solution.success:
            self.errors.append(where + solution.message)
            return None
        return solution

    def _problem(self, nodes: Sequence[int], q: Sequence[Array]) -> Problem:
        """The problem of a motion, see :meth:`motion`; of segments between its nodes.

        Raises:
            ProblemError: If the motion cannot begin or end there.
        """
        end = JointGoal(q[-1], wrap=False)
        if len(nodes) == 2:
            return self._setting(*nodes).with_ends(q[0], end)
        passed = filter(None, (self.stations[node] for node in nodes[1:-1]))
        goals = [*(station.goal for station in passed), end]
        segments = [
            Segment(
                goal,
                payload=self._load(begin),
                may_touch=self._setting(begin, end).may_touch,
            )
            for goal, (begin, end) in zip(goals, pairwise(nodes), strict=True)
        ]
        return replace(self.problem, q_start=q[0], goal=end, segments=segments)

    def _direct(self, problem: Problem) -> Solution | None:
        """The direct motion; None if no motion is direct, or if its replay fails."""
        started = time.perf_counter()
        # The knots of a direct motion are not multiples of a control period.
        clocked = self.options.control_period is not None
        motion = None if clocked else direct_motion(problem)
        if motion is None:
            return None
        reason = "limits of speed and acceleration"
        return without_search(problem, self.options, motion, DIRECT, reason, started)
