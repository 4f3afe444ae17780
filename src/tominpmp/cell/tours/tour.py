"""What planning a tour returns: the order, the motions and what bounds the cycle."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tominpmp.cell.tours.cycle import joined
from tominpmp.cell.tours.station import Station, Visit
from tominpmp.exceptions import PlanningFailed, ProblemError, brief
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem import Problem
from tominpmp.solution import Solution
from tominpmp.status import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tominpmp.sensitivities.records import Sensitivities


@dataclass(frozen=True, eq=False)
class Tour:
    """The outcome of planning a tour; true if it is a success.

    Attributes:
        problem: Robot, obstacles and limits; its goal is where the tour ends.
        stations: The stations, as they were given.
        status: How it ended.
        message: The status with its reason, in a sentence or two.
        order: Names of the stations in the order of the visits; empty without a tour.
        visits: The stays at the stations, in that order.
        motions: The motions: one for each leg, or for several without a stop between
            them.
        lower_bound: Time that no tour beats, in any order [s]; 0 if nothing is known.
        bound_reason: What that comes from, in a clause.
        planning_time: Time taken [s].
        direct: How many motions are the fastest that limits of speed and acceleration
            allow, without planning.
        legs_planned: Legs that were planned, also those that are not part of the tour.
        stays: How long the arm stays at the start, and after each motion [s].
    """

    problem: Problem
    stations: tuple[Station, ...]
    status: Status
    message: str
    order: tuple[str, ...] = ()
    visits: tuple[Visit, ...] = ()
    motions: tuple[Solution, ...] = ()
    lower_bound: float = 0.0
    bound_reason: str = ""
    planning_time: float = 0.0
    direct: int = 0
    legs_planned: int = 0
    stays: tuple[float, ...] = field(default=(), repr=False)

    @property
    def success(self) -> bool:
        """Whether all stations are visited, by motions that keep all constraints."""
        return bool(self.order) and all(item.success for item in self.motions)

    def __bool__(self) -> bool:
        """Whether planning was a success."""
        return self.success

    def __repr__(self) -> str:
        """Outcome, stations and cycle time, on one line."""
        time = f"{self.cycle_time:.6g} s" if self.success else "no tour"
        return (
            f"<Tour {self.status.name} of {len(self.stations)} stations for "
            f"{brief(self.problem.robot.name)}: {time}, planned in "
            f"{self.planning_time:.3g} s>"
        )

    @property
    def cycle_time(self) -> float:
        """Time of all motions and stays [s]; infinite if planning failed."""
        if not self.success:
            return math.inf
        return sum(item.T for item in self.motions) + sum(self.stays)

    @property
    def gap(self) -> float | None:
        """Cycle time over the lower bound, less one; None without success or bound."""
        if not self.success or not self.lower_bound > 0.0:
            return None
        return self.cycle_time / self.lower_bound - 1.0

    @property
    def verified(self) -> bool:
        """Whether the replay of every motion is all right."""
        return self.success and all(
            item.verification is not None and item.verification.ok
            for item in self.motions
        )

    @cached_property
    def trajectory(self) -> Trajectory | None:
        """The whole cycle as one motion, with the stays.

        None without a tour, or where the arm only stays where it is.
        """
        motions = [item.trajectory for item in self.motions]
        if not self.success or not motions:
            return None
        return joined([m for m in motions if m is not None], self.stays)

    @cached_property
    def sensitivities(self) -> Sensitivities:
        """What holds the cycle back: how its time changes with each limit and station.

        The sum over the motions; the places of stations whose goals are about a frame
        are records of kind "goal" by their names. See ``docs/sensitivities.md``.

        Raises:
            ProblemError: If there is no tour, or a motion has no multipliers.
        """
        from tominpmp.cell.tours.cycle import cycle_sensitivities

        self._motion()  # there has to be one
        arrivals = [(visit.station, visit.arrival) for visit in self.visits]
        return cycle_sensitivities(
            self.problem, self.stations, self.motions, self.stays, arrivals
        )

    def raise_if_failed(self) -> Tour:
        """Return itself, or raise if planning failed.

        Raises:
            PlanningFailed: If there is no tour.
        """
        if not self.success:
            raise PlanningFailed(self)
        return self

    def _motion(self) -> Trajectory:
        motion = self.trajectory
        if motion is None:
            raise ProblemError(f"there is no tour: {self.message}", "trajectory")
        return motion

    def play(self, path: str | Path | None = None, **options: Any) -> Any:
        """Show the whole cycle in Meshcat; see :func:`tominpmp.viz.playback.play`.

        Args:
            path: Where to write a page that works offline; None opens a browser.
            **options: Passed on.

        Raises:
            ProblemError: If there is no tour.
            MissingDependency: If Meshcat is not installed.
        """
        from tominpmp.viz.playback import play

        motion = self._motion()
        name = self.problem.robot.name
        options.setdefault(
            "title",
            f"{name}: {len(self.order)} stations, cycle {self.cycle_time:.4g} s",
        )
        return play(self.problem, motion, path=path, **options)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw a Gantt picture: motions and stays over time, with the joints' speeds.

        Args:
            path: File to write (PNG, PDF or SVG by its ending), if any.

        Returns:
            The figure.

        Raises:
            ProblemError: If there is no tour.
            MissingDependency: If matplotlib is not installed.
        """
        from tominpmp.cell.tours.tour_plot import plot_tour

        return plot_tour(self.problem, self._motion(), self.visits, path=path)

    gantt = plot

    def export(
        self,
        path: str | Path,
        *,
        dt: float | None = None,
        with_effort: bool = False,
        message: str | None = None,
    ) -> Path:
        """Write the whole cycle as CSV, NPZ or ROS message, by the ending of the path.

        Args:
            path: File to write.
            dt: Time between rows [s]; None writes the nodes.
            with_effort: Whether ROS messages have the torques.
            message: Which ROS message, see :func:`~tominpmp.files.export.export`.

        Returns:
            The path.

        Raises:
            ProblemError: If there is no tour, the ending is unknown or an option is
                wrong.
            ScenarioError: If the file cannot be written.
        """
        from tominpmp.files.export import export

        return export(
            self._motion(), path, dt=dt, with_effort=with_effort, message=message
        )

    def table(self) -> str:
        """The visits as a table: station, arrival, stay and departure [s]."""
        width = max([7, *(len(visit.station) for visit in self.visits)])
        rows = [f"{'station':<{width}}  arrival [s]  stay [s]  departure [s]"]
        rows += [
            f"{visit.station:<{width}}  {visit.arrival:11.4f}  "
            f"{visit.departure - visit.arrival:8.4f}  {visit.departure:13.4f}"
            for visit in self.visits
        ]
        return "\n".join(rows)
