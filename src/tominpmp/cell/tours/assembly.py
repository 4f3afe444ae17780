"""Tours put together of the motions of their legs, of one arm or several."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tominpmp.arrays import Array
from tominpmp.cell.tours.legs import DIRECT, Legs
from tominpmp.cell.tours.station import Station
from tominpmp.cell.tours.tour import Tour, Visit
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


@dataclass(frozen=True, eq=False)
class Assembly:
    """Makes a tour of a way through its nodes.

    Attributes:
        legs: What is known of the legs.
    """

    legs: Legs

    def tour(self, nodes: Sequence[int], chosen: Sequence[int], status: Status) -> Tour:
        """Put the motions of a way together.

        Args:
            nodes: The nodes of the tour in their order.
            chosen: The configuration of each.
            status: How the search ended.
        """
        configurations = [
            self.legs.table.nodes[node][c]
            for node, c in zip(nodes, chosen, strict=True)
        ]
        motions: list[Solution] = []
        robot, period = self.legs.problem.robot, self.legs.options.control_period
        halts, visits, place = [Halt(robot, 0.0, period)], list[Visit](), 0
        for last in self._stops(nodes):
            run = slice(place, last + 1)
            found = self._run(nodes[run], chosen[run], place, configurations[run])
            if found is None:
                return failed(self.legs)
            if not found:
                # It is there already.
                visits += halts[-1].visit(self._at(nodes[last]), configurations[last])
            for motion, reached in found:
                begin = halts[-1].end
                ends = [part.arrival for part in motion.segments]
                motions.append(motion)
                for k, end in zip(reached, ends, strict=True):
                    halts.append(Halt(robot, begin + end, period))
                    q = motion.trajectory(end).q
                    visits += halts[-1].visit(self._at(nodes[k]), q)
                    if k != reached[-1]:
                        halts.pop()
            place = last
        message = self._message(status, len(visits))
        return Tour(
            self.legs.problem,
            self.legs.stations,
            status,
            message,
            tuple(visit.station for visit in visits),
            tuple(visits),
            tuple(motions),
            direct=sum(m.message.endswith(DIRECT) for m in motions),
            legs_planned=self.legs.planned,
            stays=tuple(halt.stay for halt in halts),
        )

    def _at(self, node: int) -> Station | None:
        station = self.legs.table.station(node)
        return None if station is None else self.legs.stations[station]

    def _stops(self, nodes: Sequence[int]) -> list[int]:
        """Places at which motions end: stops, and some between if these are rare."""
        stops, since = [], 0
        for place in range(1, len(nodes)):
            since += 1
            final = place == len(nodes) - 1
            if self.legs.table.rests[nodes[place]] or final or since >= MOST_TOGETHER:
                stops.append(place)
                since = 0
        return stops

    def _run(
        self,
        nodes: Sequence[int],
        chosen: Sequence[int],
        place: int,
        q: Sequence[Array],
    ) -> list[tuple[Solution, list[int]]] | None:
        """Motions from one stop to the next, and the places that each one reaches."""
        if len(nodes) == 2:
            leg = (nodes[0], chosen[0], nodes[1], chosen[1])
            if self.legs.stays(leg):
                return []
            found = self.legs.motion(leg)
            return None if found is None else [(found, [place + 1])]
        passing = self.legs.passing(nodes, q)
        if passing is not None:
            return [(passing, list(range(place + 1, place + len(nodes))))]
        legs: list[tuple[Solution, list[int]]] = []
        for k in range(len(nodes) - 1):
            two = slice(k, k + 2)
            part = self._run(nodes[two], chosen[two], place + k, q[two])
            if part is None:
                return None
            legs += part
        return legs

    def _message(self, status: Status, count: int) -> str:
        what = "A tour" if status is Status.CONVERGED else f"{status.value} A tour"
        stations = "1 station" if count == 1 else f"{count} stations"
        return f"{what} over {stations} was found, each motion of it verified."


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
