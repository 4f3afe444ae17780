"""Planning of tours: order, configurations and motions together.

Estimates of the times of legs give an order with configurations. Its legs are planned,
what they take is written down in the place of the estimates, and the order is looked
for again, until one comes out of which all legs are planned: what other orders would
take was then estimated only, but never found.
"""

from __future__ import annotations

import itertools
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
from tominpmp.cell.tours.configurations import Configurations, refined
from tominpmp.cell.tours.legs import DIRECT, JointTimes, Leg, Legs, LegTable, carrying
from tominpmp.cell.tours.lower_bound import tour_bound
from tominpmp.cell.tours.orders import best_order
from tominpmp.cell.tours.station import (
    Rules,
    Station,
    Visit,
    arm_of,
    called,
    checked_stations,
    together,
)
from tominpmp.cell.tours.tour import Tour
from tominpmp.checks import JointsLike, flag, instance, whole, wrong
from tominpmp.constraints.path import PathConstraint
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import OptionsError, ProblemError, brief, naming, warn_caller
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import place_of
from tominpmp.goals.joints import JointGoal
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import Options
from tominpmp.problem.controls import effort_range
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import known_names
from tominpmp.problem.state_checks import joint_vector, onto_limits
from tominpmp.robot.robot import Robot
from tominpmp.scene.scene import Scene
from tominpmp.solution import Solution
from tominpmp.status import Status
from tominpmp.stopping import Stop, bounded
from tominpmp.transcription.grid import whole_periods

# Configurations of a station that differ by less in all joints are the same [rad or m]:
# what they differ by is how exactly the goal is met, and their legs would be planned
# again.
APART = 1e-5
logger = logging.getLogger(__name__)

# Turns of order and configurations before legs are planned.
TURNS = 3
# Rounds of planning legs by effort; more are made while there is no tour at all.
ROUNDS = {"quick": 3, "standard": 8, "thorough": 20}
MOST_ROUNDS = 60
# Times that are as estimated [s].
AS_ESTIMATED = 1e-9

# A way through a tour: its nodes in their order, each with one of its configurations.
Way = list[tuple[int, int]]


class TourSearch:
    """The search for a tour: its legs, orders and configurations.

    Attributes:
        legs: What is known of the legs.
        table: Times of the legs.
        rules: Orders that are allowed.
        configurations: What is allowed at stations.
        rng: Random numbers.
        exact: Whether only times that no motion beats stand for legs not planned.
    """

    def __init__(
        self,
        problem: Problem,
        stations: tuple[Station, ...],
        rules: Rules,
        q_end: Array | None,
        count: int,
        options: Options,
        exact: bool,
    ) -> None:
        """Look for configurations at all stations.

        Raises:
            ProblemError: If a station has no configuration: names the station.
        """
        self.rules, self.exact = rules, exact
        self.rng = np.random.default_rng(options.seed)
        times = JointTimes.of(problem)
        # What may touch on the way to any other station may touch on leaving.
        touch = [pair for station in stations for pair in station.may_touch]
        leaving = {
            k: carrying(problem, station.payload, touch)
            for k, station in enumerate(stations)
            if station.payload is not None
        }
        goals = tuple(station.goal for station in stations)
        self.configurations = Configurations(problem, goals, times.weights, leaving)
        found = self.configurations.search(count, self.rng)
        for number, rows in enumerate(found):
            if not len(rows):
                raise ProblemError(
                    f"{called(number + 1, stations[number].name)} cannot be reached: "
                    f"{self.configurations.unreached(number)}",
                    f"stations[{number}]",
                )
        if not exact:
            most = np.minimum(times.acceleration, _torque_limited(problem, found))
            times = replace(times, acceleration=most)
        last = [] if q_end is None else [q_end[None]]
        nodes = [problem.q_start[None], *found, *last]
        rests = [True, *(station.stop for station in stations), *(True for _ in last)]
        self.table = LegTable(nodes, rests, times, q_end is not None)
        self.legs = Legs(problem, stations, options, self.table)

    def run(self) -> Tour:
        """Look for the tour."""
        way = self._order()
        for _ in range(TURNS):
            if way is None or not self._refine(way):
                break
            way = self._order(way)
        best: Way | None = None
        rounds = 10_000 if self.exact else ROUNDS[self.legs.options.effort]
        status, least, number = Status.CONVERGED, np.inf, 0
        try:
            while way is not None:
                complete = self._plan_legs(way)
                # Between places that are passed the times are as estimated.
                length = sum(self.table.time(leg) for leg in _legs(way))
                if length < least:
                    least, best = length, way
                number += 1
                logger.info("round %d: %.4f s", number, length)
                most = max(rounds, MOST_ROUNDS) if best is None else rounds
                if complete or number >= most:
                    break
                way = self._order(way)
        except (Stop, KeyboardInterrupt) as stop:
            status = _status(stop)
            if best is None:
                raise
        return self._failed() if best is None else self._assembled(best, status)

    # -- order and configurations ------------------------------------------------------

    def _order(self, before: Way | None = None) -> Way | None:
        """Best order that is found for the times that are known or estimated."""
        table = self.table
        begin = [node - 1 for node, _ in (before or [])[1 : table.stations + 1]]
        length, order, chosen = best_order(table, self.rules, self.rng, begin)
        if not np.isfinite(length):
            return None
        return list(zip(table.way(order), chosen, strict=True))

    def _refine(self, way: Way) -> bool:
        """Add better configurations for an order; whether there are any."""
        nodes, found = self.table.nodes, False
        better = refined(self.configurations, self.table, way, self.rng)
        for (node, _), new in zip(way, better, strict=True):
            if np.min(np.max(np.abs(nodes[node] - new), axis=1)) > APART:
                nodes[node] = np.concatenate([nodes[node], new[None]])
                found = True
        return found

    # -- legs --------------------------------------------------------------------------

    def _plan_legs(self, way: Way) -> bool:
        """Plan the legs of a tour; whether all of them take what they were said to.

        Then no other order can be better by these estimates.
        """
        table, off = self.table, 0.0
        for leg in _legs(way):
            if table.found(leg) is None and table.resting(leg[0], leg[2]) == 2:
                before, seconds = table.time(leg), self.legs.seconds(leg)
                table.learn(leg, seconds)
                off = max(off, abs(seconds - before))
        if off > AS_ESTIMATED and not self.exact:
            table.calibrate()
        return off <= AS_ESTIMATED

    # -- the tour ----------------------------------------------------------------------

    def _assembled(self, way: Way, status: Status) -> Tour:
        """Put the motions of a way together."""
        legs, table, nodes = self.legs, self.table, [node for node, _ in way]
        q = [table.nodes[node][c] for node, c in way]
        motions, visits = list[Solution](), list[Visit]()
        kinematics = RobotKinematics(legs.problem.robot)
        # When the robot comes to rest [s], and which arm stays there how long [s], None
        # for all of them: several arms may work at once.
        halts: list[tuple[float, list[tuple[str | None, float]]]] = [(0.0, [])]

        def visit(place: int, there: Array) -> None:
            """Visit the station of a place, as soon as its arm is free."""
            number = table.station(nodes[place])
            if number is None:
                return
            station, (begin, stays) = legs.stations[number], halts[-1]
            met = station.goal.nearest(kinematics, there, np.zeros_like(there))
            arm = arm_of(kinematics.robot, met)
            before = [item for item in stays if arm is None or item[0] in (arm, None)]
            arrival = begin + together(before)
            stay = whole_periods(station.dwell, legs.options.control_period)
            stays.append((arm, stay))
            visits.append(Visit(station.name, there, arrival, arrival + stay))

        for first, last in pairwise(_stops(table, nodes)):
            found = _run(legs, way, q, first, last)
            if found is None:
                return self._failed()
            for motion, reached in found:
                if motion is None:
                    visit(reached[0], q[reached[0]])  # it is there already
                    continue
                begin = halts[-1][0] + together(halts[-1][1])
                motions.append(motion)
                for k, part in zip(reached, motion.segments, strict=True):
                    if k != reached[0]:
                        halts.pop()
                    halts.append((begin + part.arrival, []))
                    visit(k, motion.trajectory(part.arrival).q)
        what = "A tour" if status is Status.CONVERGED else f"{status.value} A tour"
        count = "1 station" if len(visits) == 1 else f"{len(visits)} stations"
        return Tour(
            legs.problem,
            legs.stations,
            status,
            f"{what} over {count} was found, each motion of it verified.",
            tuple(visit.station for visit in visits),
            tuple(visits),
            tuple(motions),
            direct=sum(m.message.endswith(DIRECT) for m in motions),
            legs_planned=legs.planned,
            stays=tuple(together(stays) for _, stays in halts),
        )

    def _failed(self) -> Tour:
        """The result where no tour was found."""
        legs, status = self.legs, Status.INFEASIBLE
        reason = "no order of the stations keeps what was said of it"
        reason += " (after, then, precedence)"
        if legs.errors:
            reason = f"of the legs, {legs.errors[-1].rstrip('.')}"
        text = f"{status.value} No tour was found: {reason}."
        planned = legs.planned
        return Tour(legs.problem, legs.stations, status, text, legs_planned=planned)


def _legs(way: Way) -> list[Leg]:
    return [(*a, *b) for a, b in pairwise(way)]


def _status(stop: BaseException) -> Status:
    """How planning ends that was stopped by somebody, or by the clock."""
    requested = not isinstance(stop, Stop) or stop.requested
    return Status.INTERRUPTED if requested else Status.TIME_LIMIT


# Legs without a stop between them that are planned as one motion.
MOST_TOGETHER = 8


def _stops(table: LegTable, nodes: Sequence[int]) -> list[int]:
    """The start, and where motions end: stops, and some between if these are rare."""
    stops = [0]
    for place in range(1, len(nodes)):
        final = place == len(nodes) - 1
        if table.rests[nodes[place]] or final or place - stops[-1] >= MOST_TOGETHER:
            stops.append(place)
    return stops


def _run(
    legs: Legs,
    way: Way,
    q: Sequence[Array],
    first: int,
    last: int,
) -> list[tuple[Solution | None, list[int]]] | None:
    """Motions from one stop to the next, and the places that each one reaches.

    The motion to a place where the arm is already is None; all of it where there is no
    way to one of the places.
    """
    places = list(range(first + 1, last + 1))
    if len(places) > 1:
        stretch = slice(first, last + 1)
        passing = legs.passing([node for node, _ in way[stretch]], q[stretch])
        if passing is not None:
            return [(passing, places)]
    found: list[tuple[Solution | None, list[int]]] = []
    for place in places:
        leg = (*way[place - 1], *way[place])
        if legs.stays(leg):
            found.append((None, [place]))
            continue
        motion = legs.motion(leg)
        if motion is None:
            return None
        found.append((motion, [place]))
    return found


def _torque_limited(problem: Problem, found: Sequence[Array]) -> Array:
    """Accelerations that the torques of the joints allow, roughly, shape (n,).

    The room that gravity leaves, over the inertia at the joint: what others do at the
    same time, and how the arm stretches on the way, is left out.
    """
    dynamics = RobotDynamics(problem.robot)
    _, half = effort_range(problem.robot, problem.motion_limits)
    rows = np.concatenate([problem.q_start[None], *(rows[:2] for rows in found)])
    rows = rows[:: max(1, len(rows) // 40)]
    rest = np.zeros_like(rows)
    weight = np.abs(dynamics.inverse(rows, rest, rest))
    inertia = np.diagonal(dynamics.mass(rows), axis1=1, axis2=2)
    room = np.maximum(half - weight, 0.1 * half)
    most = np.median(room / np.maximum(inertia, 1e-9), axis=0)
    return np.where(most > 0.0, most, np.inf)


# Configurations kept of a station, at the most.
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
        q_start: Where it starts, at rest, shape (n,) or by joint name [rad or m].
        stations: What is visited, in any order unless they say otherwise: stations, or
            goals (called "station 1", ...), or either by name.
        q_end: Where it ends, at rest, shape (n,) [rad or m]: "start" for where it
            starts, None for the last station.
        scene: The obstacles; none of them moves.
        margin: Distance that the links keep from them [m].
        motion_limits: Limits beyond those of the robot's description.
        constraints: What else holds at all times.
        self_collision: As for :class:`~tominpmp.Problem`.
        may_touch: Pairs of names of links and obstacles that may touch.
        precedence: Pairs of names of stations (earlier, later), beside what the
            stations say themselves.
        configurations: Configurations of a station that are looked at together; more
            of them are found near those that are chosen.
        options: How legs are planned; None for ``Options(effort="quick")``. The time
            limit is one of the whole tour.
        exact: Whether to rely on no estimate: legs are planned until no other order of
            the configurations that were found can be faster. For few stations.
        **changes: Options by name.

    Returns:
        The tour. When none is found, its status and message say why.

    Raises:
        ProblemError: If something is wrong in itself: a station that cannot be reached
            (named), two in one place, a precedence that runs in a circle.
        OptionsError: If an option is wrong.
        FrameNotFound: If a station is about a frame that the robot has not.
    """
    begun = time.perf_counter()
    chosen = Options(effort="quick") if options is None else Options.of(options)
    chosen = chosen.changed(changes)
    items = checked_stations(stations)
    rules = Rules.of(items, precedence)
    most, error = MOST_CONFIGURATIONS, OptionsError
    count = whole(configurations, "configurations", 1, most, error=error)
    exact = flag(exact, "exact")
    problem, end = _problem(
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
    items = _checked_goals(problem, items, rules)
    bound = LowerBound(0.0, "")
    with bounded(chosen.max_planning_time):
        try:
            search = TourSearch(problem, items, rules, end, count, chosen, exact)
            tour = search.run()
        except (Stop, KeyboardInterrupt) as stop:
            status = _status(stop)
            text = f"{status.value} No tour was found by then."
            tour = Tour(problem, items, status, text)
        else:
            # A tour that was found as the time ended is kept without a bound.
            with suppress(Stop, KeyboardInterrupt):
                bound = tour_bound(problem, items, rules, end)
    message = tour.message
    if bound.useful(tour.cycle_time):
        message = f"{message} No tour beats {bound.T:.4g} s: {bound.reason}."
    return replace(
        tour,
        message=message,
        lower_bound=bound.T,
        bound_reason=bound.reason,
        planning_time=time.perf_counter() - begun,
    )


def _problem(
    robot: Robot, q_start: JointsLike, q_end: object, **fields: Any
) -> tuple[Problem, Array | None]:
    """The problem from start to end, and the end if it is given."""
    if isinstance(q_end, str) and q_end != "start":
        raise wrong(q_end, "q_end", 'a configuration, "start" or None')
    instance(robot, Robot, "robot", "a Robot (see load_robot)")
    scene = fields["scene"]
    if isinstance(scene, Scene) and scene.moving:
        raise ProblemError(
            "scene: an obstacle moves, and when a tour comes by is not known "
            "beforehand; expected obstacles at rest",
            "scene",
        )
    anywhere = q_end is None or isinstance(q_end, str)
    name, end = ("q_start", q_start) if anywhere else ("q_end", q_end)
    try:
        given = joint_vector(robot, end, name)
        q, snapped = onto_limits(robot, "position", given, name)
        for message in snapped:
            warn_caller(message)
        problem = Problem(robot, q if anywhere else q_start, JointGoal(q), **fields)
    except ProblemError as error:
        text = str(error)
        if not text.startswith("goal"):
            raise
        text = name + text.removeprefix("goal.q").removeprefix("goal")
        raise ProblemError(text, name) from error
    return problem, None if q_end is None else problem.goal.configuration


def _checked_goals(
    problem: Problem, stations: Sequence[Station], rules: Rules
) -> tuple[Station, ...]:
    """Check that each station can be, and that no two are in one place.

    Returns:
        The stations, with goals in the order of the joints of the robot.
    """
    robot, found, places = problem.robot, list[Station](), dict[object, int]()
    known, needed = known_names(robot, problem.scene), rules.all_needs
    for k, station in enumerate(stations):
        own = called(k + 1, station.name)
        with naming(own, f"stations[{k}]"):
            goal = station.goal.resolved(robot)
            goal.validate(robot)
            if station.payload is not None:
                loaded = robot.with_payload(station.payload)
                known |= known_names(loaded, problem.scene)
            goal = problem.with_ends(problem.q_start, goal, f"{own}: ").goal
        found.append(replace(station, goal=goal))
        other = places.setdefault(place_of(goal), k)
        if other != k and k not in needed[other] and other not in needed[k]:
            raise ProblemError(
                f"{called(other + 1, found[other].name)} and {own} are in one place; "
                "expected one station, or a precedence of the one before the other",
                "stations",
            )
    for k, station in enumerate(found):
        for one in itertools.chain.from_iterable(station.may_touch):
            if one not in known:
                raise ProblemError(
                    f"{called(k + 1, station.name)}: may_touch names {brief(one)}, "
                    "expected a link with a shape, an obstacle or a load of a "
                    f"station: one of {brief(', '.join(sorted(known)))}",
                    f"stations[{k}].may_touch",
                )
    return tuple(found)
