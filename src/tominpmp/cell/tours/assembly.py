"""Tours put together of the motions of their legs, of one arm or several."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tominpmp.arrays import Array
from tominpmp.cell.tours.leg_times import LegTable
from tominpmp.cell.tours.legs import DIRECT, Legs
from tominpmp.cell.tours.station import Station, Visit
from tominpmp.cell.tours.tour import Tour
from tominpmp.goals import Goal
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot
from tominpmp.solution import Solution
from tominpmp.status import Status
from tominpmp.transcription.ticks import whole_periods


def arm_at(robot: Robot, goal: Goal, q: Array) -> str | None:
    """Name of the arm that meets a goal at a configuration; None for all of them."""
    if not robot.parts:
        return None
    return arm_of(robot, goal.nearest(RobotKinematics(robot), q, np.zeros(robot.n)))


def arm_of(robot: Robot, goal: Goal) -> str | None:
    """Name of the arm that a goal is for; None where it is for all, or any."""
    names = {(one.frame_name or "").partition("/")[0] for one in goal.alternatives}
    return next(iter(names)) if len(names) == 1 and names <= set(robot.parts) else None


def together(stays: Iterable[tuple[str | None, float]]) -> float:
    """Time of stays that begin together: those of one arm come one after the other.

    Args:
        stays: Arms, None for all of them, and how long each stays [s].
    """
    every, alone = 0.0, dict[str, float]()
    for arm, stay in stays:
        if arm is None:
            every += stay
        else:
            alone[arm] = alone.get(arm, 0.0) + stay
    return every + max(alone.values(), default=0.0)


def least_stays(robot: Robot, stays: Sequence[tuple[Goal, float]]) -> float:
    """Time that no stays at stations beat, however arms share them.

    Args:
        robot: The robot.
        stays: Goals of the stations, and how long an arm stays at each [s].
    """
    if not robot.parts:
        return sum(stay for _, stay in stays)
    own, shared, every = dict[str, float](), 0.0, 0.0
    for goal, stay in stays:
        arm = arm_of(robot, goal)
        if arm is not None:
            own[arm] = own.get(arm, 0.0) + stay
        elif any(one.frame_name is not None for one in goal.alternatives):
            shared += stay
        else:
            every += stay
    even = (sum(own.values()) + shared) / len(robot.parts)
    return every + max(even, *own.values(), 0.0)


# Legs without a stop between them that are planned as one motion.
MOST_TOGETHER = 8


@dataclass(eq=False)
class Halt:
    """A robot at rest at one or more stations: several arms may work at once.

    Attributes:
        robot: The robot.
        begin: When it comes to rest [s].
        period: Period of the clock that stays are on [s]; None where there is none.
        stays: Which arm stays how long [s], None for all of them.
    """

    robot: Robot
    begin: float
    period: float | None
    stays: list[tuple[str | None, float]] = field(default_factory=list)

    @property
    def stay(self) -> float:
        """How long it is at rest [s]."""
        return together(self.stays)

    @property
    def end(self) -> float:
        """When it goes on [s]."""
        return self.begin + self.stay

    def visit(self, station: Station | None, q: Array) -> list[Visit]:
        """The visit of a station, as soon as its arm is free; none of no station."""
        if station is None:
            return []
        arm = arm_at(self.robot, station.goal, q)
        before = [item for item in self.stays if arm is None or item[0] in (arm, None)]
        arrival = self.begin + together(before)
        stay = whole_periods(station.dwell, self.period)
        self.stays.append((arm, stay))
        return [Visit(station.name, q, arrival, arrival + stay)]


def assembled(
    legs: Legs, nodes: Sequence[int], chosen: Sequence[int], status: Status
) -> Tour:
    """Put the motions of a way through its nodes together.

    Args:
        legs: What is known of the legs.
        nodes: The nodes of the tour in their order.
        chosen: The configuration of each.
        status: How the search ended.
    """
    table, motions, visits = legs.table, list[Solution](), list[Visit]()
    robot, period = legs.problem.robot, legs.options.control_period
    q = [table.nodes[node][c] for node, c in zip(nodes, chosen, strict=True)]
    station = [
        None if k is None else legs.stations[k] for k in map(table.station, nodes)
    ]
    halts, place = [Halt(robot, 0.0, period)], 0
    for last in _stops(table, nodes):
        found = _run(legs, list(zip(nodes, chosen, strict=True)), q, place, last)
        if found is None:
            return failed(legs)
        if not found:
            # It is there already.
            visits += halts[-1].visit(station[last], q[last])
        for motion, reached in found:
            begin = halts[-1].end
            motions.append(motion)
            for k, part in zip(reached, motion.segments, strict=True):
                if k != reached[0]:
                    halts.pop()
                halts.append(Halt(robot, begin + part.arrival, period))
                there = motion.trajectory(part.arrival).q
                visits += halts[-1].visit(station[k], there)
        place = last
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
        stays=tuple(halt.stay for halt in halts),
    )


def _stops(table: LegTable, nodes: Sequence[int]) -> list[int]:
    """Places at which motions end: stops, and some between if these are rare."""
    stops = [0]
    for place in range(1, len(nodes)):
        final = place == len(nodes) - 1
        if table.rests[nodes[place]] or final or place - stops[-1] >= MOST_TOGETHER:
            stops.append(place)
    return stops[1:]


def _run(
    legs: Legs,
    way: Sequence[tuple[int, int]],
    q: Sequence[Array],
    first: int,
    last: int,
) -> list[tuple[Solution, list[int]]] | None:
    """Motions from one stop to the next, and the places that each one reaches."""
    if last == first + 1:
        leg = (*way[first], *way[last])
        if legs.stays(leg):
            return []
        found = legs.motion(leg)
        return None if found is None else [(found, [last])]
    stretch = slice(first, last + 1)
    passing = legs.passing([node for node, _ in way[stretch]], q[stretch])
    if passing is not None:
        return [(passing, list(range(first + 1, last + 1)))]
    each = [_run(legs, way, q, k, k + 1) for k in range(first, last)]
    parts = [part for part in each if part is not None]
    return None if len(parts) < len(each) else [item for part in parts for item in part]


def failed(legs: Legs) -> Tour:
    """What is returned where no tour was found."""
    reason = (
        "no order of the stations keeps what was said of it (after, then, precedence)"
    )
    if legs.errors:
        reason = f"of the legs, {legs.errors[-1]}"
    text = f"{Status.INFEASIBLE.value} No tour was found: {reason}"
    return Tour(
        legs.problem,
        legs.stations,
        Status.INFEASIBLE,
        text.rstrip(".") + ".",
        legs_planned=legs.planned,
    )
