"""Motions drawn on axes that a caller has."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tominpmp.checks import wrong
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem import Problem
from tominpmp.viz.figures import LIMIT_COLOR, color, finish, styled
from tominpmp.viz.plots import curves
from tominpmp.viz.skeleton import check_motion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TITLES = ("position [rad or m]", "velocity [rad/s or m/s]", "torque [N m or N]")


def plot_on_axes(
    problem: Problem,
    trajectory: Trajectory,
    ax: Axes | Sequence[Axes],
    path: str | Path | None = None,
) -> Figure:
    """Draw a motion on one or three axes of matplotlib.

    Args:
        problem: The problem, for the limits of its robot.
        trajectory: The motion.
        ax: One, for torques as shares of their limits, or three, for positions,
            velocities and torques.
        path: File to write the figure of the axes to, if any.

    Returns:
        The figure of the axes.

    Raises:
        ProblemError: If they are no such axes.
        MissingDependency: If matplotlib is not installed.
    """
    check_motion(problem, trajectory)
    with styled():
        from matplotlib.axes import Axes

        given: list[Any] = list(np.ravel(np.asarray(ax, object)))
        if len(given) not in (1, 3) or not all(isinstance(a, Axes) for a in given):
            raise wrong(ax, "ax", "one or three axes of matplotlib")
    times, state = curves(trajectory)
    limits, names = problem.robot.limits, problem.robot.joint_names
    if len(given) == 1:
        largest = np.maximum(np.abs(limits.effort_lower), limits.effort_upper)
        share = state.u / np.where(largest > 0.0, largest, np.inf)
        drawn = [("torque over its limit", share)]
        for at in (-1.0, 1.0):
            given[0].axhline(at, color=LIMIT_COLOR, linewidth=0.8, linestyle="--")
    else:
        drawn = list(zip(TITLES, (state.q, state.v, state.u), strict=True))
    for panel, (title, values) in zip(given, drawn, strict=True):
        for i, name in enumerate(names):
            panel.plot(times, values[:, i], color=color(i), label=name)
        panel.set_title(title, loc="left")
        panel.set_xlabel("time [s]")
    given[-1].legend(fontsize="small")
    figure: Figure = given[0].figure
    return finish(figure, path)
