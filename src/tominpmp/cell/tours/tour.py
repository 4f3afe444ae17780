"""The result of planning a tour: order, motions, lower bound and sensitivities.

The whole cycle is its motions and dwells joined to one motion. The sensitivity of the
cycle to a motor or an obstacle is the sum over the motions. The legs of a tour end at
fixed configurations, so their multipliers do not cover the place of a station: for this
the two motions that meet there are analysed as one, with the goal of the station
between them, so that the arm may reach a displaced station at another configuration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tominpmp.cell.tours.station import Station, Visit
from tominpmp.exceptions import PlanningFailed, ProblemError, brief, counted, shortened
from tominpmp.motion.trajectory import Trajectory
from tominpmp.notebook import text_table
from tominpmp.problem.problem import Problem
from tominpmp.problem.sequence import in_sequence, joined
from tominpmp.sensitivities.analysis import analyse
from tominpmp.sensitivities.records import Sensitivities, Sensitivity
from tominpmp.solution import Solution
from tominpmp.status import Status
from tominpmp.viz import figures
from tominpmp.viz.shares import shares_of_limits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Difference below which times are equal [s].
SAME = 1e-9
# Predicted gain of two joined motions, as a share of their time, above which they are
# too far from an optimum for the sensitivity of the place between them.
MOST_PROMISE = 0.02
# Largest number of stations whose names a chart shows; of more every k-th is named; and
# most characters of a name.
MOST_NAMES, LONGEST_NAME = 40, 40
MOTION_COLOR, DWELL_COLOR = "#8fa3b8", "#1d8a50"


@dataclass(frozen=True, eq=False)
class Tour:
    """The outcome of planning a tour; true if it is a success.

    Attributes:
        problem: Robot, obstacles and limits; its goal is the end of the tour.
        stations: The stations, in the order of the caller.
        status: Why planning ended.
        message: The status with its reason, in a sentence or two.
        order: Names of the stations in the order of the visits; empty without a tour.
        visits: The stays at the stations, in that order.
        motions: The motions: one for each leg, or one for several legs without a stop
            between them.
        lower_bound: Lower bound of the cycle time over all orders [s]; 0 if no bound is
            known.
        bound_reason: Derivation of the lower bound, in a clause.
        planning_time: Time taken [s].
        direct: Number of motions that were not planned, as limits of speed and
            acceleration allow no faster ones.
        legs_planned: Number of legs that were planned, including legs that are not part
            of the tour.
        stays: Dwell times at the start, and after each motion [s].
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
            f"<Tour {self.status.name} of {counted(len(self.stations), 'station')} for "
            f"{brief(self.problem.robot.name)}: {time}, planned in "
            f"{self.planning_time:.3g} s>"
        )

    @property
    def cycle_time(self) -> float:
        """Time of all motions and dwells [s]; infinite if planning failed."""
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
        """Whether the replay of every motion passed."""
        return self.success and all(item.verification for item in self.motions)

    @cached_property
    def trajectory(self) -> Trajectory | None:
        """The whole cycle as one motion, with the dwells.

        None without a tour, or if the arm does not move in it.
        """
        if not self.success or not self.motions:
            return None
        return joined([item.trajectory for item in self.motions], self.stays)

    @cached_property
    def sensitivities(self) -> Sensitivities:
        """Sensitivities of the cycle time to each limit, obstacle and station.

        They are sums over the motions; the places of stations whose goals are on a
        frame are records of kind "goal" by their names. See ``docs/sensitivities.md``.

        Raises:
            ProblemError: If there is no tour, or a motion has no multipliers.
        """
        self._motion()  # raises without a tour
        parts = [motion.sensitivities for motion in self.motions]
        whole = Sensitivities.of_cycle(parts, T=self.cycle_time)
        others = [item for item in whole if item.kind != "goal"]
        return replace(whole, records=(*others, *self._places()))

    def _places(self) -> list[Sensitivity]:
        """Sensitivities to the places of the stations at which the arm stops."""
        named = {station.name: station for station in self.stations}
        places, end = list[Sensitivity](), self.stays[0]
        pairs = zip(self.motions, self.motions[1:], self.stays[1:], strict=False)
        for before, after, stay in pairs:
            end += before.T
            first, until = end - SAME, end + stay + SAME
            visited = [v.station for v in self.visits if first <= v.arrival <= until]
            end += stay
            alone = not before.problem.segments and not after.problem.segments
            if len(visited) == 1 and alone:
                place = _place(self.problem, named[visited[0]], before, after)
                if place is not None:
                    share = (before.T + after.T) / self.cycle_time
                    places.append(place.scaled(share))
        return places

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
            why = f"there is no tour: {self.message}"
            if self.success:
                why = "the tour has no motion: all stations are at the start"
            raise ProblemError(why, "trajectory")
        return motion

    def play(self, path: str | Path | None = None, **options: Any) -> Any:
        """Show the whole cycle in Meshcat; see :func:`tominpmp.viz.playback.play`.

        Args:
            path: Where to write a page that works offline; None opens a browser.
            **options: Further arguments of this function.

        Raises:
            ProblemError: If there is no tour.
            MissingDependency: If Meshcat is not installed.
        """
        whole, name = self._solution(), self.problem.robot.name
        title = f"{name}: {len(self.order)} stations, cycle {self.cycle_time:.4g} s"
        return whole.play(path, **{"title": title} | options)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw a Gantt chart: motions and dwells over time, with the joints' speeds.

        Args:
            path: File to write (PNG, PDF or SVG by its ending), if any.

        Returns:
            The figure.

        Raises:
            ProblemError: If there is no tour.
            MissingDependency: If matplotlib is not installed.
        """
        problem, motion, visits = self.problem, self._motion(), self.visits
        height = 1.0 + 0.17 * min(len(visits), MOST_NAMES)
        with figures.styled():
            figure = figures.new_figure(8.0, height + 2.4)
            panels = figure.subplots(2, 1, sharex=True, height_ratios=(height, 2.0))
            _draw_bars(panels[0], motion.duration, visits)
            _draw_speeds(panels[1], problem, motion)
            panels[1].set_xlabel("time [s]")
            panels[1].set_xlim(0.0, motion.duration)
            figures.add_legend(figure, 6)
            return figures.finish(figure, path)

    gantt = plot

    def export(self, path: str | Path, **options: Any) -> Path:
        """Write the whole cycle as CSV, NPZ or ROS message, by the ending of the path.

        Args:
            path: File to write.
            **options: Options of :meth:`~tominpmp.solution.Solution.export`: dt,
                with_effort, message and verify.

        Returns:
            The path.

        Raises:
            ProblemError: If there is no tour, the ending is unknown or an option is
                wrong.
            ScenarioError: If the file cannot be written.
        """
        return self._solution().export(path, **options)

    def _solution(self) -> Solution:
        """The whole cycle as one solution, not yet verified.

        Raises:
            ProblemError: If there is no tour.
        """
        motion, parts = self._motion(), [item.problem for item in self.motions]
        return replace(
            self.motions[0],
            problem=in_sequence(self.problem, parts, self.stays[1:]),
            trajectory=motion,
            planning_time=self.planning_time,
            verification=None,
        )

    def table(self) -> str:
        """The visits as a table: station, arrival, stay and departure [s]."""
        rows = [["station", "arrival [s]", "stay [s]", "departure [s]"]]
        for visit in self.visits:
            times = visit.arrival, visit.departure - visit.arrival, visit.departure
            rows.append([visit.station, *(f"{time:.4f}" for time in times)])
        return text_table(rows, left=1)


def _place(
    problem: Problem, station: Station, before: Solution, after: Solution
) -> Sensitivity | None:
    """Sensitivity of the two motions that meet at a station to its place.

    None if the goal is a configuration, the multipliers are unknown, or both motions
    joined are too far from an optimum.
    """
    if station.goal.configuration is not None:
        return None
    to_station = before.problem._altered(goal=station.goal)
    both = in_sequence(problem, (to_station, after.problem), (0.0, 0.0))
    try:
        whole = joined([before.trajectory, after.trajectory], (0.0, 0.0, 0.0))
        sensitivities = analyse(both, whole)
    except ProblemError:
        return None  # no multipliers, or a goal that a segment cannot have
    if sensitivities.promise > MOST_PROMISE:
        return None
    places = [r for r in sensitivities if r.kind == "goal" and r.joint is None]
    matching = [r for r in places if r.subject.endswith("of segment 1")]
    return replace(matching[0], subject=station.name) if matching else None


def _draw_bars(axes: Axes, duration: float, bars: Sequence[Visit]) -> None:
    """Draw a row for each station: the motion to it, then the dwell."""
    before = 0.0
    for row, bar in enumerate(bars):
        motion, stay = bar.arrival - before, bar.departure - bar.arrival
        axes.barh(row, motion, left=before, color=MOTION_COLOR, label="motion")
        axes.barh(row, stay, left=bar.arrival, color=DWELL_COLOR, label="dwell")
        before = bar.departure
    home = duration - before
    names = [bar.station for bar in bars]
    if home > SAME:
        axes.barh(len(bars), home, left=before, color=MOTION_COLOR)
        names.append("end")
    stride = 1 + len(names) // MOST_NAMES
    shown = list(range(0, len(names), stride))
    axes.set_yticks(shown, [shortened(names[row], LONGEST_NAME) for row in shown])
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(False, axis="y")


def _draw_speeds(axes: Axes, problem: Problem, trajectory: Trajectory) -> None:
    """Draw speeds as shares of their limits."""
    shares = shares_of_limits(problem, trajectory)
    for joint, name in enumerate(shares.joint_names):
        speed = shares.speed[:, joint]
        axes.plot(shares.t, speed, color=figures.color(joint), lw=0.8, label=name)
    for limit in (-1.0, 1.0):
        axes.axhline(limit, color="0.6", lw=0.6, ls="--")
    axes.set_ylabel("speed / limit")
    axes.set_ylim(-1.15, 1.15)
