"""Playback of a motion in Meshcat, as one HTML page that needs no network or server."""

from __future__ import annotations

import base64
import html
import json
import math
import re
import tempfile
import threading
import webbrowser
from collections.abc import Mapping, Sequence
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np

from tominpmp.checks import instance, positive, raised_as, whole
from tominpmp.description.paths import checked_ending, write_file
from tominpmp.exceptions import MissingDependency, OptionsError, counted, warn_caller
from tominpmp.motion.measures import SATURATED
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.viz import meshcat_scene
from tominpmp.viz.shares import SPEED_COLOR, TORQUE_COLOR, Shares, shares_of_limits
from tominpmp.viz.skeleton import check_motions

PAGE_ENDINGS = (".html", ".htm")
# Meshcat's viewer evaluates no strings and loads nothing; the policy makes the browser
# enforce that, whatever the page contains.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; media-src blob:; worker-src blob:"
)
# Longest time for a browser to start and request the page [s].
PATIENCE = 20.0


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
    speeds as shares of their limits; it is one file that needs no network. The fragment
    of its address selects an instant, as in ``motion.html#t=0.5``; ``#t=0.5&still``
    also hides the controls.

    Args:
        problem: The problem, for robot, obstacles and goal.
        trajectory: The motion.
        path: File of the page (.html or .htm); None for a temporary file, which is
            opened in the browser.
        open_browser: Whether to open the temporary file.
        viewer: A ``meshcat.Visualizer`` to show the motion in, instead of a page; for
            notebooks and distant machines.
        rate: Initial speed of the page; 1 is real time. A viewer always plays in real
            time.
        fps: Key frames a second; the viewer interpolates between them.
        ghosts: Number of translucent copies of the robot along the motion.
        frame: Frame whose path is drawn; None for the frame of the goal or the last
            one.
        title: Title of the page; None for the name of the robot and T.
        twins: Other motions of the same robot by their names, shown by pale copies of
            it.

    Returns:
        The path of the page, or the viewer if one was given.

    Raises:
        ProblemError: If the motion is not of the problem's robot, or a title, twins or
            a viewer are of another type, or the ending of the path is not .html or
            .htm.
        FrameNotFound: If the frame is unknown.
        OptionsError: If a number is out of range.
        ScenarioError: If the page cannot be written.
        MissingDependency: If Meshcat is not installed.
    """
    twins = {} if twins is None else twins
    instance(twins, Mapping, "twins", "motions by their names")
    instance(title, (str, NoneType), "title", "a text or None")
    instance(frame, (str, NoneType), "frame", "the name of a frame or None")
    check_motions(problem, (trajectory, *twins.values()))
    with raised_as(OptionsError):
        rate = positive(rate, "rate")
        fps = positive(fps, "fps")
        ghosts = whole(ghosts, "ghosts", 0, 100, "0 to 100")
    if path is not None:
        checked_ending(path, PAGE_ENDINGS, "pages are not written as")
    meshcat = meshcat_scene.import_meshcat()
    if viewer is not None:
        if not hasattr(getattr(viewer, "window", None), "send"):
            instance(viewer, meshcat.Visualizer, "viewer", "a meshcat.Visualizer")
        viewer["/meshcat"].delete()
    recorder = meshcat_scene.Recorder()
    meshcat_scene.draw(
        meshcat.Visualizer(window=recorder if viewer is None else viewer.window),
        problem,
        trajectory,
        fps=fps,
        ghosts=ghosts,
        frame=frame,
        twins=tuple(twins.values()),
    )
    if viewer is not None:
        return viewer
    page = build_page(
        recorder.commands,
        title=title or f"{problem.robot.name}: T = {trajectory.duration:.4g} s",
        caption=_caption(problem, twins),
        rate=rate,
        shares=shares_of_limits(problem, trajectory),
    ).encode("utf-8")
    if path is not None:
        return write_file(path, lambda file: file.write(page))
    with tempfile.NamedTemporaryFile(
        prefix="tominpmp-", suffix=".html", delete=False
    ) as file:
        file.write(page)
    if open_browser and not show_page(page):
        warn_caller(f"no browser could be opened; the page is {file.name}")
    return Path(file.name)


def _caption(problem: Problem, twins: Mapping[str, Trajectory]) -> str:
    counts = {
        "joint": problem.robot.n,
        "segment": len(problem.segments),
        "obstacle": len({item for phase in problem.phases for item in phase.scene}),
    }
    parts = [counted(n, name) for name, n in counts.items() if n]
    parts += [f"pale: {k}, T = {twin.duration:.4g} s" for k, twin in twins.items()]
    return ", ".join(parts)


def build_page(
    commands: Sequence[meshcat_scene.Command],
    *,
    title: str,
    caption: str,
    rate: float,
    shares: Shares,
) -> str:
    """Build the page.

    Args:
        commands: Commands that draw the scene and its animation.
        title: Title of the page, plain text; also shown above the picture.
        caption: Line below the title, plain text.
        rate: Initial speed of the animation; 1 is real time.
        shares: Speeds and torques over their limits, shown next to the picture.

    Raises:
        MissingDependency: If Meshcat is not installed.
    """
    import umsgpack

    packed = map(umsgpack.packb, commands)
    viewer, licences = _viewer()
    template = resources.files(__package__).joinpath("player.html").read_text("utf-8")
    shown = {
        "names": list(shares.joint_names),
        "t": np.round(shares.t, 5).tolist(),
        "torque": np.round(shares.torque.T, 3).tolist(),
        "speed": np.round(shares.speed.T, 3).tolist(),
    }
    fields = {
        "POLICY": POLICY,
        "TITLE": html.escape(title),
        "CAPTION": html.escape(caption),
        "RATE": json.dumps(float(rate)),
        "AT_LIMIT": json.dumps(SATURATED),
        "SPEED_COLOR": SPEED_COLOR,
        "TORQUE_COLOR": TORQUE_COLOR,
        "CONTROL": shares.control,
        # A name with "</script>" or "<!--<script>" must not move the end of the script.
        "SHARES": json.dumps(shown).replace("<", "\\u003c"),
        "SLOPE": json.dumps(math.tan(math.radians(meshcat_scene.FIELD_OF_VIEW / 2))),
        "ASPECT": json.dumps(meshcat_scene.ASPECT),
        "COMMANDS": json.dumps([base64.b64encode(p).decode("ascii") for p in packed]),
        # Inside a comment, which two hyphens would end.
        "LICENCES": licences.replace("--", "- -"),
        "VIEWER": viewer,
    }
    # In one pass, as an inserted text may contain the pattern of a field.
    return re.sub(r"{{(\w+)}}", lambda field: fields[field[1]], template)


@cache
def _viewer() -> tuple[str, str]:
    """Script of Meshcat's viewer, and the licences of its components."""
    folder = Path(meshcat_scene.import_meshcat().viewer_assets_path())
    script = folder / "dist" / "main.min.js"
    if not script.is_file():
        raise MissingDependency("meshcat", "viz", "playback")
    texts = [
        path.read_text("utf-8")
        for path in (folder / "LICENSE", script.with_name(f"{script.name}.LICENSE.txt"))
        if path.is_file()
    ]
    # The script must not end its own element.
    code = script.read_text("utf-8").replace("</script", "<\\/script")
    return code, "\n".join(texts)


def show_page(page: bytes, patience: float = PATIENCE) -> bool:
    """Serve a page to the browser once, over a local address.

    Sandboxed browsers (snap, flatpak) cannot read temporary files, and a server would
    end with the program, so the page is served once and the function waits for it.

    Args:
        page: The page, in HTML and UTF-8.
        patience: Longest time to wait for the browser [s].

    Returns:
        Whether the browser took the page.
    """
    served = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(page)))
            self.end_headers()
            self.wfile.write(page)
            served.set()

        def log_message(self, format: str, *args: object) -> None:
            """Suppress the log of requests."""

    # A thread for each connection: browsers open connections that they never use.
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            opened = webbrowser.open(f"http://127.0.0.1:{server.server_port}/", new=2)
            return opened and served.wait(patience)
        finally:
            server.shutdown()
            thread.join()
