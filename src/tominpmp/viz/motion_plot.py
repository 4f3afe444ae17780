"""Stroboscopic pictures of motions, projected onto a plane."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from trimesh import transform_points

from tominpmp.arrays import Array
from tominpmp.checks import instance, whole
from tominpmp.kinematics import FrameMotions
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.scene.obstacles import Sphere
from tominpmp.viz import figures, surroundings
from tominpmp.viz.skeleton import (
    Skeleton,
    View,
    best_view,
    check_motions,
    end_frame,
    skeleton,
)
from tominpmp.viz.surfaces import obstacle_surface

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

INSTANTS = 15
PANELS_IN_ROW = 3
# Width of a panel by the number of panels in a row [in].
WIDTHS = {1: 5.6, 2: 4.2, 3: 3.4}
ARM_COLOR = "#12375f"
# Colours of the arms of a workcell; the first arm has the colour of a single arm.
ARM_COLORS = (ARM_COLOR, "#8a5208", "#1d6b45", "#6a3d8f")
LOAD_RGB = (0.659, 0.455, 0.173)
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

    A planar motion is drawn in its plane, any other is projected onto the coordinate
    plane in which its area is largest. Obstacles are outlines, the goal is a cross, and
    a line follows the end of the arm. Moving obstacles and loads are drawn at the same
    instants as the arm.

    Args:
        problem: The problem, for robot, obstacles and goal.
        trajectories: The motions by label.
        path: File to write (PNG, PDF or SVG by its ending), if any.
        instants: Number of instants, evenly spaced in time.
        frame: Frame at the end; None for the frame of the goal or the last one.

    Returns:
        The figure: one panel for each motion, all to the same scale.

    Raises:
        ProblemError: If there is no motion, a motion is not of the problem's robot, or
            the ending of the path is unknown.
        FrameNotFound: If the frame is unknown.
        ScenarioError: If the file cannot be written.
        MissingDependency: If matplotlib is not installed.
    """
    check_motions(problem, trajectories.values())
    instance(frame, (str, NoneType), "frame", "the name of a frame or None")
    instants = whole(instants, "instants", least=2, expected="2 or more")
    frame = frame or end_frame(problem)
    motions = list(trajectories.values())
    shown = [np.linspace(0.0, motion.duration, instants) for motion in motions]
    poses = [
        skeleton(problem.robot, motion(times).q, frame)
        for motion, times in zip(motions, shown, strict=True)
    ]
    # One view for all motions, so that they can be compared.
    view = best_view(np.concatenate([pose.points for pose in poses]))
    goal = _goal_point(problem, frame)
    with figures.styled():
        figure, axes = _panels(len(poses), view)
        for panel, (label, motion), times, pose in zip(
            axes, trajectories.items(), shown, poses, strict=True
        ):
            _draw_arm(panel, view, pose)
            trail, ends = surroundings.drawn_path(problem, motion, frame)
            look: dict[str, Any] = {"color": figures.color(1), "zorder": 2.4, "lw": 1.1}
            panel.plot(*view.project(trail).T, label="path of the end", **look)
            if ends.size:
                look = {"color": "#404b5c", "zorder": 2.6, "markersize": 4.0}
                panel.plot(*view.project(ends).T, "o", label="end of a segment", **look)
            if goal is not None:
                look = {"color": figures.GOAL_COLOR, "zorder": 3.0, "ms": 8.0}
                panel.plot(*view.project(goal), "x", mew=2.0, label="goal", **look)
            for item in surroundings.scene_items(problem, motion, times):
                _draw_item(panel, view, item)
            panel.set_title(f"{label}: T = {motion.duration:.4g} s")
        _fit(figure)
        figures.add_legend(figure, 5)
        # Windows are widened to the aspect ratios that the layout gives their panels;
        # around panels that shrink the layout leaves too little room for labels.
        figure.draw_without_rendering()
        for panel in axes:
            panel.set_aspect("equal", adjustable="datalim")
        return figures.finish(figure, path)


def _draw_item(panel: Axes, view: View, item: surroundings.SceneItem) -> None:
    """Draw outlines of an obstacle or a load; if it moves, where it is present."""
    from matplotlib.patches import Circle, Polygon

    kind, edge = "load", LOAD_RGB
    if item.load is None:
        kind, edge = "obstacle", surroundings.obstacle_color(item.shape)
    look: dict[str, Any] = {"facecolor": (*edge, 0.25), "edgecolor": edge}
    surface = obstacle_surface(item.shape)
    shades: list[float | None] = [None]
    if item.moves:
        shades = np.linspace(LIGHTEST, 1.0, item.present.size).tolist()
        look["facecolor"] = "none"
    for k, shade in enumerate(shades):
        if item.moves and not item.present[k]:
            continue
        place = item.placements[k]
        points = view.project(transform_points(surface.vertices, place))
        label = kind if shade in (None, 1.0) else None
        look |= {"alpha": shade, "zorder": 1.5, "label": label}
        outline: Patch = Polygon(_hull(points), **look)
        if isinstance(item.shape, Sphere):
            x, y = view.project(place[:3, 3]).tolist()
            outline = Circle((x, y), item.shape.radius, **look)
        panel.add_patch(outline)


def _hull(points: Array) -> Array:
    """Corners of the convex hull of points in a plane, shape (k, 2)."""
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # they lie on a line: a flat body is seen from its edge
        order = np.lexsort(points.T)
        return np.asarray(points[order[[0, -1]]])


def _goal_point(problem: Problem, frame: str) -> Array | None:
    """Final position of the end frame, shape (3,) [m]; None if it is not fixed."""
    goal = problem.goal
    if goal.configuration is not None:
        frames = FrameMotions(problem.robot, frame)
        return np.asarray(frames.placements(goal.configuration[None]).origin[0])
    target = goal.target
    if target is None or isinstance(target, np.ndarray):
        return target
    return np.array(target.translation)


def _panels(count: int, view: View) -> tuple[Figure, list[Axes]]:
    """Panels side by side, in rows of three.

    The panels in the left column, and the lowest of each column, are labelled.
    """
    wide = min(count, PANELS_IN_ROW)
    figure = figures.new_figure(0.5 + WIDTHS[wide] * wide, 1.0)
    axes = [figure.add_subplot(-(-count // wide), wide, 1 + i) for i in range(count)]
    for i, panel in enumerate(axes):
        left, lowest = i % wide == 0, i + wide >= count
        panel.tick_params(labelleft=left, labelbottom=lowest)
        panel.set_ylabel(f"{view.labels[1]} [m]" * left)
        panel.set_xlabel(f"{view.labels[0]} [m]" * lowest)
    return figure, axes


def _fit(figure: Figure) -> None:
    """Give all panels one window, and the figure the height that its extents need."""
    from matplotlib.transforms import Bbox

    low, high = Bbox.union([panel.dataLim for panel in figure.axes]).get_points()
    margin = 0.05 * float((high - low).max()) or 0.1
    # A motion along a line still needs a panel with some height.
    least = 0.25 * float((high - low).max())
    spare = margin + np.maximum(0.0, least - (high - low)) / 2
    low, high = low - spare, high + spare
    for panel in figure.axes:
        panel.margins(0.0)
        panel.update_datalim([low, high])
    wide = min(len(figure.axes), PANELS_IN_ROW)
    inside = WIDTHS[wide] - 0.45  # without the labels of the axis
    height = inside * (high - low)[1] / (high - low)[0]
    height = float(np.clip(height, 1.6, 1.6 * WIDTHS[wide]))
    figure.set_figheight(0.75 + -(-len(figure.axes) // wide) * (height + 0.6))


def _draw_arm(panel: Axes, view: View, pose: Skeleton) -> None:
    shades = np.linspace(LIGHTEST, 1.0, len(pose.placements))
    # In the legend the line of the first instant would be too light.
    labels = {len(shades) // 4: "start", len(shades) - 1: "end"}
    for chain, arm in zip(pose.chains, pose.arms, strict=True):
        for i, joints in enumerate(view.project(chain)):
            last = i == len(pose.placements) - 1
            panel.plot(
                *joints.T,
                color=ARM_COLORS[arm % len(ARM_COLORS)],
                alpha=float(shades[i]),
                linewidth=2.0 if last else 1.2,
                marker="o",
                markersize=3.4 if last else 2.2,
                markeredgewidth=0.0,
                zorder=2.0 + 0.01 * i,
                label=labels.get(i),
            )
