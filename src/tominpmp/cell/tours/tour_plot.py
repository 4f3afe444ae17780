"""Gantt picture of a tour: motions and stays over time, and speeds of the joints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.cell.tours.station import Visit
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem import Problem
from tominpmp.viz.figures import (
    GOAL_COLOR,
    add_legend,
    color,
    finish,
    new_figure,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Stations whose names are written; of more only some are.
MOST_NAMES = 40
# Points at which speeds are drawn.
POINTS = 3_000
MOTION_COLOR = "#8fa3b8"
# A stay that takes no time is drawn as long as this share of the cycle.
LEAST_BAR = 0.002


def plot_tour(
    problem: Problem,
    trajectory: Trajectory,
    visits: Sequence[Visit],
    *,
    path: str | Path | None = None,
) -> Figure:
    """Draw when a tour is where, and how fast the joints go.

    Args:
        problem: The problem, for limits of speed.
        trajectory: The whole cycle.
        visits: The stays at the stations, in their order.
        path: File to write (PNG, PDF or SVG by its ending), if any.

    Returns:
        The figure.

    Raises:
        ProblemError: If the ending of the path is unknown.
        ScenarioError: If the file cannot be written.
        MissingDependency: If matplotlib is not installed.
    """
    height = 1.0 + 0.17 * min(len(visits), MOST_NAMES)
    with styled():
        figure = new_figure(8.0, height + 2.4)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(height, 2.0))
        _draw_bars(above, trajectory.duration, visits)
        _draw_speeds(below, problem, trajectory)
        below.set_xlabel("time [s]")
        below.set_xlim(0.0, trajectory.duration)
        lines = below.get_lines()
        add_legend(figure, lines[: problem.robot.n], 6)
        return finish(figure, path)


def _draw_bars(axes: Axes, duration: float, bars: Sequence[Visit]) -> None:
    """A row for each station: the way there, then the stay."""
    least, before = LEAST_BAR * duration, 0.0
    for row, bar in enumerate(bars):
        axes.barh(row, bar.arrival - before, left=before, color=MOTION_COLOR)
        stay = max(bar.departure - bar.arrival, least)
        axes.barh(row, stay, left=bar.arrival, color=GOAL_COLOR)
        before = bar.departure
    home = duration - before
    names = [bar.station for bar in bars]
    if home > least:
        axes.barh(len(bars), home, left=before, color=MOTION_COLOR)
        names.append("end")
    every = 1 + len(names) // MOST_NAMES
    shown = list(range(0, len(names), every))
    axes.set_yticks(shown, [names[row] for row in shown])
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(False, axis="y")


def _draw_speeds(axes: Axes, problem: Problem, trajectory: Trajectory) -> None:
    """Speeds as shares of their limits, or of the largest where there is none."""
    t = np.unique(
        np.concatenate([np.linspace(0.0, trajectory.duration, POINTS), trajectory.t])
    )
    v = trajectory(t).v
    top = problem.robot.limits.velocity
    largest = np.maximum(np.max(np.abs(v), axis=0), 1e-9)
    scale = np.where(np.isfinite(top), top, largest)
    for joint, name in enumerate(problem.robot.joint_names):
        axes.plot(t, v[:, joint] / scale[joint], color=color(joint), lw=0.8, label=name)
    for limit in (-1.0, 1.0):
        axes.axhline(limit, color="0.6", lw=0.6, ls="--")
    axes.set_ylabel("speed / limit")
    axes.set_ylim(-1.15, 1.15)
