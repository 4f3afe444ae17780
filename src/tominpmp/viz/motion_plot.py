"""Stroboscopic pictures of motions in their plane."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.checks import instance, whole
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem import Problem
from tominpmp.scene import Obstacle, Sphere
from tominpmp.viz.figures import (
    GOAL_COLOR,
    add_legend,
    area_key,
    color,
    finish,
    line_key,
    new_figure,
    styled,
)
from tominpmp.viz.roles import HAZARD_COLOR, obstacle_color
from tominpmp.viz.segments import ends_on_the_way, loads, obstacles, there
from tominpmp.viz.skeleton import (
    Skeleton,
    View,
    best_view,
    check_motions,
    end_frame,
    skeleton,
)
from tominpmp.viz.surfaces import moved, obstacle_placement, obstacle_surface

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INSTANTS = 15
PATH_POINTS = 300
PANELS_IN_ROW = 3
ARM_COLOR = "#12375f"
# Of several robots, the first one as if it were alone.
ARM_COLORS = (ARM_COLOR, "#8a5208", "#1d6b45", "#6a3d8f")
LOAD_COLOR, END_COLOR = "#a8742c", "#404b5c"
END_LOOK: dict[str, Any] = {
    "color": END_COLOR,
    "marker": "o",
    "markersize": 4.0,
    "linestyle": "none",
}
GOAL_LOOK: dict[str, Any] = {
    "color": GOAL_COLOR,
    "marker": "x",
    "markersize": 8.0,
    "markeredgewidth": 2.0,
    "linestyle": "none",
}
LIGHTEST = 0.16  # opacity of the first instant; the last one is solid


def plot_motion(
    problem: Problem,
    trajectories: Mapping[str, Trajectory],
    path: str | Path | None = None,
    *,
    instants: int = INSTANTS,
    frame: str | None = None,
) -> Figure:
    """Plot the arm at several instants, from light to dark, side by side by label.

    A planar motion is drawn in its plane, any other projected onto the coordinate plane
    in which it takes most room. Obstacles are outlines, the goal is a cross, and a line
    follows the end of the arm. What moves is drawn at the same instants as the arm.

    Args:
        problem: The problem, for robot, obstacles and goal.
        trajectories: The motions by label.
        path: File to write (PNG, PDF or SVG by its ending), if any.
        instants: Number of instants, evenly spaced in time.
        frame: Frame at the end; None for that of the goal, else the last.

    Returns:
        The figure: one panel a motion, all to one scale.

    Raises:
        ProblemError: If there is no motion, one is not of the problem's robot, or the
            ending of the path is unknown.
        FrameNotFound: If there is no such frame.
        ScenarioError: If the file cannot be written.
        MissingDependency: If matplotlib is not installed.
    """
    check_motions(problem, trajectories)
    instance(frame, (str, NoneType), "frame", "the name of a frame or None")
    instants = whole(instants, "instants", least=2, expected="2 or more")
    motions = list(trajectories.values())
    frame = frame or end_frame(problem)
    poses = [
        skeleton(problem.robot, item(_instants(item, instants)).q, frame)
        for item in motions
    ]
    # One view for all motions, so that they can be compared.
    view = best_view(np.concatenate([pose.points for pose in poses]))
    first = motions[0]
    resting = [one for _, one, _ in obstacles(problem, first) if one.motion is None]
    outlines = [(_outline(item, view), obstacle_color(item)) for item in resting]
    passing, carried = (
        [draw(problem, item, view, _instants(item, instants)) for item in motions]
        for draw in (_passing, _carried)
    )
    goal = _goal_point(problem, frame)
    with styled():
        everything = [item for item, _ in outlines]
        everything += itertools.chain(*passing, *carried)
        low, high = _window(view, poses, everything, goal)
        figure, axes = _panels(len(trajectories), high - low)
        for panel, (label, trajectory), pose, part, load in zip(
            axes, trajectories.items(), poses, passing, carried, strict=True
        ):
            for outline, shown in outlines:
                _draw_outline(panel, outline, shown)
            for some, edge in ((part, HAZARD_COLOR), (load, LOAD_COLOR)):
                shades = np.linspace(LIGHTEST, 1.0, max(len(some), 1)).tolist()
                for outline, shade in zip(some, shades, strict=False):
                    _draw_outline(panel, outline, edge, shade)
            _draw_arm(panel, view, pose)
            times = _instants(trajectory, PATH_POINTS)
            end = skeleton(problem.robot, trajectory(times).q, frame).end
            panel.plot(*view.project(end).T, color=color(1), linewidth=1.1, zorder=2.4)
            _draw_ends(panel, view, problem, trajectory, frame)
            if goal is not None:
                panel.plot(*view.project(goal), **GOAL_LOOK, zorder=3.0)
            panel.set_title(f"{label}: $T$ = {trajectory.duration:.4g} s", loc="left")
            panel.set_aspect("equal")
            panel.set_xlim(low[0], high[0])
            panel.set_ylim(low[1], high[1])
        _label_axes(axes, view)
        shown_colors = {shown for _, shown in outlines}
        if any(passing):
            shown_colors.add(HAZARD_COLOR)
        add_legend(figure, _handles(shown_colors, carried, first), 5)
        return finish(figure, path)


def _instants(trajectory: Trajectory, count: int) -> Array:
    return np.linspace(0.0, trajectory.duration, count)


def _outline(obstacle: Obstacle, view: View) -> Array | tuple[Array, float]:
    """Outline of an obstacle: the points of a polygon, or a centre and a radius."""
    if isinstance(obstacle, Sphere):
        return view.project(obstacle.position), obstacle.radius
    from scipy.spatial import ConvexHull

    body = moved(obstacle_surface(obstacle), obstacle_placement(obstacle))
    points = view.project(body.vertices)
    return np.asarray(points[ConvexHull(points).vertices])


def _passing(
    problem: Problem, trajectory: Trajectory, view: View, times: Array
) -> list[Array | tuple[Array, float]]:
    """Outlines of what moves, at instants at which it is there."""
    moving = [
        one for one in obstacles(problem, trajectory) if one[1].motion is not None
    ]
    return [
        _outline(obstacle.frozen(time), view)
        for time in times.tolist()
        for _, obstacle, spans in moving
        if there(spans, np.array([time]))[0]
    ]


def _carried(
    problem: Problem, trajectory: Trajectory, view: View, times: Array
) -> list[Array | tuple[Array, float]]:
    """Outlines of loads at instants, wherever they are then."""
    every = loads(problem, trajectory, times)
    return [
        _placed(shape, load.placements[k], view)
        for k in range(times.size)
        for load in every
        for shape in load.shapes
    ]


def _placed(shape: Obstacle, place: Array, view: View) -> Array | tuple[Array, float]:
    """Outline of a shape of something that is placed somewhere."""
    whole = place @ obstacle_placement(shape)
    moved_there = replace(shape, position=whole[:3, 3], rotation=whole[:3, :3])
    return _outline(moved_there, view)


def _draw_ends(
    panel: Axes, view: View, problem: Problem, trajectory: Trajectory, frame: str
) -> None:
    """A dot where each segment ends that another follows."""
    times = ends_on_the_way(trajectory)
    if times.size:
        points = skeleton(problem.robot, trajectory(times).q, frame).end
        panel.plot(*view.project(points).T, **END_LOOK, zorder=2.6)


def _goal_point(problem: Problem, frame: str) -> Array | None:
    """Where the end frame is to arrive, shape (3,), if that is known."""
    goal = problem.goal
    if goal.configuration is not None:
        ends = skeleton(problem.robot, goal.configuration[None], frame).end
        return np.asarray(ends[0])
    target = goal.target
    if target is None or isinstance(target, np.ndarray):
        return target
    return np.array(target.translation)


def _window(
    view: View,
    poses: list[Skeleton],
    outlines: list[Array | tuple[Array, float]],
    goal: Array | None,
) -> tuple[Array, Array]:
    """Lowest and highest coordinates to show, shapes (2,)."""
    points = [view.project(pose.points).reshape(-1, 2) for pose in poses]
    for outline in outlines:
        if isinstance(outline, tuple):
            center, radius = outline
            points.append(np.stack([center - radius, center + radius]))
        else:
            points.append(outline)
    if goal is not None:
        points.append(view.project(goal)[None])
    everything = np.concatenate(points)
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.05 * float((high - low).max()) or 0.1
    # A motion along a line still needs a panel with some height.
    least = 0.25 * float((high - low).max())
    spare = np.maximum(0.0, least - (high - low)) / 2
    return low - margin - spare, high + margin + spare


def _label_axes(axes: list[Axes], view: View) -> None:
    """Label the panels at the left and those with none below."""
    wide = min(len(axes), PANELS_IN_ROW)
    for i, panel in enumerate(axes):
        if i % wide == 0:
            panel.set_ylabel(f"{view.labels[1]} [m]")
        if i + wide >= len(axes):
            panel.tick_params(labelbottom=True)
            panel.set_xlabel(f"{view.labels[0]} [m]")


def _panels(count: int, extent: Array) -> tuple[Figure, list[Axes]]:
    """Panels side by side, in rows of three, each of the shape of what it shows."""
    wide = min(count, PANELS_IN_ROW)
    rows = -(-count // wide)
    width = {1: 5.6, 2: 4.2, 3: 3.4}[wide]
    inside = width - 0.45  # beside the labels of the axis
    height = float(np.clip(inside * extent[1] / extent[0], 1.6, 1.6 * width))
    figure = new_figure(0.5 + width * wide, 0.75 + rows * (height + 0.6))
    axes = figure.subplots(rows, wide, sharex=True, sharey=True, squeeze=False)
    flat = list(axes.reshape(-1))
    for extra in flat[count:]:
        extra.set_axis_off()
    return figure, flat[:count]


def _draw_outline(
    panel: Axes,
    outline: Array | tuple[Array, float],
    shown: str,
    shade: float | None = None,
) -> None:
    """Draw an outline; a shade is that of what moves, at one instant."""
    from matplotlib.patches import Circle, Patch, Polygon

    look = _obstacle_look(shown)
    if shade is not None:
        look |= {"facecolor": "none", "alpha": shade}
    shape: Patch
    if isinstance(outline, tuple):
        center, radius = outline
        shape = Circle((float(center[0]), float(center[1])), radius, **look)
    else:
        shape = Polygon(outline, closed=True, **look)
    shape.set_zorder(1.5)
    panel.add_patch(shape)


def _obstacle_look(shown: str) -> dict[str, Any]:
    return {"facecolor": shown + "40", "edgecolor": shown}


def _draw_arm(panel: Axes, view: View, pose: Skeleton) -> None:
    shades = np.linspace(LIGHTEST, 1.0, len(pose.end))
    for chain, arm in zip(pose.chains, pose.arms, strict=True):
        for i, joints in enumerate(view.project(chain)):
            last = i == len(pose.end) - 1
            panel.plot(
                *joints.T,
                color=ARM_COLORS[arm % len(ARM_COLORS)],
                alpha=float(shades[i]),
                linewidth=2.0 if last else 1.2,
                marker="o",
                markersize=3.4 if last else 2.2,
                markeredgewidth=0.0,
                zorder=2.0 + 0.01 * i,
            )


def _handles(
    shown: set[str], carried: list[list[Any]], trajectory: Trajectory
) -> list[Any]:
    handles = [
        line_key("start", color=ARM_COLOR, alpha=0.35, linewidth=1.2),
        line_key("end", color=ARM_COLOR, linewidth=2.0),
        line_key("path of the end", color=color(1), linewidth=1.1),
        line_key("goal", **GOAL_LOOK),
    ]
    if ends_on_the_way(trajectory).size:
        handles.append(line_key("end of a segment", **END_LOOK))
    if shown:
        look = _obstacle_look(max(shown, key=lambda one: one == HAZARD_COLOR))
        handles.append(area_key("obstacle", **look))
    if any(carried):
        handles.append(area_key("load", facecolor="none", edgecolor=LOAD_COLOR))
    return handles
