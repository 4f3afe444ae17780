"""Plots of motions over time and of the convergence of the solvers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.checks import wrong
from tominpmp.exceptions import ProblemError
from tominpmp.motion.trajectory import State, Trajectory
from tominpmp.problem import Problem
from tominpmp.robot import Robot
from tominpmp.status import IterationRecord
from tominpmp.viz.figures import (
    BEYOND_COLOR,
    LIMIT_COLOR,
    LIMIT_LOOK,
    LINE_STYLES,
    MARKERS,
    MOMENT,
    add_legend,
    area_key,
    color,
    finish,
    line_key,
    name_size,
    new_figure,
    note,
    show_limit,
    styled,
    time_axes,
)
from tominpmp.viz.motion_plot import plot_motion
from tominpmp.viz.skeleton import check_motion, check_motions

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_controls", "plot_convergence", "plot_motion", "plot_trajectory"]

# Points drawn of a motion, at least, so that what is curved looks it.
CURVE_POINTS = 500

# A limit further off than this many times the largest value is not drawn: the curve
# would be flat.
FAR_LIMIT = 2.5

# A method that takes this many times as many iterations as another is drawn to another
# scale, or the other would be a point.
ITERATION_RATIO = 6.0

# Of the lines where segments end: darker than the grid, lighter than the axes.
SEGMENT_COLOR = "0.55"

# Quantities over time on a caller's axes.
TITLES = ("position [rad or m]", "velocity [rad/s or m/s]", "torque [N m or N]")

# Violations below this count as none; a logarithm needs something.
LEAST_VIOLATION = 1e-12


def plot_trajectory(
    problem: Problem, trajectory: Trajectory, path: str | Path | None = None
) -> Figure:
    """Plot positions, velocities and torques over time, with their limits.

    Args:
        problem: The problem, for the limits of its robot.
        trajectory: The motion.
        path: File to write (PNG, PDF or SVG by its ending), if any.

    Returns:
        The figure: one row a joint, one column a quantity.

    Raises:
        ProblemError: If the motion is not one of the problem's robot, or the ending of
            the path is unknown.
        ScenarioError: If the file cannot be written.
        MissingDependency: If matplotlib is not installed.
    """
    check_motion(problem, trajectory)
    robot = problem.robot
    limits = robot.limits
    times, state = curves(trajectory)
    prismatic = _prismatic(robot)
    columns = [
        ("position", state.q, (limits.position_lower, limits.position_upper)),
        ("velocity", state.v, (-limits.velocity, limits.velocity)),
        (
            "force" if prismatic.all() else "torque",
            state.u,
            (limits.effort_lower, limits.effort_upper),
        ),
    ]
    with styled():
        figure = new_figure(9.0, max(2.6, 0.7 + 1.15 * robot.n))
        # Sharing, and aligning labels, costs time with the square of the panels.
        axes = figure.subplots(robot.n, 3, squeeze=False)
        mixed = bool(prismatic.any() and not prismatic.all())
        for i, joint in enumerate(robot.joint_names):
            for column, (title, values, (lower, upper)) in enumerate(columns):
                panel = axes[i, column]
                panel.plot(times, values[:, i], color=color(i))
                _show_limits(panel, values[:, i], lower[i], upper[i])
                panel.tick_params(labelbottom=i == robot.n - 1)
                unit = _unit(title, bool(prismatic[i]))
                if mixed:
                    panel.set_ylabel(f"[{unit}]", labelpad=2.0)
                if i == 0:
                    heading = title if mixed else f"{title} [{unit}]"
                    panel.set_title(heading, loc="left")
            note(
                axes[i, 0],
                joint,
                (-0.36, 0.5),
                rotation=90,
                ha="center",
                va="center",
                fontsize=name_size(joint),
                fontweight="bold",
                color=color(i),
                annotation_clip=False,
            )
        time_axes(axes, trajectory.duration)
        _show_segments(axes, trajectory)
        add_legend(figure, _limit_keys(), 2)
        return finish(figure, path)


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
            show_limit(given[0], at)
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


def plot_controls(
    problem: Problem,
    trajectories: Mapping[str, Trajectory],
    path: str | Path | None = None,
) -> Figure:
    """Plot the torques of one or several motions over time, one panel a joint.

    Args:
        problem: The problem, for the limits of its robot.
        trajectories: The motions by label.
        path: File to write (PNG, PDF or SVG by its ending), if any.

    Raises:
        ProblemError: If there is no motion, one is not of the problem's robot, or the
            ending of the path is unknown.
        ScenarioError: If the file cannot be written.
        MissingDependency: If matplotlib is not installed.
    """
    check_motions(problem, trajectories)
    robot = problem.robot
    limits, prismatic = robot.limits, _prismatic(robot)
    with styled():
        wide = 1 if robot.n <= 3 else 2
        rows = -(-robot.n // wide)
        figure = new_figure(3.0 + 3.2 * wide, max(2.2, 0.7 + 1.35 * rows))
        axes = figure.subplots(rows, wide, sharex=True, squeeze=False)
        handles = []
        for k, (label, trajectory) in enumerate(trajectories.items()):
            times, state = curves(trajectory)
            # Later ones are thinner, so that none hides another on a limit.
            width = 1.4 if len(trajectories) == 1 else max(2.2 - 0.7 * k, 0.8)
            look: dict[str, Any] = {"color": color(k), "linewidth": width}
            for i in range(robot.n):
                axes[i // wide, i % wide].plot(times, state.u[:, i], **look)
            name = f"{label} (T = {trajectory.duration:.4g} s)"
            handles.append(line_key(name, **look))
        for i, joint in enumerate(robot.joint_names):
            panel = axes[i // wide, i % wide]
            drawn = np.concatenate([line.get_ydata() for line in panel.get_lines()])
            _show_limits(panel, drawn, limits.effort_lower[i], limits.effort_upper[i])
            symbol = f"$u_{{{i + 1}}}$"
            panel.set_ylabel(f"{symbol} [{_unit('torque', bool(prismatic[i]))}]")
            panel.set_title(joint, loc="left")
        for extra in axes.reshape(-1)[robot.n :]:
            extra.set_axis_off()
            axes[-2, -1].tick_params(labelbottom=True)
            axes[-2, -1].set_xlabel("time [s]")
        figure.align_ylabels()
        time_axes(axes, max(item.duration for item in trajectories.values()))
        add_legend(figure, [*handles, _limit_keys()[0]], 4)
        return finish(figure, path)


def plot_convergence(
    histories: Mapping[str, Sequence[IterationRecord]],
    path: str | Path | None = None,
) -> Figure:
    """Plot T and the largest violation over the iterations of one or several methods.

    Args:
        histories: The records by label; where they come from several starts, each start
            is a line of its own.
        path: File to write (PNG, PDF or SVG by its ending), if any.

    Returns:
        The figure: T above, the violation on a logarithmic axis below.

    Raises:
        ProblemError: If there is no record, or the ending of the path is unknown.
        ScenarioError: If the file cannot be written.
        MissingDependency: If matplotlib is not installed.
    """
    if not any(len(history) for history in histories.values()):
        raise ProblemError("there is no iteration to plot", "histories")
    with styled():
        figure = new_figure(6.4, 4.6)
        above, below = figure.subplots(2, 1, sharex=True)
        handles = []
        for k, (label, history) in enumerate(histories.items()):
            lines: list[Any] = []
            for records in _by_start(history):
                iteration = _counted(records)
                look = _record_look(k, len(records), first=not lines)
                duration = [record.duration for record in records]
                violation = [max(r.violation, LEAST_VIOLATION) for r in records]
                lines += above.plot(iteration, duration, **look)
                below.plot(iteration, violation, **look)
            if lines:
                lines[0].set_label(label)
                handles.append(lines[0])
        above.set_ylabel("$T$ [s]")
        below.set_ylabel("largest violation (scaled)")
        below.set_yscale("log")
        below.set_xlabel("iteration")
        lengths = [len(history) for history in histories.values() if history]
        if max(lengths) > ITERATION_RATIO * min(lengths):
            _spread_first_iterations(below, max(lengths))
        else:
            below.xaxis.get_major_locator().set_params(integer=True)
        add_legend(figure, handles, 4)
        return finish(figure, path)


def curves(trajectory: Trajectory) -> tuple[Array, State]:
    """Sample a motion for drawing, both sides of every jump at a node included.

    The last of the times of an interval is at the same place as the first of the next
    one, with the values before the jump. A motion that takes no time is held for a
    moment.
    """
    intervals = trajectory.t.size - 1
    if not intervals:
        times = np.array([0.0, MOMENT])
        return times, trajectory(times, hold=True)
    share = np.linspace(0.0, 1.0, max(2, CURVE_POINTS // intervals + 1))
    start, end = trajectory.t[:-1, None], trajectory.t[1:, None]
    times = start + share * (end - start)
    # The last instant that still belongs to the interval.
    times[:, -1] = np.nextafter(trajectory.t[1:], -np.inf)
    times[-1, -1] = trajectory.duration
    flat = times.reshape(-1)
    return flat, trajectory(flat)


def _prismatic(robot: Robot) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Which of the joints slide instead of turning, shape (n,)."""
    data = robot.model.createData()
    pin.computeJointJacobians(robot.model, data, robot.expand(np.zeros(robot.n)))
    slides = []
    for name in robot.joint_names:
        joint = robot.model.getJointId(name)
        jacobian = pin.getJointJacobian(
            robot.model, data, joint, pin.ReferenceFrame.LOCAL
        )
        # A matrix of one column comes as a vector.
        turning = jacobian.reshape(6, -1)[3:, robot.model.joints[joint].idx_v]
        slides.append(not turning.any())
    return np.array(slides)


def _unit(quantity: str, prismatic: bool) -> str:
    units = {
        "position": ("rad", "m"),
        "velocity": ("rad/s", "m/s"),
        "torque": ("N m", "N"),
        "force": ("N m", "N"),
    }
    return units[quantity][prismatic]


def _show_limits(panel: Axes, values: Array, lower: float, upper: float) -> None:
    """Draw limits that are near, and name those that are far."""
    low, high = float(values.min()), float(values.max())
    reach = max(abs(low), abs(high), 1e-9)
    drawn = [
        bool(np.isfinite(limit)) and abs(limit) <= FAR_LIMIT * reach
        for limit in (lower, upper)
    ]
    bottom = min(low, lower) if drawn[0] else low
    top = max(high, upper) if drawn[1] else high
    margin = 0.09 * (top - bottom) or 0.1
    panel.set_ylim(bottom - margin, top + margin)
    edges = panel.get_ylim()
    for limit, edge, near in zip((lower, upper), edges, drawn, strict=True):
        if near:
            show_limit(panel, limit, edge)
    text = _far_limits((lower, upper), drawn)
    if text:
        look: dict[str, Any] = {"ha": "right", "va": "bottom", "color": LIMIT_COLOR}
        note(panel, text, (1.0, 1.02), fontsize=6.5, **look)


def _far_limits(limits: tuple[float, float], drawn: Sequence[bool]) -> str:
    """Say in words what limits there are besides those that are drawn."""
    names = ("lower limit", "upper limit")
    far = [
        f"{name} {limit:.3g}"
        for name, limit, near in zip(names, limits, drawn, strict=True)
        if np.isfinite(limit) and not near
    ]
    if len(far) < 2:
        return "".join(far)
    if limits[0] == -limits[1]:
        return f"limits \u00b1{limits[1]:.3g}"
    return f"limits {limits[0]:.3g} and {limits[1]:.3g}"


def _limit_keys() -> list[Any]:
    beyond = area_key("beyond it", facecolor=BEYOND_COLOR)
    return [line_key("limit", **LIMIT_LOOK), beyond]


def _show_segments(
    axes: np.ndarray[Any, np.dtype[np.object_]], trajectory: Trajectory
) -> None:
    """Draw a thin line where a segment ends and another follows."""
    if trajectory.segment_ends is None:
        return
    for panel in axes.reshape(-1):
        for end in trajectory.segment_ends[:-1]:
            panel.axvline(end, color=SEGMENT_COLOR, linewidth=0.6, zorder=0.8)


def _spread_first_iterations(panel: Axes, longest: int) -> None:
    """Linear to 10, then logarithmic."""
    from matplotlib.ticker import FixedLocator, NullLocator, ScalarFormatter

    panel.set_xscale("symlog", linthresh=10.0, linscale=1.0)
    ticks = [0, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000]
    panel.xaxis.set_major_locator(FixedLocator([t for t in ticks if t <= longest]))
    panel.xaxis.set_major_formatter(ScalarFormatter())
    panel.xaxis.set_minor_locator(NullLocator())
    panel.set_xlim(left=-0.4)


def _by_start(history: Sequence[IterationRecord]) -> list[list[IterationRecord]]:
    starts = sorted({record.start for record in history})
    return [[r for r in history if r.start == start] for start in starts]


def _counted(records: Sequence[IterationRecord]) -> list[int]:
    """Iterations of a start, counted on where its numbers begin anew."""
    counts: list[int] = []
    before = last = -1
    for record in records:
        new = record.iteration <= before
        last += 1 if new else record.iteration - before
        before = record.iteration
        counts.append(last)
    return counts


def _record_look(method: int, records: int, first: bool) -> dict[str, Any]:
    return {
        "color": color(method),
        "linestyle": LINE_STYLES[method % len(LINE_STYLES)],
        "marker": MARKERS[method % len(MARKERS)] if records <= 60 else "",
        "markersize": 3.2,
        "alpha": 1.0 if first else 0.45,
        "linewidth": 1.3,
    }
