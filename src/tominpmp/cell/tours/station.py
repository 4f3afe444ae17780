"""Stations of a tour: goals to be visited, and precedence rules."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from graphlib import CycleError, TopologicalSorter
from typing import Annotated, Any, TypeAlias, TypeVar

import numpy as np

from tominpmp.arrays import Array, BoolArray, Record, record
from tominpmp.checks import Seconds, instance, of_type, wrong
from tominpmp.exceptions import ProblemError, brief, naming, unknown
from tominpmp.goals.base import Goal
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Flag, Load, Pairs, checked_pairs
from tominpmp.robot.robot import Robot

# Larger numbers of stations are rejected as a mistake.
MOST_STATIONS = 5_000

T = TypeVar("T")


def _names(given: object, field: str) -> tuple[str, ...]:
    """Check a caller's names of stations; a single name is taken as a list of one."""
    names = (given,) if isinstance(given, str) else given
    if not isinstance(names, Sequence) or not all(isinstance(n, str) for n in names):
        raise wrong(given, field, "names of stations")
    return tuple(names)


AnyPlace: TypeAlias = Annotated[
    Goal, of_type(Goal, "a JointGoal, PoseGoal, AxisGoal or another goal")
]
Names: TypeAlias = Annotated[Sequence[str], _names]


@record
class Station(Record):
    """A place that a tour visits once.

    Attributes:
        name: Name of the station, unique in its tour.
        goal: The goal that the arm meets at the station: any goal at rest.
        dwell: Dwell time at the station [s].
        after: Names of stations that are visited earlier, not necessarily directly.
        then: Names of stations of which one comes directly after this one; empty for
            any station. A part picked here is brought there.
        payload: Payload that the robot carries from here to the next station.
        stop: Whether the arm is at rest here. False lets it pass at any velocity.
        may_touch: Pairs of names of links, payloads and obstacles that may touch on
            the way here and on the way from here.

    Raises:
        ProblemError: If a value is wrong.
    """

    name: str
    goal: AnyPlace
    dwell: Seconds = 0.0
    after: Names = ()
    then: Names = ()
    payload: Load | None = None
    stop: Flag = True
    may_touch: Pairs = ()

    def __post_init__(self) -> None:
        """Check the values that need no robot."""
        if not isinstance(self.name, str) or not self.name.strip():
            raise wrong(self.name, "station.name", "a text")
        with naming(f"station {brief(self.name)}", "station"):
            super().__post_init__()
            # The arm is at rest while it dwells.
            self._keep(stop=self.stop or self.dwell > 0.0)
            if self.goal.ends_moving or not self.goal.fixes_velocity:
                raise ProblemError(
                    "its goal asks for a velocity, expected a goal at rest; stop=False "
                    "lets the arm pass it at any velocity",
                    "goal",
                )


@dataclass(frozen=True, eq=False)
class Visit:
    """A stay at a station.

    Attributes:
        station: Name of the station.
        q: Configuration there, shape (n,) [rad or m].
        arrival: Time at which the arm arrives [s].
        departure: Time at which it leaves [s].
    """

    station: str
    q: Array
    arrival: float
    departure: float


def checked_stations(stations: Any) -> tuple[Station, ...]:
    """Check a caller's stations.

    Args:
        stations: Stations, or goals (called "station 1", ...), or either by name.

    Raises:
        ProblemError: If an item is not a station, two stations have the same name, or a
            name in their rules is unknown.
    """
    if isinstance(stations, Mapping):
        stations = [_named(k, *item) for k, item in enumerate(stations.items(), 1)]
    listed = isinstance(stations, Sequence) and not isinstance(stations, str)
    if not listed or not 0 < len(stations) <= MOST_STATIONS:
        expected = f"1 to {MOST_STATIONS} of Station or of goals, or goals by name"
        raise wrong(stations, "stations", expected)
    checked, numbers = list[Station](), dict[str, int]()
    for k, item in enumerate(stations, 1):
        if isinstance(item, Goal):
            item = _named(k, f"station {k}", item)
        instance(item, Station, f"stations[{k - 1}]", "a Station or a goal")
        checked.append(item)
        first = numbers.setdefault(item.name, k)
        if first != k:
            raise ProblemError(
                f"stations: numbers {first} and {k} are both called "
                f"{brief(item.name)}, expected distinct names",
                "stations",
            )
    for k, station in enumerate(checked, 1):
        for field in ("after", "then"):
            for name in getattr(station, field):
                if name not in numbers or name == station.name:
                    others = sorted(numbers.keys() - {station.name})
                    with naming(f"{label_of(k, station.name)}: {field}", "station"):
                        why = unknown("other station", name, others)
                        raise ProblemError(why, field)
    return tuple(checked)


def label_of(number: int, name: str) -> str:
    """The label of a station in messages: its number, from 1, and its name."""
    label = f"station {number}"
    return label if name == label else f"{label} ({brief(name)})"


def _named(number: int, name: Any, item: Any) -> Station:
    """Make a station of a goal, or give a station another name.

    Raises:
        ProblemError: If the goal or the name is wrong, with the number of the station.
    """
    try:
        if isinstance(item, Station):
            return replace(item, name=name)
        return Station(name, item)
    except ProblemError as error:
        text = str(error).removeprefix(f"station {brief(name)}: ")
        where = label_of(number, name) if isinstance(name, str) else f"station {number}"
        raise ProblemError(f"{where}: {text}", error.field) from error


@dataclass(frozen=True, eq=False)
class Rules:
    """Rules for the order of the nodes of a tour.

    Nodes are the start (0), the stations from 1, and the end, which may be open.

    Attributes:
        count: Number of stations.
        needs: By node, the nodes that precede it directly or through others.
        follows: Whether a node may come directly after another, shape (count + 2, count
            + 2).
        ends: Whether the tour has an end of its own, after the last station.
    """

    count: int
    needs: tuple[frozenset[int], ...]
    follows: BoolArray
    ends: bool = True

    @classmethod
    def of(
        cls,
        stations: Sequence[Station],
        precedence: Sequence[tuple[str, str]] = (),
        ends: bool = True,
    ) -> Rules:
        """Take the rules of stations, and pairs of names (earlier, later).

        Args:
            stations: The stations, with distinct names.
            precedence: Pairs of names.
            ends: Whether the tour has an end of its own, after the last station.

        Raises:
            ProblemError: If a name is unknown, or no order is possible at all.
        """
        index = {station.name: i for i, station in enumerate(stations, 1)}
        expected = 'pairs of names of stations, as [("drill", "tap")]'
        ordered = checked_pairs(precedence, "precedence", expected)
        for name in itertools.chain.from_iterable(ordered):
            if name not in index:
                why = unknown("station", name, list(index))
                raise ProblemError(f"precedence: {why}", "precedence")
        count = len(stations)
        before: dict[int, set[int]] = {0: set()}
        before |= {k: {0} for k in range(1, count + 1)}
        before[count + 1] = {*before}
        follows = np.ones((count + 2, count + 2), dtype=bool)
        for k, station in enumerate(stations, 1):
            before[k].update(index[name] for name in station.after)
            then = {index[name] for name in station.then}
            if then:
                follows[k] = False
                follows[k, [*then]] = True
            if len(then) == 1:
                before[min(then)].add(k)
        for earlier, later in ordered:
            before[index[later]].add(index[earlier])
        needs = dict[int, frozenset[int]]()
        try:
            for k in TopologicalSorter(before).static_order():
                needs[k] = frozenset(before[k].union(*(needs[i] for i in before[k])))
        except CycleError as error:
            names = [stations[k - 1].name for k in error.args[1]]
            cycle = brief(" before ".join(names), 300)
            raise ProblemError(
                f"precedence has a cycle: {cycle}", "precedence"
            ) from None
        return cls(count, tuple(needs[k] for k in before), follows, ends)

    def along(self, start: T, stations: Iterable[T], end: T) -> list[T]:
        """Items of start, stations and end; that of the end is left out without one."""
        return [start, *stations, *([end] if self.ends else [])]

    def allow(self, order: Sequence[int]) -> bool:
        """Whether an order of all stations keeps the rules."""
        kept = all(self.needs[k] <= {0, *order[:i]} for i, k in enumerate(order))
        return kept and bool(np.all(self.follows[order, [*order[1:], self.count + 1]]))


@dataclass(frozen=True, eq=False)
class TourTask:
    """The task of a tour.

    Attributes:
        problem: Robot, start, obstacles and limits; its goal is the end of the tour, if
            the tour has one.
        stations: The stations.
        rules: Orders that are allowed.
    """

    problem: Problem
    stations: tuple[Station, ...]
    rules: Rules


def arm_of(robot: Robot, goal: Goal) -> str | None:
    """Name of the arm that a goal is for; None if it is for all arms or any arm."""
    names = {(item.frame_name or "").partition("/")[0] for item in goal.alternatives}
    return next(iter(names)) if len(names) == 1 and names <= set(robot.parts) else None


def together(stays: Iterable[tuple[str | None, float]]) -> float:
    """Total time of dwells at one halt: arms dwell in parallel, each in sequence.

    Args:
        stays: Arms, None for all of them, and their dwell times [s].
    """
    by_arm: defaultdict[str | None, float] = defaultdict(float)
    for arm, stay in stays:
        by_arm[arm] += stay
    all_arms = by_arm.pop(None, 0.0)
    return all_arms + max(by_arm.values(), default=0.0)


def least_stays(robot: Robot, stays: Sequence[tuple[Goal, float]]) -> float:
    """Lower bound for the total dwell time [s], however the arms share the stations.

    Args:
        robot: The robot.
        stays: Goals of the stations, and the dwell time at each [s].
    """
    if not robot.parts:
        return sum(stay for _, stay in stays)
    # By the name of the arm; None for any arm, and an empty name for all arms.
    by_arm: defaultdict[str | None, float] = defaultdict(float)
    for goal, stay in stays:
        framed = any(item.frame_name is not None for item in goal.alternatives)
        by_arm[arm_of(robot, goal) if framed else ""] += stay
    any_arm, all_arms = by_arm.pop(None, 0.0), by_arm.pop("", 0.0)
    even = (sum(by_arm.values()) + any_arm) / len(robot.parts)
    return all_arms + max(even, *by_arm.values(), 0.0)
