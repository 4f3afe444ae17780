"""Playback of a motion in Meshcat, the viewer in the browser."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import NoneType
from typing import Any

from tominpmp.checks import instance, positive, whole
from tominpmp.description.paths import checked_ending
from tominpmp.exceptions import OptionsError, warn_caller
from tominpmp.files.writing import write_file
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem import Problem
from tominpmp.viz.meshcat_scene import Appearance, draw
from tominpmp.viz.page import build_page, show_page
from tominpmp.viz.shares import shares_of_limits
from tominpmp.viz.skeleton import check_motion
from tominpmp.viz.viewer import Recorder, import_meshcat

PAGE_ENDINGS = (".html", ".htm")


def play(
    problem: Problem,
    trajectory: Trajectory,
    *,
    path: str | Path | None = None,
    open_browser: bool = True,
    viewer: Any = None,
    rate: float = 1.0,
    fps: float = 60.0,
    ghosts: int = 0,
    frame: str | None = None,
    title: str | None = None,
    twins: Mapping[str, Trajectory] | None = None,
) -> Any:
    """Show a motion in Meshcat: robot, obstacles, goal, and the path of the end.

    The page plays in real time, with pause, slider and speed, and shows torques and
    speeds as shares of their limits; it is one file that needs no network. Its address
    takes an instant to show, as in ``motion.html#t=0.5``; ``#t=0.5&still`` leaves out
    what can be clicked.

    Args:
        problem: The problem, for robot, obstacles and goal.
        trajectory: The motion.
        path: Where to write the page (.html or .htm). Without it a temporary file is
            written and opened in the browser.
        open_browser: Whether to open it, if there is no path.
        viewer: A ``meshcat.Visualizer`` to show the motion in, instead of a page; for
            notebooks and distant machines.
        rate: Speed at which the page plays first; 1 is real time. A viewer always plays
            in real time.
        fps: Key frames a second; the viewer interpolates between them.
        ghosts: Number of translucent copies of the robot along the motion.
        frame: Frame whose path is drawn; None for that of the goal, else the last.
        title: Title of the page; None for the robot and T.
        twins: Other motions of the same robot by their names, which pale copies of it
            make beside it.

    Returns:
        The path of the page, or the viewer if one was given.

    Raises:
        ProblemError: If the motion is not one of the problem's robot, or a title, twins
            or a viewer are of another type, or the ending of the path is no page's.
        FrameNotFound: If there is no such frame.
        OptionsError: If a number is out of range.
        ScenarioError: If the page cannot be written.
        MissingDependency: If Meshcat is not installed.
    """
    twins = {} if twins is None else twins
    instance(twins, Mapping, "twins", "motions by their names")
    instance(title, (str, NoneType), "title", "a text or None")
    instance(frame, (str, NoneType), "frame", "the name of a frame or None")
    for motion in (trajectory, *twins.values()):
        check_motion(problem, motion)
    rate = positive(rate, "rate", error=OptionsError)
    fps = positive(fps, "fps", error=OptionsError)
    if path is not None:
        checked_ending(path, PAGE_ENDINGS, "pages are not written as")
    ghosts = whole(ghosts, "ghosts", 0, 100, "0 to 100", error=OptionsError)
    appearance = Appearance(fps, ghosts, frame, tuple(twins.values()))
    meshcat = import_meshcat()
    if viewer is not None:
        if not hasattr(getattr(viewer, "window", None), "send"):
            instance(viewer, meshcat.Visualizer, "viewer", "a meshcat.Visualizer")
        viewer["/meshcat"].delete()
        draw(meshcat.Visualizer(window=viewer.window), problem, trajectory, appearance)
        return viewer
    recorder = Recorder()
    draw(meshcat.Visualizer(window=recorder), problem, trajectory, appearance)
    name = problem.robot.name
    page = build_page(
        recorder.commands,
        title=title or f"{name}: T = {trajectory.duration:.4g} s",
        caption=_caption(problem, twins),
        rate=rate,
        shares=shares_of_limits(problem, trajectory),
    ).encode("utf-8")
    if path is not None:
        return write_file(path, lambda file: file.write(page))
    handle, temporary = tempfile.mkstemp(prefix="tominpmp-", suffix=".html")
    with os.fdopen(handle, "wb") as file:
        file.write(page)
    if open_browser and not show_page(page):
        warn_caller(f"no browser could be opened; the page is {temporary}")
    return Path(temporary)


def _caption(problem: Problem, twins: Mapping[str, Trajectory]) -> str:
    joints, obstacles = problem.robot.n, len(problem.scene)
    parts = ["1 joint" if joints == 1 else f"{joints} joints"]
    if problem.segments:
        parts.append(f"{len(problem.segments)} segments")
    if obstacles:
        parts.append("1 obstacle" if obstacles == 1 else f"{obstacles} obstacles")
    for name, motion in twins.items():
        parts.append(f"pale: {name}, T = {motion.duration:.4g} s")
    return ", ".join(parts)
