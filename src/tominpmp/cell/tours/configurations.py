"""Configurations at which a robot meets the goals of stations.

Goals on frames leave a choice: inverse kinematics has several branches, and a drill may
spin about its axis. Configurations are found from random starts. (Starts at the
configurations of neighbouring stations made tours of UR5 and Panda no shorter in the
mean.)

Configurations are then improved for a given order, as spins and redundant joints are
not on a grid: for each station, trials begin near its configuration, towards those of
the previous and the next station, half way between the two, and at random. Dynamic
programming chooses the best combination over all stations, and the radius of the
trials shrinks.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.cell.farthest_points import spread_out
from tominpmp.cell.tours.legs import JointTimes, LegTable, Place, carrying
from tominpmp.cell.tours.station import TourTask, label_of
from tominpmp.exceptions import ProblemError
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import FrameTarget, frame_target
from tominpmp.goals.joints import nearest_turns
from tominpmp.goals.place import Scales
from tominpmp.goals.sets import passed
from tominpmp.initial_guess.unreachable import unreachable
from tominpmp.kinematics import FrameMotions, RobotKinematics, times
from tominpmp.least_squares import LONGEST_STEP, least_squares
from tominpmp.problem.problem import Problem
from tominpmp.problem.state_checks import holding
from tominpmp.robot.robot import Robot
from tominpmp.transcription.problem_functions import ProblemFunctions


class GoalRows:
    """Residuals of goals at configurations, each with its own goal.

    Poses, directions and positions are taken as exact, without their tolerances; their
    residual is the rotation vector and the displacement that would bring the frame to
    the target, to first order.

    Attributes:
        goals: The goals.
        kinematics: Kinematics of the robot.
        rows: Number of rows of a residual; shorter residuals are padded with zeros.
    """

    def __init__(self, robot: Robot, goals: Sequence[Goal]) -> None:
        self.goals, self.kinematics = tuple(goals), RobotKinematics(robot)
        nothing = FrameTarget(np.zeros(3), np.zeros((3, 3)), np.zeros((6, 6)), False)
        targets = [frame_target(goal) or nothing for goal in goals]
        zero = np.zeros(robot.n)
        self.rows = max(6, *(g.place(self.kinematics, zero).value.size for g in goals))
        self._targets = tuple(np.stack(part) for part in zip(*targets, strict=True))
        # Goals of other kinds are evaluated one by one; their frame has an empty name.
        named = zip(goals, targets, strict=True)
        frames = [str(g.frame_name) if t is not nothing else "" for g, t in named]
        self._frames = np.array(frames)
        self._motions = {name: FrameMotions(robot, name) for name in {*frames} - {""}}

    def __call__(self, q: Array, which: IntArray) -> tuple[Array, Array]:
        """Evaluate residuals.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            which: Index of the goal of each configuration, shape (m,).

        Returns:
            Residuals, shape (m, rows) [rad or m], and their Jacobians, shape (m, rows,
            n).
        """
        value = np.zeros((len(q), self.rows))
        jacobian = np.zeros((*value.shape, q.shape[1]))
        frames = self._frames[which]
        for name, motions in self._motions.items():
            mine = np.flatnonzero(frames == name)
            rows = self._of_frame(motions, q[mine], which[mine])
            value[mine, :6], jacobian[mine, :6] = rows
        for i in np.flatnonzero(frames == "").tolist():
            goal = self.goals[which[i]]
            residual, by_q = goal.place_residual(self.kinematics, q[i])
            value[i, : residual.size], jacobian[i, : residual.size] = residual, by_q
        return value, jacobian

    def _of_frame(
        self, motions: FrameMotions, q: Array, which: IntArray
    ) -> tuple[Array, Array]:
        """Residuals of goals on one frame: rotation in rows 0 to 2, position below."""
        rotation, origin = motions.placements(q)
        place, turn, counts, posed = (field[which] for field in self._targets)
        twist = np.hstack([np.zeros_like(origin), place - origin])
        if np.any(posed):
            error = turn[posed] @ rotation[posed].swapaxes(1, 2)
            twist[posed, :3] = Rotation.from_matrix(error).as_rotvec()
        axis = times(rotation[~posed], turn[~posed, 0])
        twist[~posed, :3] = _turns_between(axis, turn[~posed, 1])
        # Jacobians of frames have the translation above the rotation.
        slope = np.roll(motions.jacobians(q), 3, axis=1)
        return -times(counts, twist), counts @ slope


def _turns_between(a: Array, b: Array) -> Array:
    """Shortest rotation vectors from unit vectors a to b, shapes (m, 3) [rad]."""
    normal = np.cross(a, b)
    sine = np.linalg.norm(normal, axis=1)
    angle = np.arctan2(sine, np.sum(a * b, axis=1))
    # Between opposite vectors every perpendicular axis is as good.
    opposite = (sine < 1e-9) & (angle > 1.0)
    normal[opposite] = np.cross(a[opposite], np.roll(a[opposite], 1, axis=1) + 0.1)
    length = np.where(opposite, np.linalg.norm(normal, axis=1), sine)
    return np.asarray(normal * (angle / np.maximum(length, 1e-300))[:, None])


# Steps of the damped least squares.
STEPS = 40
# Residual below which a goal is reached [m, rad].
REACHED = 1e-7
# Range of random starts about the start of the tour [rad, or shares of the length that
# counts as 1 rad].
AROUND = np.pi
# Configurations count as equal if they differ by less in all joints [rad or m].
DISTINCT = 0.02
# Configurations that are projected at once, to bound the memory.
CHUNK = 8_192
# Number of random starts for a station, and for a station that they did not solve.
STARTS, MORE_STARTS = 24, 400
# Rounds of the refinement, random trials of a station in each round, and the radius of
# the trials in the first round [rad].
ROUNDS, TRIALS, RADIUS = 24, 4, 0.4
# Factor by which the radius shrinks, and the gain of a round, as a share of the time,
# below which it does.
SHRINK, LEAST_GAIN = 0.6, 2e-3
# Radius at which the refinement ends [rad].
LEAST_RADIUS = 2e-3


class Configurations:
    """Finds configurations at which a robot meets the goals of stations.

    Attributes:
        problem: Robot, obstacles and limits.
        stations: The stations.
        goals: Their goals.
        weights: Weights of the joints in the length of a displacement, shape (n,).
        leaving: By the index of a station with a payload, the problem with the payload.
        rng: Random numbers.
    """

    def __init__(self, task: TourTask, rng: np.random.Generator) -> None:
        problem, stations = task.problem, task.stations
        goals = tuple(station.goal for station in stations)
        self.problem, self.stations, self.goals = problem, stations, goals
        self.weights, self.rng = JointTimes.of(problem).weights, rng
        # The next station is unknown, so the allowed contacts of all stations count.
        touch = [pair for station in stations for pair in station.may_touch]
        self.leaving = {
            k: carrying(problem, station.payload, touch)
            for k, station in enumerate(stations)
            if station.payload is not None
        }
        # The alternatives of all goals in one list: their number by goal, and the index
        # of the first alternative of each goal.
        every = [alternative for goal in goals for alternative in goal.alternatives]
        self._counts: IntArray = np.array([len(goal.alternatives) for goal in goals])
        self._first: IntArray = np.cumsum(self._counts) - self._counts
        self._rows = GoalRows(problem.robot, every)
        kinematics, home = self._rows.kinematics, problem.q_start
        scales = [Scales.of(kinematics, goal.place(kinematics, home)) for goal in every]
        self._scales = np.stack([scale.joints for scale in scales])
        # Joints that do not carry the frame of a goal.
        self._idle = np.zeros(self._scales.shape, dtype=bool)
        for row, goal in zip(self._idle, every, strict=True):
            if goal.frame_name is not None:
                row[:] = ~np.any(kinematics.jacobian(home, goal.frame_name), axis=0)

    def _solved(self, q: Array, aim: IntArray) -> tuple[Array, BoolArray]:
        """Nearest configurations that meet alternatives, by damped least squares.

        Args:
            q: Starts, shape (m, n) [rad or m].
            aim: Index of the alternative of each start, shape (m,).

        Returns:
            Configurations, shape (m, n), and whether each meets its alternative, shape
            (m,).
        """
        out, residual = np.array(q), np.zeros(len(q))
        limits = self.problem.robot.limits
        for begin in range(0, len(q), CHUNK):
            chunk = slice(begin, begin + CHUNK)
            which, scales = aim[chunk], self._scales[aim[chunk]]
            out[chunk], residual[chunk] = least_squares(
                partial(self._residual, which),
                q[chunk],
                (limits.position_lower, limits.position_upper),
                scales / self.weights,
                LONGEST_STEP * scales,
                reached=REACHED,
                steps=STEPS,
            )
        return out, residual < REACHED

    def _residual(self, aim: IntArray, q: Array, rows: IntArray) -> tuple[Array, Array]:
        return self._rows(q, aim[rows])

    def _nearest_alternatives(self, q: Array, which: IntArray) -> IntArray:
        """Index of the alternative with the smallest residual at each q, shape (m,)."""
        counts = self._counts[which]
        if np.all(counts == 1):
            return self._first[which]
        # The alternatives of all starts, one start after the other.
        row = np.repeat(np.arange(len(which)), counts)
        begin = np.cumsum(counts) - counts
        aim = np.arange(len(row)) + np.repeat(self._first[which] - begin, counts)
        missed = np.max(np.abs(self._rows(q[row], aim)[0]), axis=1)
        nearest: IntArray = aim[np.lexsort((missed, row))[begin]]
        return nearest

    def free(self, q: Array, g: int) -> BoolArray:
        """Whether configurations are admissible at a station, shape (m,).

        An admissible configuration is clear of collisions, also with the payload that
        leaves the station, and keeps the constraints; where the arm stops, it can hold
        this payload.
        """
        loaded = self.leaving.get(g)
        both = [self.problem] if loaded is None else [self.problem, loaded]
        kept = np.array([all(_keeps(p, row) for p in both) for row in q], dtype=bool)
        if loaded is not None and self.stations[g].stop:
            kept &= np.all(holding(loaded.robot, q)[1], axis=1)
        return kept

    def search(self, count: int) -> list[Array]:
        """Find some configurations for each station.

        Args:
            count: Largest number of configurations kept of a station.

        Returns:
            Configurations by station, shape (k, n) each.

        Raises:
            ProblemError: If a station has no configuration, with its name.
        """
        pools: list[Array] = [np.zeros((0, self.problem.robot.n)) for _ in self.goals]
        searched = []
        for g, goal in enumerate(self.goals):
            fixed = [item.configuration for item in goal.alternatives]
            rows = [q for q in fixed if q is not None]
            if rows:
                pools[g] = np.stack(rows)
                # A single configuration was checked with the goals of all stations.
                if len(rows) > 1 or g in self.leaving:
                    pools[g] = pools[g][self.free(pools[g], g)]
            if len(rows) < len(fixed):
                searched.append(g)
        self._from_starts(pools, searched, STARTS)
        empty = [g for g in searched if not len(pools[g])]
        self._from_starts(pools, empty, MORE_STARTS)
        for g, pool in enumerate(pools):
            if not len(pool):
                raise self._unreached(g)
        return [self.spread(pool, count) for pool in pools]

    def _from_starts(self, pools: list[Array], which: list[int], count: int) -> None:
        """Add new, free solutions from random starts to the pools of stations."""
        robot, home = self.problem.robot, self.problem.q_start
        owner: IntArray = np.repeat(np.array(which, dtype=np.int64), count)
        # Alternatives are aimed at in turn.
        number = np.tile(np.arange(count), len(which))
        aim = self._first[owner] + number % self._counts[owner]
        # Starts are within half a turn of the start of the tour.
        around = AROUND * self._scales[self._first[owner]]
        low = np.maximum(robot.limits.position_lower, home - around)
        high = np.minimum(robot.limits.position_upper, home + around)
        starts = self.rng.uniform(low, high)
        starts[::count] = home
        # Joints that do not carry the frame keep their positions.
        q, good = self._solved(np.where(self._idle[aim], home, starts), aim)
        for g in np.unique(owner[good]).tolist():
            mine = nearest_turns(robot, q[good & (owner == g)], home)
            new = distinct(np.concatenate([pools[g], mine]))[len(pools[g]) :]
            pools[g] = np.concatenate([pools[g], new[self.free(new, g)]])

    def spread(self, rows: Array, count: int) -> Array:
        """Choose configurations far from each other, by farthest-point sampling.

        Args:
            rows: The configurations, shape (k, n) [rad or m].
            count: Largest number of them to keep.

        Returns:
            The chosen rows, in their order.
        """
        if len(rows) <= count:
            return rows
        scaled = rows * self.weights
        nearest = np.max(np.abs(scaled - self.problem.q_start * self.weights), axis=1)
        chosen = spread_out(scaled, int(np.argmin(nearest)), count, np.inf)
        return np.asarray(rows[np.sort(chosen)])

    def refined(self, table: LegTable, places: Sequence[Place]) -> list[Array]:
        """Improve the configurations of a tour in a given order.

        Args:
            table: Estimates of the times of legs.
            places: The nodes of the tour in their order, with the index of a
                configuration of each.

        Returns:
            A configuration of each place, shape (n,) each [rad or m].
        """
        goals, nodes = self.goals, [node for node, _ in places]
        # Stations whose goals leave the configuration free, by their places.
        searched = {
            k: node - 1
            for k, node in enumerate(nodes)
            if 0 < node <= len(goals) and goals[node - 1].configuration is None
        }
        route, radius, before = [table.nodes[k][c] for k, c in places], RADIUS, np.inf
        for _ in range(ROUNDS if searched else 0):
            starts = [self._around(route, k, radius) for k in searched]
            place = np.repeat([*searched], [len(rows) for rows in starts])
            which: IntArray = np.array([searched[k] for k in place.tolist()])
            q = np.concatenate(starts)
            q, good = self._solved(q, self._nearest_alternatives(q, which))
            q, place = q[good], place[good]
            choices = [
                np.concatenate([row[None], q[place == k]])
                for k, row in enumerate(route)
            ]
            now, bad = 0.0, [(0, 0)]
            while bad:
                trial = table.along(nodes, choices)
                now, chosen = trial.best_configurations(range(len(nodes)))
                # Collision checks are dear: only chosen configurations are checked.
                bad = [
                    (k, c)
                    for k, c in chosen
                    if c and not self.free(choices[k][[c]], searched[k])[0]
                ]
                for k, c in bad:
                    choices[k] = np.delete(choices[k], c, axis=0)
            route = [choices[k][c] for k, c in chosen]
            if now > before * (1.0 - LEAST_GAIN):
                radius *= SHRINK
            if radius < LEAST_RADIUS:
                break
            before = now
        return route

    def _around(self, route: Sequence[Array], k: int, radius: float) -> Array:
        """Starts for other configurations of a place of a tour, shape (m, n)."""
        here, before = route[k], route[k - 1]
        aims = [before, before]
        if k + 1 < len(route):
            aims = [before, route[k + 1], 0.5 * (before + route[k + 1])]
        # Steps are at most twice the radius, so that the arm keeps its branch.
        steps = np.stack(aims) - here
        longest = np.max(np.abs(steps), axis=1, keepdims=True, initial=0.0)
        steps *= np.minimum(1.0, 2.0 * radius / np.maximum(longest, 1e-300))
        random = here + radius * self.rng.uniform(-1.0, 1.0, (TRIALS, here.size))
        return np.concatenate([here + steps, random])

    def _unreached(self, g: int) -> ProblemError:
        """Error for a station that no configuration was found for, with the reason."""
        station, problem = self.stations[g], self.leaving.get(g, self.problem)
        goal = station.goal if station.stop else passed(station.goal)
        system = ProblemFunctions.of(problem._altered(goal=goal.alternatives[0]))
        reason = str(unreachable(system, np.random.default_rng(0)))
        load = " with its payload" if station.payload else ""
        text = f"cannot be reached{load}: {reason.removeprefix('goal: ')}"
        return ProblemError(f"{label_of(g + 1, station.name)} {text}", f"stations[{g}]")


def _keeps(problem: Problem, q: Array) -> bool:
    """Whether a configuration at rest is collision-free and keeps the constraints."""
    checker, rest = problem.checker, np.zeros_like(q)
    if not checker.hulls_clear(q) and not checker.is_free(q, problem.margins):
        return False
    return not any(c.lack(q, rest, 1e-6) for c in problem.ready_constraints)


def distinct(rows: Array) -> Array:
    """Remove configurations, rows of shape (k, n), that are near to an earlier one."""
    chosen: list[int] = []
    for i, row in enumerate(rows):
        if np.all(np.max(np.abs(rows[chosen] - row), axis=1) >= DISTINCT):
            chosen.append(i)
    return rows[chosen]
