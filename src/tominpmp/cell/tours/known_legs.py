"""Legs of a tour as far as they are known: direct, planned, or blocked."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.cell.tours.direct_motion import NO_WAY
from tominpmp.cell.tours.leg_table import Leg, LegTable
from tominpmp.cell.tours.legs import LegPlanner
from tominpmp.solution import Solution
from tominpmp.status import Status
from tominpmp.stopping import Stop, check, seconds_left
from tominpmp.trajectory import Trajectory


@dataclass(eq=False)
class KnownLegs:
    """What is known of legs, and how more is found out.

    Attributes:
        table: Times of the legs, which are written down there.
        planner: Plans the legs.
        motions: Motions of the legs that were replayed or planned.
        detours: What blocked legs have taken, as shares of their direct times.
    """

    table: LegTable
    planner: LegPlanner
    motions: dict[Leg, Solution] = field(default_factory=dict)
    detours: list[float] = field(default_factory=list)
    _looked_at: set[Leg] = field(default_factory=set)
    _unverified: dict[Leg, Trajectory] = field(default_factory=dict)

    def _ends(self, leg: Leg) -> tuple[int | None, int | None, Array, Array]:
        """Stations where a leg begins and ends, and the configurations there."""
        begin, end = self.table.station(leg[0]), self.table.station(leg[2])
        return begin, end, *self.table.rows(leg)

    def resting(self, leg: Leg) -> bool:
        """Whether the arm is at rest at both ends of a leg."""
        return bool(self.table.rests[leg[0]] and self.table.rests[leg[2]])

    def direct(self, leg: Leg) -> bool:
        """Look for the direct motion of a leg; False where its way is found blocked."""
        check()
        if leg in self._looked_at or leg in self.table.known or not self.resting(leg):
            return True
        self._looked_at.add(leg)
        if self.stays(leg):
            self.table.learn(leg, 0.0)
            return True
        found = self.planner.direct(*self._ends(leg))
        if isinstance(found, Trajectory):
            self._unverified[leg] = found
            self.table.learn(leg, found.duration)
        elif not found:
            self.table.block_way(leg)
        return bool(found)

    def verified(self, leg: Leg) -> bool:
        """Replay the direct motion of a leg; False where that is not all right."""
        motion = self._unverified.pop(leg, None)
        if motion is None:
            return True
        found = self.planner.verified(*self._ends(leg), motion)
        if found is None:
            self.table.forget(leg)
            self.table.block_way(leg)
            return False
        self.motions[leg] = found
        return True

    def stays(self, leg: Leg) -> bool:
        """Whether a leg leads nowhere."""
        begin, end = self.table.rows(leg)
        return float(np.max(np.abs(begin - end), initial=0.0)) < NO_WAY

    def seconds(self, leg: Leg) -> float:
        """Time of a leg that is not known yet, infinite where there is no motion."""
        if leg not in self._looked_at:
            self.direct(leg)
        if leg in self.table.known and self.verified(leg):
            return self.table.known[leg]
        found = self.planned(leg)
        if found is None or not found.success:
            return np.inf
        self.motions[leg] = found
        if self.table.is_blocked(leg):
            least = float(self.table.times.between(*self.table.rows(leg)))
            self.detours.append(found.T / least)
        return found.T

    def planned(self, leg: Leg) -> Solution | None:
        """Plan a leg; None where it is not possible at all."""
        self.limit_time()
        found = self.planner.leg(*self._ends(leg))
        if found is not None and found.status is Status.INTERRUPTED:
            raise Stop(True)
        if found is not None and not found.success:
            self.planner.errors.append(found.message)
        return found

    def limit_time(self) -> None:
        """Give what is planned next the time that is left."""
        left = seconds_left()
        if np.isfinite(left):
            options = replace(self.planner.options, max_planning_time=left)
            self.planner.options = options

    def factor(self) -> float:
        """How much longer legs take than by the estimates of the joints."""
        ratios = []
        for leg, seconds in self.table.known.items():
            guess = float(self.table.times.between(*self.table.rows(leg)))
            if guess > 0.0 and np.isfinite(seconds):
                ratios.append(seconds / guess)
        return max(1.0, float(np.median(ratios))) if ratios else 1.0
