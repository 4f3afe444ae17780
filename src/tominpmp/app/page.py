"""The page: a stage in the middle, the outcome on the left, the request on the right.

On telephones the outcome stands above the request, in the sheet below the stage.
Handles on the stage change the request, too.

All methods may be called from several threads: callbacks of the page, outcomes of the
planning, and the clock that plays the motion.
"""

from __future__ import annotations

import io
import logging
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.app import pictures, stage
from tominpmp.app.controller import Controller
from tominpmp.app.first_request import known
from tominpmp.app.origins import serve
from tominpmp.app.planning import Outcome, ShownMotion, plain_name
from tominpmp.app.request import (
    MODERATE,
    SHAPES,
    UPRIGHT,
    Request,
    RobotChoice,
    follows_datasheet,
    group_names,
    loaded,
    new_item,
    placed,
    resized,
    sizes_of,
)
from tominpmp.description.files import manipulators_first, robot_names
from tominpmp.exceptions import OptionsError, TominpmpError, optional, quiet
from tominpmp.scene.obstacles import Obstacle, Sphere
from tominpmp.viz.surfaces import obstacle_surface, robot_bodies
from tominpmp.viz.surroundings import GOAL_RGB, HAZARD_RGB, START_RGB, VIA_RGB

logger = logging.getLogger(__name__)

FRAMES_PER_SECOND = 30.0
# Updates of the bars per second; their HTML is sent anew each time.
BARS_PER_SECOND = 10.0
GROUND = (205, 210, 220)  # colour of the light from below
# Pause of the animation at both ends of the motion [s].
REST = 0.5
SPEEDS = {"real time": 1.0, "half": 0.5, "a quarter": 0.25, "a tenth": 0.1}
ALL_JOINTS = "all joints"
GOAL_WORDS = {
    "this configuration": "joint",
    "the pose, any configuration": "pose",
    "the position, any orientation": "position",
}
FOLLOWED = "FollowJointTrajectory"
# Files by their labels on the page: ending, time between rows [s], ROS message.
FILES: dict[str, tuple[str, float | None, str | None]] = {
    "CSV, every millisecond": (".csv", 0.001, None),
    "CSV, nodes": (".csv", None, None),
    "NumPy (.npz), every millisecond": (".npz", 0.001, None),
    "ROS 2 JointTrajectory (.yaml), 10 ms": (".yaml", 0.01, None),
    f"ROS 2 {FOLLOWED} (.yaml), 10 ms": (".yaml", 0.01, FOLLOWED),
}
OBSTACLE_LOOK = HAZARD_RGB, 0.72
# Time after its last movement at which a handle counts as released [s].
HOLD = 1.0


def check_port(host: str, port: int) -> None:
    """Check that a page can be served at a port.

    Raises:
        OptionsError: If the port is in use, or cannot be opened on this machine.
    """
    try:
        if not host:
            raise OSError("an empty host would let others on the network open it")
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        socket.create_server((host, port), family=family).close()
    except (OSError, OverflowError) as error:
        raise OptionsError(
            f"port {port} of host {host!r} cannot be used ({error}); try another port "
            "or host",
            "port",
        ) from error


def _by_user(act: Callable[[], Any]) -> Callable[[Any], None]:
    """A callback that acts on changes of a field by a user, not by the program."""

    def changed(event: Any) -> None:
        if event.client is not None:
            act()

    return changed


class Page:
    """The live page.

    Args:
        request: The first request.
        host: Address to serve at.
        port: Port to serve at.

    Raises:
        MissingDependency: If viser is not installed.
        OptionsError: If the port is in use.
        TominpmpError: If the origin of requests cannot be checked.
    """

    def __init__(
        self, request: Request, host: str = "127.0.0.1", port: int = 8080
    ) -> None:
        with optional("viser", "app", "the live page"):
            import viser
        check_port(host, port)
        with redirect_stdout(io.StringIO()):
            # viser prints the address, which the caller prints.
            self.server = serve(viser, host, port)
        name = f"[{host}]" if ":" in host else host
        name = {"127.0.0.1": "localhost"}.get(host, name)
        self.address = f"http://{name}:{self.server.get_port()}"
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._arms: dict[str, stage.Arm] = {}
        self.controller = Controller(request, self._on_outcome)
        gui = self.server.gui
        gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=(37, 99, 235)
        )
        gui.main_panel.dock_left()
        gui.main_panel.set_width(340)
        self.readout = Readout(self.server, self.controller)
        self.panel = Panel(self)
        self.handles = Handles(self)
        self._set_stage()
        self.controller.plan(request)
        threading.Thread(target=self._play, daemon=True).start()

    # -- the request -------------------------------------------------------------------

    @contextmanager
    def _errors_shown(self) -> Iterator[None]:
        """Context manager that shows errors in the user's input as a notice."""
        try:
            yield
        except TominpmpError as error:
            self.readout.notify(str(error), bad=True)
        else:
            self.readout.show_headline()

    def choose(self, choice: RobotChoice) -> None:
        """Request a motion of another robot, and show the robot."""
        self.readout.notify(f"Loading {choice.source} ...")
        with self._errors_shown():
            self.controller.choose(choice)
            self.readout.notify("")
            self._set_stage()
        self.panel.rebuild()

    def ask(self, **changes: Any) -> None:
        """Change fields of the request."""
        with self._errors_shown():
            self.controller.change(**changes)
            self.readout.notify("")
            self.refresh()

    def alter(self, name: str, change: Callable[[Obstacle], Obstacle]) -> None:
        """Change the named obstacle of the request."""
        with self._errors_shown():
            items = self.controller.request.items
            self.ask(items=tuple(change(k) if k.name == name else k for k in items))

    def drag(self, end: str, position: Any, quaternion: Any) -> None:
        """Bring the frame at start or goal to the pose of a handle."""
        with self._errors_shown():
            miss = self.controller.drag(end, position, quaternion)
            message = (
                f"The handle of the {end.removeprefix('q_')} is out of reach by "
                f"{miss}: the nearest configuration was taken."
            )
            self.readout.notify(message if miss else "", bad=bool(miss))
        self.refresh()

    def export(self, ending: str, dt: float | None, message: str | None) -> None:
        """Offer the motion to the browser as a download."""
        with self._errors_shown():
            name, content, remark = self.controller.export(ending, dt, message)
            self.server.send_file_download(name, content)
            self.readout.notify(remark)

    # -- the view ----------------------------------------------------------------------

    def refresh(self) -> None:
        """Show the present request, if its robot is on the stage."""
        request = self.controller.request
        with self._lock:
            if request.robot != self._staged:
                return  # the robot was just chosen: its stage shows the request
            for end in ("q_start", "q_goal"):
                self._arms[end].move(getattr(request, end))
            self.handles.refresh()
            self.panel.refresh_lines()

    def _set_stage(self) -> None:
        """Put the robot of the request on the stage."""
        with self._lock:
            request, scene = self.controller.request, self.server.scene
            robot = loaded(request.robot)
            scene.reset()
            # Lights that a machine without a graphics card can render, too.
            scene.configure_environment_map(None)
            scene.add_light_hemisphere("/sky", ground_color=GROUND, intensity=2.2)
            self.readout.show(None)
            with quiet():  # the page shows none
                bodies = robot_bodies(robot)
            ghost = stage.outlines(robot, bodies)
            self._arms = {
                "q_start": stage.Arm(scene, "/q_start", robot, ghost, START_RGB),
                "q_goal": stage.Arm(scene, "/q_goal", robot, ghost, GOAL_RGB),
                "robot": stage.Arm(scene, "/robot", robot, bodies),
            }
            self._staged = request.robot
            self._arms["robot"].move(request.q_start)
            self._size = stage.look_at(self.server, robot, request)
            self.handles.clear(0.16 * self._size)
            self.panel.rebuild()
            self.refresh()

    def _on_outcome(self, outcome: Outcome) -> None:
        """Show an outcome of the planning."""
        with self._lock:
            if outcome.request.robot != self.controller.request.robot:
                return
            if outcome.shown is not None:
                stage.draw_path(self.server.scene, outcome.shown.path, self._size)
            self.readout.show(outcome)

    def _play(self) -> None:
        """Animate the robot until the page is closed."""
        period, next_bars = 1.0 / FRAMES_PER_SECOND, 0.0
        before = time.monotonic()
        while not self._ended.wait(period):
            shown, passed = self.controller.shown, time.monotonic() - before
            before += passed
            if shown is None:
                continue
            now = self.readout.time(shown, passed)
            try:
                with self._lock:
                    if shown is not self.controller.shown:
                        continue
                    self._arms["robot"].move(shown.q[shown.row(now)])
                    if time.monotonic() >= next_bars:
                        self.readout.bars.content = pictures.bars(shown, now)
                        next_bars = time.monotonic() + 1.0 / BARS_PER_SECOND
            except Exception:  # an error of a client must not end the animation
                logger.exception("a frame could not be shown")

    def close(self) -> None:
        """End serving and planning."""
        self._ended.set()
        self.controller.close()
        with redirect_stdout(io.StringIO()):
            self.server.stop()
        self.panel.uploads.cleanup()

    def wait(self) -> None:
        """Serve until Ctrl-C."""
        try:
            with suppress(KeyboardInterrupt):
                self._ended.wait()
        finally:
            self.close()


class Readout:
    """The left side of the page: T, lower bound, bars, curves and active limits.

    Args:
        server: Viser's server.
        controller: The controller, for the state of the planning.

    Attributes:
        bars: Speeds and torques at the instant that is shown, in HTML.
    """

    def __init__(self, server: Any, controller: Controller) -> None:
        gui, self._controller = server.gui, controller
        self._headline = gui.add_html("")
        self._notice = gui.add_html("")
        self._playing = gui.add_checkbox("Play", True)
        self._speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="half")
        self._slider = gui.add_slider("Time [s]", 0.0, 1.0, 0.005, 0.0)
        self._slider.visible = False
        self.bars = gui.add_html("")
        with gui.add_folder("Over time"):
            self._curves = gui.add_html("")
        with gui.add_folder("What holds it back"):
            self._held = gui.add_html("")
        self._playing.on_update(lambda _: self._pause())
        self.show(None)

    def _pause(self) -> None:
        self._slider.visible = not self._playing.value
        if self._playing.value:
            self._now = float(self._slider.value)
        else:
            self._slider.value = min(max(round(self._now, 3), 0.0), self._slider.max)

    def time(self, shown: ShownMotion, passed: float) -> float:
        """The instant to show [s].

        Args:
            shown: The motion.
            passed: Time since the instant was last asked for [s].
        """
        if not self._playing.value:
            return min(float(self._slider.value), shown.T)
        at = self._now + passed * SPEEDS[self._speed.value]
        self._now = at if at < shown.T + REST else -REST
        return min(max(self._now, 0.0), shown.T)

    def show(self, outcome: Outcome | None) -> None:
        """Show an outcome; None before the first one of a robot."""
        self.show_headline()
        if outcome is None:
            self.bars.content = self._curves.content = self._held.content = ""
            self._now = -REST  # in the animation, whose pauses are before 0 and after T
        elif outcome.shown is not None:
            self._slider.max = latest = round(outcome.shown.T, 3)
            self._slider.value = min(float(self._slider.value), latest)
            self._curves.content = pictures.curves(outcome.shown)
            active, optimality = outcome.shown.active, outcome.shown.optimality
            self._held.content = pictures.active_limits(active, optimality)

    def show_headline(self) -> None:
        """Update the state of the planning next to T."""
        state = self._controller
        self._headline.content = pictures.headline(
            state.outcome, state.busy, goes_on=state.shown is not None
        )

    def notify(self, text: str, *, bad: bool = False) -> None:
        """Show a notice until the next one; an empty text removes it."""
        self._notice.content = pictures.notice(text, bad=bad)


class Panel:
    """The right side of the page: the request, files and lines of Python.

    Args:
        page: The page.

    Attributes:
        uploads: Folder of the URDF files that were opened on the page.
        handles_shown: Checkbox whether handles are shown; the obstacles and balls on
            them stay.
        turning: Checkbox whether the handles of obstacles also turn them.
    """

    def __init__(self, page: Page) -> None:
        self._page, self._gui = page, page.server.gui
        self.uploads = tempfile.TemporaryDirectory(prefix="tominpmp-")
        panel = self._gui.add_panel()
        with panel.add_tab("Task"):
            with self._gui.add_folder("Robot"):
                self._add_robots()
            with self._gui.add_folder("Start and goal"):
                self._add_ends()
            with self._gui.add_folder("Limits"):
                self._add_limits()
            with self._gui.add_folder("Obstacles"):
                self._add_obstacles()
            with self._gui.add_folder("Export"):
                files = self._gui.add_dropdown("File", tuple(FILES))
                button = self._gui.add_button("Download the motion")
                button.on_click(_by_user(lambda: page.export(*FILES[files.value])))
            with self._gui.add_folder("In Python", expand_by_default=False):
                self._lines = self._gui.add_markdown("")
        panel.dock_right()
        panel.set_width(330)

    @property
    def _request(self) -> Request:
        return self._page.controller.request

    def rebuild(self) -> None:
        """Show the fields of another robot."""
        request, source = self._request, self._request.robot.source
        # The robot was loaded; reading its groups or data sheet may still fail.
        with suppress(TominpmpError):
            if source not in self._robots.options:
                self._robots.options = (source, *self._robots.options)
            self._robots.value = source
            self._groups.options = (ALL_JOINTS, *group_names(source))
            self._groups.value = request.robot.group or ALL_JOINTS
            sheet = follows_datasheet(request.robot)
            self._datasheet.visible = sheet is not None
            self._datasheet.value = bool(sheet)
            self._kinematic.value = request.robot.kinematic
            self._sliders["effort_scale"].visible = not request.robot.kinematic
            self._frames.options = loaded(request.robot).frame_names
            self._frames.value = request.frame
            words = {goal: word for word, goal in GOAL_WORDS.items()}
            self._goals.value = words[request.goal]
            for name, slider in self._sliders.items():
                slider.value = getattr(request, name)
            self._bounded.value = request.acceleration is not None
            self._acceleration.visible = self._bounded.value
            self._acceleration.value = request.acceleration or MODERATE
            # Obstacles of two robots may have the same names.
            self._show_sizes()

    def refresh_lines(self) -> None:
        """Show the lines of Python, and the names of the obstacles."""
        self._lines.content = f"```python\n{self._request.python()}```"
        self._fewer.visible = bool(self._request.via)
        names = tuple(item.name for item in self._request.items) or ("none",)
        if tuple(self._items.options) != names:
            self._items.options = names
            self._show_sizes()

    # -- robots ------------------------------------------------------------------------

    def _add_robots(self) -> None:
        gui = self._gui
        names = manipulators_first(robot_names())
        self._robots = gui.add_dropdown("Robot", names)
        self._groups = gui.add_dropdown("Joints", (ALL_JOINTS,))
        self._datasheet = gui.add_checkbox("Maker's data sheet", False)
        self._kinematic = gui.add_checkbox("Kinematic", False)
        upload = gui.add_upload_button(
            "Open a URDF file", mime_type=".urdf,.xml,text/xml"
        )
        self._robots.on_update(_by_user(lambda: self._choose(self._robots.value)))
        for part in (self._groups, self._datasheet, self._kinematic):
            part.on_update(_by_user(self._choose_part))
        upload.on_upload(_by_user(lambda: self._take_file(upload.value)))

    def _choose(self, source: str, **options: Any) -> None:
        """Choose a robot by its name or path, with or without its dynamics."""
        self._page.choose(known(source, kinematic=self._kinematic.value, **options))

    def _choose_part(self) -> None:
        """Choose the same robot with another group of joints or other limits."""
        present = self._request.robot
        options: dict[str, Any] = {"limits": present.limits}
        sheet = bool(self._datasheet.value)
        if sheet != bool(follows_datasheet(present)):
            options["limits"] = "datasheet" if sheet else "urdf"
        if self._groups.value != ALL_JOINTS:
            options |= {"group": self._groups.value, "locked": ()}
        self._choose(present.source, **options)

    def _take_file(self, file: Any) -> None:
        """Choose the robot of an uploaded file."""
        # A folder for each, as robots are told apart by their paths.
        folder = Path(tempfile.mkdtemp(dir=self.uploads.name))
        path = folder / f"{plain_name(Path(file.name).stem)}.urdf"
        path.write_bytes(file.content)
        self._choose(str(path))

    # -- start, goal and via points ----------------------------------------------------

    def _add_ends(self) -> None:
        gui, page = self._gui, self._page
        self._goals = gui.add_dropdown("Goal is", tuple(GOAL_WORDS))
        self._frames = gui.add_dropdown("Frame", ("",))
        gui.add_button("Swap start and goal").on_click(_by_user(self._swap))
        gui.add_button("Add a via point").on_click(_by_user(self._add_point))
        self._fewer = gui.add_button("Remove the last via point")
        self.handles_shown = gui.add_checkbox("Show handles", True)
        self._goals.on_update(
            _by_user(lambda: page.ask(goal=GOAL_WORDS[self._goals.value]))
        )
        self._frames.on_update(_by_user(lambda: page.ask(frame=self._frames.value)))
        self._fewer.on_click(_by_user(lambda: page.ask(via=self._request.via[:-1])))
        self.handles_shown.on_update(_by_user(page.refresh))

    def _swap(self) -> None:
        start, goal = self._request.q_start, self._request.q_goal
        self._page.ask(q_start=goal, q_goal=start, via=self._request.via[::-1])

    def _add_point(self) -> None:
        """Add a via point on the shown path, halfway from the last one to the end."""
        request, shown = self._request, self._page.controller.shown
        line = np.linspace(request.q_start, request.q_goal, 3).tolist()
        path = list(shown.path) if shown else [request.pose(q)[0] for q in line]
        last = request.via[-1] if request.via else path[0]
        passed = int(np.argmin(np.linalg.norm(np.subtract(path, last), axis=1)))
        point = path[(passed + len(path)) // 2]
        self._page.ask(via=(*request.via, tuple(point.tolist())))

    # -- limits ------------------------------------------------------------------------

    def _add_limits(self) -> None:
        gui = self._gui
        self._sliders = {
            "effort_scale": gui.add_slider("Torque [share]", 0.1, 1.0, 0.01, 1.0),
            "speed_scale": gui.add_slider("Speed [share]", 0.1, 1.0, 0.01, 1.0),
            "margin": gui.add_slider("Margin [m]", 0.0, 0.1, 0.005, 0.02),
        }
        self._bounded = gui.add_checkbox("Limit accelerations", False)
        label = "Acceleration [rad/s\N{SUPERSCRIPT TWO}]"
        self._acceleration = gui.add_slider(label, 1.0, 60.0, 0.5, MODERATE)
        for field in (*self._sliders.values(), self._bounded, self._acceleration):
            field.on_update(_by_user(self._change_limits))

    def _change_limits(self) -> None:
        bounded = bool(self._bounded.value)
        self._acceleration.visible = bounded
        values = {name: float(s.value) for name, s in self._sliders.items()}
        limit = float(self._acceleration.value) if bounded else None
        self._page.ask(**values, acceleration=limit)

    # -- obstacles ---------------------------------------------------------------------

    def _add_obstacles(self) -> None:
        gui, page = self._gui, self._page
        kinds = gui.add_button_group("Add", tuple(SHAPES))
        self._items = gui.add_dropdown("Obstacle", ("",))
        self._sizes = [
            gui.add_slider(f"size {number + 1}", 0.01, 2.0, 0.01, 0.1)
            for number in range(3)
        ]
        self.turning = gui.add_checkbox("Turn obstacles", False)
        self._remove = gui.add_button("Remove this obstacle", color="gray")
        kinds.on_click(_by_user(lambda: self._add_item(kinds.value)))
        self._items.on_update(_by_user(self._show_sizes))
        for slider in self._sizes:
            slider.on_update(_by_user(self._resize))
        self._remove.on_click(_by_user(self._remove_item))
        self.turning.on_update(_by_user(page.refresh))

    def _add_item(self, kind: str) -> None:
        items = self._request.items
        taken = tuple(item.name for item in items)
        place = self._request.pose(self._request.q_goal)[0]
        item = new_item(kind, place * [-0.6, 0.6, 1.0], taken)
        self._page.ask(items=(*items, item))
        self._items.value = item.name
        self._show_sizes()

    def _show_sizes(self) -> None:
        """Show the sizes of the chosen obstacle, if there is one."""
        chosen = [k for k in self._request.items if k.name == self._items.value]
        sizes = [size for item in chosen for size in sizes_of(item).items()]
        for number, slider in enumerate(self._sizes):
            slider.visible = number < len(sizes)
            if slider.visible:
                name, slider.value = sizes[number]
                slider.label = f"{name} [m]"
        self._remove.visible = bool(chosen)

    def _resize(self) -> None:
        sizes = [slider.value for slider in self._sizes if slider.visible]
        self._page.alter(self._items.value, partial(resized, sizes=sizes))

    def _remove_item(self) -> None:
        name, items = self._items.value, self._request.items
        self._page.ask(items=tuple(item for item in items if item.name != name))


class Handles:
    """The handles of start, goal, via points and obstacles.

    Args:
        page: The page, whose request the handles follow.
    """

    def __init__(self, page: Page) -> None:
        self._page, self._scene = page, page.server.scene
        self._known: dict[str, tuple[object, Any]] = {}
        self._held: dict[str, float] = {}

    def clear(self, size: float) -> None:
        """Forget all handles, for another robot; new ones have another size [m]."""
        self._size = size
        self._known.clear()

    def refresh(self) -> None:
        """Move handles to the places of the request, except handles being dragged."""
        request, size = self._page.controller.request, self._size
        wanted = ["q_start", "q_goal"]
        for end in wanted:
            pose: tuple[Any, Any] = request.pose(getattr(request, end))
            dragged = partial(self._drag_end, end)
            self._put(end, pose, dragged, size, request.turns)
        for number, point in enumerate(request.via):
            wanted.append(f"via{number}")
            ball = Sphere("point", radius=0.12 * size)
            dragged = partial(self._drag_via, number)
            pose, look = (point, UPRIGHT), (VIA_RGB, 1.0)
            self._put(wanted[-1], pose, dragged, 0.7 * size, False, ball, look)
        for item in request.items:
            wanted.append(f"item_{item.name}")
            dragged = partial(self._drag_item, item.name)
            pose = item.position, pin.Quaternion(np.array(item.rotation)).coeffs()
            turns = self._page.panel.turning.value
            self._put(wanted[-1], pose, dragged, 0.9 * size, turns, item)
        for key in set(self._known) - set(wanted):
            self._known.pop(key)[1].remove()

    def _put(
        self,
        key: str,
        pose: tuple[Any, Any],
        dragged: Callable[[Any], None],
        scale: float,
        turns: bool,
        body: Obstacle | None = None,
        look: tuple[stage.Color, float] = OBSTACLE_LOOK,
    ) -> None:
        """Put a handle on the stage.

        Args:
            key: Name of the handle.
            pose: Its position [m], shape (3,), and orientation (x, y, z, w).
            dragged: Called with the handle of viser when a user drags it.
            scale: Its size [m].
            turns: Whether it can be turned.
            body: Obstacle that is drawn with the handle; None for a handle alone.
            look: Colour and opacity of the body.
        """
        axes = self._page.panel.handles_shown.value
        rings = axes and turns
        shape = body and replace(body, position=np.zeros(3), rotation=np.eye(3))
        kind = scale, axes, rings, shape
        if key in self._known and self._known[key][0] != kind:
            self._known.pop(key)[1].remove()
        if key not in self._known:
            node = self._scene.add_transform_controls(
                f"/handles/{key}",
                scale=scale,
                disable_axes=not axes,
                disable_rotations=not rings,
                disable_sliders=True,
                depth_test=False,
                **({"line_width": 3.0} if body is None else {}),
            )
            if body is not None:
                surface, path = obstacle_surface(body), node.name
                stage.put_surface(self._scene, f"{path}/body", surface, *look)
            node.on_update(partial(self._moved, key, dragged))
            self._known[key] = kind, node
        if self._held.get(key, 0.0) <= time.monotonic():
            position, (x, y, z, w) = pose
            node = self._known[key][1]
            node.position, node.wxyz = np.asarray(position), np.array([w, x, y, z])

    def _moved(self, key: str, dragged: Callable[[Any], None], event: Any) -> None:
        """Process a drag event; the program does not move a handle while it is held.

        Events may arrive out of order, with the end of a drag not the last one, so that
        a handle is also free some time after its last movement.
        """
        held = 0.0 if event.phase == "end" else HOLD
        self._held[key] = time.monotonic() + held
        dragged(event.target)

    def _drag_end(self, end: str, node: Any) -> None:
        self._page.drag(end, np.array(node.position), node.wxyz[[1, 2, 3, 0]])

    def _drag_via(self, number: int, node: Any) -> None:
        points = list(self._page.controller.request.via)
        if number < len(points):
            points[number] = tuple(node.position)
            self._page.ask(via=tuple(points))

    def _drag_item(self, name: str, node: Any) -> None:
        pose = {"position": node.position, "quaternion": node.wxyz[[1, 2, 3, 0]]}
        self._page.alter(name, partial(placed, **pose))
