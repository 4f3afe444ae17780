"""The search for a tour: order and configurations by estimates, legs as needed.

Estimates of the times of legs give an order with configurations. Its legs are planned,
what they take is written down in the place of the estimates, and the order is looked
for again, until one comes out of which all legs are planned: what other orders would
take was then estimated only, but never found.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.cell.tours.assembly import Assembly, failed
from tominpmp.cell.tours.configurations import Configurations
from tominpmp.cell.tours.joint_times import JointTimes
from tominpmp.cell.tours.known_legs import KnownLegs
from tominpmp.cell.tours.leg_table import Leg, LegTable
from tominpmp.cell.tours.legs import LegPlanner
from tominpmp.cell.tours.orders import best_order
from tominpmp.cell.tours.refinement import refined
from tominpmp.cell.tours.station import Rules, Station, called
from tominpmp.cell.tours.tour import Tour
from tominpmp.exceptions import ProblemError
from tominpmp.options import Options
from tominpmp.problem import Problem
from tominpmp.status import Status
from tominpmp.stopping import Stop

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
# Share by which a leg may take less than estimated before other estimates of blocked
# legs are taken for too long, too.
SOONER = 0.02
# Rounds of looking for better configurations, and while legs are blocked.
REFINEMENTS, FEW_REFINEMENTS = 24, 6
# Rounds of going around what is on the direct ways of legs.
SETTLING = 18

# A way through a tour: order of the stations and the configurations of all nodes.
Way = tuple[tuple[int, ...], tuple[int, ...]]


@dataclass(eq=False)
class TourSearch:
    """What is known of a tour while it is looked for.

    Attributes:
        problem: Robot, obstacles and limits.
        stations: The stations.
        rules: Orders that are allowed.
        options: How legs are planned.
        configurations: What is allowed at stations.
        table: Times of the legs.
        legs: What is known of the legs.
        rng: Random numbers.
        exact: Whether only times that no motion beats stand for legs not planned.
    """

    problem: Problem
    stations: tuple[Station, ...]
    rules: Rules
    options: Options
    configurations: Configurations
    table: LegTable
    legs: KnownLegs
    rng: np.random.Generator
    exact: bool = False

    @classmethod
    def of(
        cls,
        problem: Problem,
        stations: tuple[Station, ...],
        rules: Rules,
        ends: bool,
        count: int,
        options: Options,
        exact: bool,
    ) -> TourSearch:
        """Look for configurations at all stations.

        Raises:
            ProblemError: If there is none for a station: names it.
        """
        rng = np.random.default_rng(options.seed)
        times = JointTimes.of(problem)
        planner = LegPlanner(problem, stations, options)
        finder = Configurations(
            problem,
            tuple(station.goal for station in stations),
            times.weights,
            planner.leaving,
        )
        found = finder.search(count, rng)
        for number, rows in enumerate(found):
            if not len(rows):
                raise ProblemError(
                    f"{called(number + 1, stations[number].name)} cannot be reached: "
                    f"{finder.unreached(number)}",
                    f"stations[{number}]",
                )
        if not exact:
            times = times.with_acceleration(_torque_limited(problem, found))
        nodes = [problem.q_start[None], *found]
        rests = [True, *(station.stop for station in stations)]
        if ends:
            nodes.append(np.asarray(problem.goal.configuration)[None])
            rests.append(True)
        table = LegTable(nodes, rests, times, ends)
        legs = KnownLegs(table, planner)
        return cls(problem, stations, rules, options, finder, table, legs, rng, exact)

    def run(self) -> Tour:
        """Look for the tour."""
        way = self._improved()
        best: tuple[float, Way] | None = None
        rounds = 10_000 if self.exact else ROUNDS[self.options.effort]
        status, number = Status.CONVERGED, 0
        try:
            while way is not None:
                way = self._settled(way)
                complete = self._plan_legs(way)
                length = self._length(way)
                if np.isfinite(length) and (best is None or length < best[0]):
                    best = length, way
                number += 1
                logger.info("round %d: %.4f s", number, length)
                if complete or (number >= rounds and best is not None):
                    break
                if number >= max(rounds, MOST_ROUNDS):
                    break
                way = self._order(way)
        except (Stop, KeyboardInterrupt) as stop:
            requested = not isinstance(stop, Stop) or stop.requested
            status = Status.INTERRUPTED if requested else Status.TIME_LIMIT
            if best is None:
                raise
        if best is None:
            return failed(self.problem, self.stations, self.legs.planner)
        order, chosen = best[1]
        legs = Assembly(self.problem, self.stations, self.legs)
        return legs.tour(self.table.way(order), chosen, status)

    # -- order and configurations ------------------------------------------------------

    def _order(self, before: Way | None = None) -> Way | None:
        """Best order that is found for the times that are known or estimated."""
        begin = () if before is None else before[0]
        length, order, chosen = best_order(self.table, self.rules, self.rng, begin)
        return (order, chosen) if np.isfinite(length) and order else None

    def _improved(self) -> Way | None:
        """Order and configurations by estimates, in turns."""
        way = self._order()
        for _ in range(TURNS):
            if way is None or not self._refine(way):
                break
            way = self._order(way)
        return way

    def _settled(self, way: Way) -> Way:
        """Go around what is on the direct ways of legs, as long as that changes them.

        A leg that has to be planned costs more than one that has not.
        """
        if self.exact:
            return way
        for _ in range(SETTLING if not self.legs.motions else SETTLING // 3):
            blocked = [leg for leg in self._legs(way) if not self.legs.direct(leg)]
            if not blocked:
                # Only what is left in the end is worth a replay.
                blocked = [
                    leg for leg in self._legs(way) if not self.legs.verified(leg)
                ]
            if not blocked:
                break
            logger.info("%d legs are blocked", len(blocked))
            other = self._order(way)
            if other is not None and self._refine(other, FEW_REFINEMENTS):
                other = self._order(other)
            if other is None:
                break
            way = other
        return way

    def _refine(self, way: Way, rounds: int = REFINEMENTS) -> bool:
        """Add better configurations for an order; whether there are any."""
        order, chosen = way
        nodes = self.table.way(order)
        places = [
            self.table.nodes[node][c] for node, c in zip(nodes, chosen, strict=True)
        ]
        better = refined(
            self.configurations, self.table, nodes, places, self.rng, rounds
        )
        found = False
        for node, new in zip(nodes, better, strict=True):
            apart = np.max(np.abs(self.table.nodes[node] - new), axis=1)
            if np.min(apart) > APART:
                self.table.add(node, new[None])
                found = True
        return found

    # -- legs --------------------------------------------------------------------------

    def _legs(self, way: Way) -> list[Leg]:
        nodes = self.table.way(way[0])
        places = list(zip(nodes, way[1], strict=True))
        return [(*a, *b) for a, b in pairwise(places)]

    def _plan_legs(self, way: Way) -> bool:
        """Plan the legs of a tour; whether all of them were planned before."""
        for leg in self._legs(way):
            self.legs.verified(leg)
        before = {leg: self.table.time(leg) for leg in self._legs(way)}
        new = [
            leg
            for leg in before
            if leg not in self.table.known and self.legs.resting(leg)
        ]
        missed = sooner = 0.0
        for leg in new:
            seconds = self.legs.seconds(leg)
            missed = max(missed, seconds - before[leg])
            sooner = max(sooner, 1.0 - seconds / max(before[leg], 1e-9))
            self.table.learn(leg, seconds)
        if new and self.legs.detours:
            self.table.detours_take(float(np.median(self.legs.detours)))
        if new and not self.exact:
            self.table.scaled(self.legs.factor())
        # As estimated: no other order can be better by these estimates.
        return missed <= 1e-9 and sooner <= SOONER

    def _length(self, way: Way) -> float:
        """Time of the legs; those between places that are passed as estimated."""
        return sum(self.table.time(leg) for leg in self._legs(way))


def _torque_limited(problem: Problem, found: Sequence[Array]) -> Array:
    """Accelerations that the torques of the joints allow, roughly, shape (n,).

    The room that gravity leaves, over the inertia at the joint: what others do at the
    same time, and how the arm stretches on the way, is left out.
    """
    robot, model = problem.robot, problem.robot.model
    data = model.createData()
    rows = np.concatenate([problem.q_start[None], *(rows[:2] for rows in found)])
    limits, scale = robot.limits, 1.0
    if problem.motion_limits is not None:
        scale = problem.motion_limits.effort_scale
    S = np.eye(robot.n) if robot.expansion_matrix is None else robot.expansion_matrix
    half = 0.5 * scale * (limits.effort_upper - limits.effort_lower)
    each = []
    for q in rows[:: max(1, len(rows) // 40)]:
        M = np.array(pin.crba(model, data, robot.expand(q)))
        M = np.triu(M) + np.triu(M, 1).T
        weight = S.T @ pin.computeGeneralizedGravity(model, data, robot.expand(q))
        inertia = np.diag(S.T @ M @ S)
        room = np.maximum(half - np.abs(weight), 0.1 * half)
        each.append(room / np.maximum(inertia, 1e-9))
    most = np.median(each, axis=0)
    return np.where(most > 0.0, most, np.inf)
