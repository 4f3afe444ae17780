"""Planning of tours: order, configurations and motions together."""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

from tominpmp.blas_threads import on_one_thread
from tominpmp.cell.tours.search import TourSearch
from tominpmp.cell.tours.station import Rules, Station, called, checked_stations
from tominpmp.cell.tours.tour import Tour
from tominpmp.cell.tours.tour_bound import tour_bound
from tominpmp.checks import flag, instance, whole, wrong
from tominpmp.constraints.path import PathConstraint
from tominpmp.exceptions import (
    OptionsError,
    ProblemError,
    brief,
    told_of,
    warn_caller,
)
from tominpmp.goals import Goal, JointGoal
from tominpmp.goals.targets import place_of
from tominpmp.inputs import JointsLike
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import Options
from tominpmp.problem import Problem
from tominpmp.robot import Robot
from tominpmp.scene import Scene
from tominpmp.segments import known_names
from tominpmp.state_checks import onto_limits
from tominpmp.status import Status
from tominpmp.stopping import Stop, bounded

logger = logging.getLogger(__name__)

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
        self_collision: As for :class:`~tominpmp.problem.Problem`.
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
    problem, ends = _problem(
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
    with bounded(chosen.max_planning_time):
        try:
            tour = _plan(problem, items, rules, ends, count, chosen, exact)
        except (Stop, KeyboardInterrupt) as stop:
            requested = not isinstance(stop, Stop) or stop.requested
            status = Status.INTERRUPTED if requested else Status.TIME_LIMIT
            return Tour(
                problem,
                items,
                status,
                f"{status.value} No tour was found by then.",
                planning_time=time.perf_counter() - begun,
            )
    return replace(tour, planning_time=time.perf_counter() - begun)


def _plan(
    problem: Problem,
    stations: tuple[Station, ...],
    rules: Rules,
    ends: bool,
    count: int,
    options: Options,
    exact: bool,
) -> Tour:
    search = TourSearch.of(problem, stations, rules, ends, count, options, exact)
    tour = search.run()
    q_end = problem.goal.configuration if ends else None
    bound = tour_bound(problem, stations, rules, q_end)
    tour = replace(tour, lower_bound=bound.T, bound_reason=bound.reason)
    if not bound.useful(tour.cycle_time):
        return tour
    return replace(
        tour,
        message=f"{tour.message} No tour beats {bound.T:.4g} s: {bound.reason}.",
    )


def _problem(
    robot: Robot, q_start: JointsLike, q_end: object, **fields: Any
) -> tuple[Problem, bool]:
    """The problem from start to end, and whether the end is given."""
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
    name = "q_start" if anywhere else "q_end"
    end: Any = q_start if anywhere else q_end
    try:
        goal = JointGoal(end).resolved(robot)
        goal.validate(robot)
        q, snapped = onto_limits(robot, "position", goal.q, name)
        for message in snapped:
            warn_caller(message)
        problem = Problem(robot, q if anywhere else q_start, JointGoal(q), **fields)
    except ProblemError as error:
        text = str(error)
        if not text.startswith("goal"):
            raise
        text = name + text.removeprefix("goal.q").removeprefix("goal")
        raise ProblemError(text, name) from error
    return problem, q_end is not None


def _checked_goals(
    problem: Problem, stations: Sequence[Station], rules: Rules
) -> tuple[Station, ...]:
    """Check that each station can be, and that no two are in one place.

    Returns:
        The stations, with goals in the order of the joints of the robot.
    """
    robot, found = problem.robot, list[Station]()
    for k, station in enumerate(stations):
        with told_of(called(k + 1, station.name), f"stations[{k}]"):
            goal = station.goal.resolved(robot)
            goal.validate(robot)
            if station.payload is not None:
                robot.with_payload(station.payload)
        found.append(replace(station, goal=goal))
    _check_touching(problem, found)
    places: dict[object, int] = {}
    for k, station in enumerate(found):
        own = called(k + 1, station.name)
        with told_of(own, f"stations[{k}]"):
            leg = problem.with_ends(problem.q_start, station.goal, f"{own}: ")
        found[k] = replace(station, goal=leg.goal)
        place = place_of(leg.goal)
        other = places.setdefault(place, k)
        needed = rules.all_needs
        if other != k and k not in needed[other] and other not in needed[k]:
            raise ProblemError(
                f"{called(other + 1, found[other].name)} and "
                f"{called(k + 1, station.name)} are in one place; expected one "
                "station, or a precedence of the one before the other",
                "stations",
            )
    return tuple(found)


def _check_touching(problem: Problem, stations: Sequence[Station]) -> None:
    """Check that stations let nothing touch that is not there at any of them."""
    known = known_names(problem.robot, problem.scene)
    loads = {id(s.payload): s.payload for s in stations if s.payload is not None}
    for load in loads.values():
        known |= known_names(problem.robot.with_payload(load), problem.scene)
    for k, station in enumerate(stations):
        for one in itertools.chain.from_iterable(station.may_touch):
            if one not in known:
                raise ProblemError(
                    f"{called(k + 1, station.name)}: may_touch names {brief(one)}, "
                    "expected a link with a shape, an obstacle or a load of a "
                    f"station: one of {brief(', '.join(sorted(known)))}",
                    f"stations[{k}].may_touch",
                )
