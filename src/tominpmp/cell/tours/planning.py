"""Planning of tours: order, configurations and motions together.

Estimates of the times of legs give an order with configurations. Its legs are planned,
their times replace the estimates, and the order is searched again, until all legs of
the best order are planned. The times of other orders then rest on estimates.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from tominpmp.arrays import Array
from tominpmp.blas_threads import on_one_thread
from tominpmp.bounds.result import LowerBound
from tominpmp.cell.tours.configurations import Configurations
from tominpmp.cell.tours.legs import DIRECT, JointTimes, Legs, LegTable
from tominpmp.cell.tours.lower_bound import tour_bound
from tominpmp.cell.tours.orders import Route, best_order
from tominpmp.cell.tours.station import (
    Rules,
    Station,
    TourTask,
    Visit,
    arm_of,
    checked_stations,
    label_of,
    together,
)
from tominpmp.cell.tours.tour import Tour
from tominpmp.checks import JointsLike, flag, instance, raised_as, whole, wrong
from tominpmp.constraints.path import PathConstraint
from tominpmp.exceptions import OptionsError, ProblemError, counted, naming, warn_caller
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import place_of
from tominpmp.goals.joints import JointGoal, joint_vector
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import Options
from tominpmp.problem.joint_limits import accelerations_alone
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import check_names, known_names
from tominpmp.problem.state_checks import onto_limits
from tominpmp.robot.robot import Robot
from tominpmp.scene.scene import Scene
from tominpmp.solution import Solution
from tominpmp.status import Status
from tominpmp.stopping import Stop, bounded
from tominpmp.transcription.grid import whole_periods

# Configurations of a station count as equal if they differ by less in all joints
# [rad or m]: they differ by the residual of the goal only, and planning their legs
# again gains nothing.
APART = 1e-5
logger = logging.getLogger(__name__)

# Alternations of order and configurations before legs are planned.
TURNS = 3
# Rounds of planning legs, by effort; largest number of rounds while there is no tour.
ROUNDS = {"quick": 3, "standard": 8, "thorough": 20}
MOST_ROUNDS = 60
# Difference below which a planned time equals its estimate [s].
AS_ESTIMATED = 1e-9

# Largest number of legs without a stop between them that are planned as one motion.
MOST_TOGETHER = 8

# Time at which the robot comes to rest [s], and the dwells of its arms there (None for
# all arms) [s]: several arms may dwell at once.
Halt = tuple[float, list[tuple[str | None, float]]]


class TourSearch:
    """The search for a tour: its legs, orders and configurations.

    Attributes:
        task: Stations, rules for their order, start, obstacles and limits.
        legs: Problems and motions of the legs.
        table: Times of the legs.
        configurations: The search for configurations of the stations.
        rng: Random numbers.
        exact: Whether the estimates of unplanned legs are lower bounds.
    """

    def __init__(
        self, task: TourTask, count: int, options: Options, exact: bool
    ) -> None:
        """Find configurations at all stations.

        Args:
            task: Stations, rules for their order, start, obstacles and limits.
            count: Largest number of configurations kept of a station.
            options: Options of the planner for the legs.
            exact: Whether the estimates of unplanned legs are lower bounds.

        Raises:
            ProblemError: If a station has no configuration, with its name.
        """
        problem, stations, rules = task.problem, task.stations, task.rules
        self.task = task
        self.exact, self.rng = exact, np.random.default_rng(options.seed)
        times = JointTimes.of(problem)
        self.configurations = Configurations(task, self.rng)
        by_station = self.configurations.search(count)
        if not exact:
            times = replace(times, acceleration=_accelerations(problem, by_station))
        end = np.asarray(problem.goal.configuration)
        nodes = rules.along(problem.q_start[None], by_station, end[None])
        rests = rules.along(True, (station.stop for station in stations), True)
        self.table = LegTable(nodes, rests, times, rules)
        visited = rules.along(None, stations, None)
        self.legs = Legs(problem, visited, options, self.table)

    def run(self) -> Tour:
        """Search for the tour."""
        route = best_order(self.table, self.rng, [])
        for _ in range(TURNS):
            if not route or not self._refine(route):
                break
            route = best_order(self.table, self.rng, route)
        best: Route = []
        rounds = 10_000 if self.exact else ROUNDS[self.legs.options.effort]
        status, least, number = Status.CONVERGED, np.inf, 0
        try:
            while route:
                complete = self._plan_legs(route)
                # Legs without a stop at both ends keep their estimates.
                length = sum(map(self.table.time, pairwise(route)))
                if length < least:
                    least, best = length, route
                number += 1
                logger.info("round %d: %.4f s", number, length)
                most = rounds if best else max(rounds, MOST_ROUNDS)
                if complete or number >= most:
                    break
                route = best_order(self.table, self.rng, route)
        except (Stop, KeyboardInterrupt) as stop:
            status = _status(stop)
            if not best:
                raise
        return self._assembled(best, status) if best else self._failed()

    # -- order and configurations ------------------------------------------------------

    def _refine(self, route: Route) -> bool:
        """Add better configurations for an order; return whether there are any."""
        nodes, improved = self.table.nodes, False
        better = self.configurations.refined(self.table, route)
        for (node, _), new in zip(route, better, strict=True):
            if np.min(np.max(np.abs(nodes[node] - new), axis=1)) > APART:
                nodes[node] = np.concatenate([nodes[node], new[None]])
                improved = True
        return improved

    # -- legs --------------------------------------------------------------------------

    def _plan_legs(self, route: Route) -> bool:
        """Plan the legs of a tour; return whether all times equal their estimates.

        If so, no other order is better by these estimates.
        """
        table, off = self.table, 0.0
        for leg in pairwise(route):
            (begin, _), (end, _) = leg
            if leg not in table.known and table.resting(begin, end) == 2:
                before = table.time(leg)
                table.known[leg] = self.legs.seconds(leg)
                off = max(off, abs(table.known[leg] - before))
        if off > AS_ESTIMATED and not self.exact:
            table.calibrate()
        return off <= AS_ESTIMATED

    # -- the tour ----------------------------------------------------------------------

    def _motions(
        self, route: Route, q: Sequence[Array]
    ) -> list[tuple[Solution | None, list[int]]] | None:
        """Motions of a tour, and the places in its route that each of them reaches.

        Motions end where the arm stops; elsewhere only if stops are rare, or if no
        motion passes the places between two stops.

        Returns:
            Pairs of a motion, None for a place where the arm is already, and the places
            that it reaches; None if one of the places is not reached.
        """
        legs, table = self.legs, self.table
        nodes = [node for node, _ in route]
        stops = [0]
        motions: list[tuple[Solution | None, list[int]]] = []
        for place in range(1, len(nodes)):
            final = place == len(nodes) - 1
            if table.rests[nodes[place]] or final or place - stops[-1] >= MOST_TOGETHER:
                stops.append(place)
        for first, last in pairwise(stops):
            places = [*range(first + 1, last + 1)]
            stretch = slice(first, last + 1)
            if len(places) > 1:
                passing = legs.motion(nodes[stretch], q[stretch])
                if passing is not None:
                    motions.append((passing, places))
                    continue
            for place in places:
                leg = route[place - 1], route[place]
                if np.isinf(legs.seconds(leg)):
                    return None
                motions.append((legs.motions.get(leg), [place]))
        return motions

    def _assembled(self, route: Route, status: Status) -> Tour:
        """Assemble the tour from the motions of its legs."""
        legs, task = self.legs, self.task
        q = [self.table.nodes[node][c] for node, c in route]
        runs = self._motions(route, q)
        if runs is None:
            return self._failed()
        motions, visits = list[Solution](), list[Visit]()
        kinematics = RobotKinematics(task.problem.robot)
        halts: list[Halt] = [(0.0, [])]

        def visit(place: int, there: Array, halt: Halt) -> None:
            """Note the visit of the station of a place, as soon as its arm is free."""
            station, (begin, stays) = legs.stations[route[place][0]], halt
            if station is None:
                return
            met = station.goal.nearest(kinematics, there, np.zeros_like(there))
            arm = arm_of(kinematics.robot, met)
            before = [item for item in stays if arm is None or item[0] in (arm, None)]
            arrival = begin + together(before)
            stay = whole_periods(station.dwell, legs.options.control_period)
            stays.append((arm, stay))
            visits.append(Visit(station.name, there, arrival, arrival + stay))

        for motion, reached in runs:
            if motion is None:
                visit(reached[0], q[reached[0]], halts[-1])  # the arm is there already
                continue
            motions.append(motion)
            begin = halts[-1][0] + together(halts[-1][1])
            for k, part in zip(reached, motion.segments, strict=True):
                halt: Halt = (begin + part.arrival, [])
                visit(k, motion.trajectory(part.arrival).q, halt)
            halts.append(halt)  # the arm rests after the last segment
        subject = "A tour" if status is Status.CONVERGED else f"{status.value} A tour"
        count = counted(len(visits), "station")
        return Tour(
            task.problem,
            task.stations,
            status,
            f"{subject} over {count} was found, each motion of it verified.",
            tuple(visit.station for visit in visits),
            tuple(visits),
            tuple(motions),
            direct=sum(m.message.endswith(DIRECT) for m in motions),
            legs_planned=legs.planned,
            stays=tuple(together(stays) for _, stays in halts),
        )

    def _failed(self) -> Tour:
        """The result where no tour was found."""
        legs, task, status = self.legs, self.task, Status.INFEASIBLE
        reason = "no order of the stations keeps the rules (after, then, precedence)"
        if legs.errors:
            reason = legs.errors[-1].rstrip(".")
        text = f"{status.value} No tour was found: {reason}."
        planned = legs.planned
        return Tour(task.problem, task.stations, status, text, legs_planned=planned)


def _status(stop: BaseException) -> Status:
    """The status of planning that was interrupted, or ended by the time limit."""
    requested = not isinstance(stop, Stop) or stop.requested
    return Status.INTERRUPTED if requested else Status.TIME_LIMIT


def _accelerations(problem: Problem, by_station: Sequence[Array]) -> Array:
    """Estimate of the accelerations that the limits of the joints allow, shape (n,).

    Changes of the inertia along the motion are neglected.
    """
    rows = np.concatenate([problem.q_start[None], *(rows[:2] for rows in by_station)])
    rows = rows[:: max(1, len(rows) // 40)]
    each = accelerations_alone(problem.robot, problem.motion_limits, rows)
    most = np.median(each, axis=0)
    return np.where(most > 0.0, most, np.inf)


# Largest number of configurations kept of a station.
MOST_CONFIGURATIONS = 200


@on_one_thread
def plan_tour(
    robot: Robot,
    q_start: JointsLike,
    stations: Sequence[Station | Goal] | Mapping[str, Station | Goal],
    *,
    q_end: JointsLike | Literal["start"] | None = "start",
    scene: Scene | None = None,
    margin: float = 0.0,
    motion_limits: MotionLimits | None = None,
    constraints: Sequence[PathConstraint] = (),
    self_collision: bool | None = None,
    may_touch: Sequence[tuple[str, str]] = (),
    precedence: Sequence[tuple[str, str]] = (),
    configurations: int = 40,
    exact: bool = False,
    options: Options | None = None,
    **changes: Any,
) -> Tour:
    """Plan a tour over stations: their order, the configurations and the motions.

    Args:
        robot: The robot; of several arms, if it was combined of them.
        q_start: Start configuration, at rest, shape (n,) or by joint name [rad or m].
        stations: The stations to visit, in any order that their rules allow: stations,
            or goals (called "station 1", ...), or either by name.
        q_end: End configuration, at rest, shape (n,) or by joint name [rad or m];
            "start" for the start configuration, None for the last station.
        scene: The obstacles, all at rest.
        margin: Distance that the links keep from them [m].
        motion_limits: Limits in addition to the limits of the robot's description.
        constraints: Constraints that hold at all times.
        self_collision: As for :class:`~tominpmp.Problem`.
        may_touch: Pairs of names of links and obstacles that may touch.
        precedence: Pairs of names of stations (earlier, later), in addition to the
            rules of the stations.
        configurations: Number of configurations of a station that are considered
            together; others are found near the chosen ones.
        options: Options of the plans of legs; None for ``Options(effort="quick")``. The
            time limit applies to the whole tour.
        exact: Whether to plan legs until no other order of the configurations found can
            be faster, with lower bounds as estimates. For few stations.
        **changes: Options by name.

    Returns:
        The tour. If no tour is found, its status and message give the reason.

    Raises:
        ProblemError: If the task is contradictory: a station that cannot be reached
            (with its name), two stations in one place, a cyclic precedence.
        OptionsError: If an option is wrong.
        FrameNotFound: If the goal of a station names a frame that the robot lacks.
    """
    begun = time.perf_counter()
    chosen = Options(effort="quick") if options is None else Options.of(options)
    chosen = chosen.changed(changes)
    items = checked_stations(stations)
    rules = Rules.of(items, precedence, q_end is not None)
    with raised_as(OptionsError):
        count = whole(configurations, "configurations", 1, MOST_CONFIGURATIONS)
    exact = flag(exact, "exact")
    problem = _problem(
        robot,
        q_start,
        q_end,
        scene=scene,
        margin=margin,
        motion_limits=motion_limits,
        constraints=constraints,
        self_collision=self_collision,
        may_touch=may_touch,
    )
    task = _checked_task(problem, items, rules)
    bound = LowerBound(0.0, "")
    with bounded(chosen.max_planning_time):
        try:
            tour = TourSearch(task, count, chosen, exact).run()
        except (Stop, KeyboardInterrupt) as stop:
            status = _status(stop)
            text = f"{status.value} No tour was found by then."
            tour = Tour(problem, task.stations, status, text)
        else:
            # If the time ends before the bound is known, the tour has no bound.
            with suppress(Stop, KeyboardInterrupt):
                bound = tour_bound(task)
    message = tour.message
    if bound.useful(tour.cycle_time):
        message = f"{message} No tour takes less than {bound.T:.4g} s: {bound.reason}."
    return replace(
        tour,
        message=message,
        lower_bound=bound.T,
        bound_reason=bound.reason,
        planning_time=time.perf_counter() - begun,
    )


def _problem(
    robot: Robot, q_start: JointsLike, q_end: object, **fields: Any
) -> Problem:
    """The problem from start to end; to the start if the tour has no end."""
    if isinstance(q_end, str) and q_end != "start":
        raise wrong(q_end, "q_end", 'a configuration, "start" or None')
    instance(robot, Robot, "robot", "a Robot (see load_robot)")
    anywhere = q_end is None or isinstance(q_end, str)
    name, end = ("q_start", q_start) if anywhere else ("q_end", q_end)
    position = joint_vector(robot, end, name)
    q, snapped = onto_limits(robot, "position", position, name)
    for message in snapped:
        warn_caller(message)
    try:
        problem = Problem(robot, q if anywhere else q_start, JointGoal(q), **fields)
    except ProblemError as error:
        if error.field != "goal":
            raise
        text = name + str(error).removeprefix("goal")
        raise ProblemError(text, name) from error
    if problem.scene.moving:
        raise ProblemError(
            "scene: an obstacle moves, and when a tour comes by is not known "
            "beforehand; expected obstacles at rest",
            "scene",
        )
    return problem


def _checked_task(
    problem: Problem, stations: Sequence[Station], rules: Rules
) -> TourTask:
    """Check that the goal of each station is valid, and that no two are in one place.

    Returns:
        The task of the tour, with goals in the order of the joints of the robot.
    """
    robot, checked, places = problem.robot, list[Station](), dict[object, int]()
    known, needed = known_names(robot, problem.scene), rules.needs
    for k, station in enumerate(stations, 1):
        label = label_of(k, station.name)
        with naming(label, f"stations[{k - 1}]"):
            goal = station.goal.resolved(robot)
            if station.payload is not None:
                loaded = robot.with_payload(station.payload)
                known |= known_names(loaded, problem.scene)
            goal = problem.with_ends(problem.q_start, goal, f"{label}: ").goal
        checked.append(replace(station, goal=goal))
        other = places.setdefault(place_of(goal), k)
        if other != k and k not in needed[other] and other not in needed[k]:
            raise ProblemError(
                f"{label_of(other, checked[other - 1].name)} and {label} are in one "
                "place; expected one station, or a precedence between the two",
                "stations",
            )
    for k, station in enumerate(checked):
        with naming(label_of(k + 1, station.name), f"stations[{k}]"):
            check_names(station.may_touch, known)
    return TourTask(problem, tuple(checked), rules)
