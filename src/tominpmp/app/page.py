"""The page: a stage in the middle, what was found on the left, what is asked for right.

It holds viser's server and the controller, and lets the parts of the page speak with
each other. Everything in it may be called from several threads: callbacks of the page,
outcomes of the planning, and the clock that plays.
"""

from __future__ import annotations

import io
import logging
import socket
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import Any

from tominpmp.app.choice import RobotChoice, loaded
from tominpmp.app.controller import Controller
from tominpmp.app.handles import Handles
from tominpmp.app.origins import serve
from tominpmp.app.outcome import Outcome, Shown
from tominpmp.app.panel import Panel
from tominpmp.app.readout import Readout
from tominpmp.app.request import Request
from tominpmp.app.stage import (
    GHOST_OPACITY,
    Arm,
    draw_path,
    look_at,
    outlines,
    size_of,
)
from tominpmp.exceptions import OptionsError, TominpmpError, optional
from tominpmp.viz.bodies import robot_bodies
from tominpmp.viz.roles import GOAL_RGB, START_RGB

logger = logging.getLogger(__name__)

FRAMES_PER_SECOND = 30.0
# Bars change so often a second; their text is sent anew each time.
BARS_PER_SECOND = 10.0
GROUND = (205, 210, 220)  # what light from below looks like
# The arm rests so long at both ends before it plays again [s].
REST = 0.5


def import_viser() -> Any:
    """Import viser when it is needed.

    Raises:
        MissingDependency: If it is not installed.
    """
    with optional("viser", "app", "the live page"):
        import viser
    return viser


def check_port(host: str, port: int) -> None:
    """Check that a page can be served at a port.

    Raises:
        OptionsError: If it is taken, or no port of this machine.
    """
    try:
        with socket.socket() as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind((host, port))
    except (OSError, OverflowError) as error:
        raise OptionsError(
            f"port {port} of {host} cannot be used ({error}); choose another one",
            "port",
        ) from error


class Page:
    """The live page.

    Args:
        request: What is asked for first.
        host: Address to serve at.
        port: Port to serve at.

    Raises:
        MissingDependency: If viser is not installed.
        OptionsError: If the port is taken.
        TominpmpError: If the robot cannot be loaded, or no visitor could be refused.
    """

    def __init__(
        self, request: Request, host: str = "127.0.0.1", port: int = 8080
    ) -> None:
        viser = import_viser()
        loaded(request.robot)
        check_port(host, port)
        with redirect_stdout(io.StringIO()):
            # It says where it listens, which the caller does.
            self.server = serve(viser, host, port)
        self.address = f"http://{'localhost' if host == '127.0.0.1' else host}:{port}"
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._begun = time.monotonic()
        self._arms: dict[str, Arm] = {}
        self._shown: Shown | None = None
        self._size = 1.0
        self.controller = Controller(request, self._found)
        self._dress()
        self.readout = Readout(self.server)
        self.panel = Panel(self.server, self)
        self.handles = Handles(self.server.scene, self)
        self._set_stage()
        self.controller.start()
        self._clock = threading.Thread(target=self._play, daemon=True)
        self._clock.start()

    def _dress(self) -> None:
        gui, scene = self.server.gui, self.server.scene
        gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=(37, 99, 235)
        )
        gui.main_panel.dock_right()
        gui.main_panel.set_width(330)
        scene.world_axes.visible = False
        # Lights that a machine without a graphics card can compute, too.
        scene.configure_environment_map(None)
        scene.add_light_hemisphere(
            "/sky",
            sky_color=(255, 255, 255),
            ground_color=(205, 210, 220),
            intensity=2.2,
        )
        scene.configure_default_lights(True, cast_shadow=True)

    # -- what is asked for -------------------------------------------------------------

    def attempt(self, act: Callable[[], Any]) -> bool:
        """Do what the user asked for; what is wrong with it becomes a notice.

        Returns:
            Whether it was done.
        """
        try:
            act()
        except TominpmpError as error:
            self.readout.tell(str(error), bad=True)
            return False
        self.readout.busy(self.controller)
        return True

    def choose(self, choice: RobotChoice) -> None:
        """Take another robot."""
        self.readout.tell(f"Loading {choice.source} ...")

        def act() -> None:
            self.controller.choose(choice)
            self.readout.tell("")
            self._set_stage()

        if not self.attempt(act):
            self.panel.rebuild()

    def ask(self, **changes: Any) -> bool:
        """Ask for the same with some fields of the request changed."""
        done = self.attempt(lambda: self.controller.change(**changes))
        if done:
            self.readout.tell("")
            self.refresh()
        return done

    def drag(self, end: str, position: Any, quaternion: Any) -> None:
        """Bring the frame at start or goal to a handle."""

        def act() -> None:
            miss = self.controller.drag(end, position, quaternion)
            name = "start" if end == "q_start" else "goal"
            self.readout.tell(
                f"The handle of the {name} is out of reach by {miss:.3f} (m, rad): the "
                "nearest configuration was taken."
                if miss
                else "",
                bad=bool(miss),
            )
            self._arms[end].move(getattr(self.controller.request, end))

        with self._lock:
            self.attempt(act)
        self.panel.refresh_lines()

    # -- what is seen ------------------------------------------------------------------

    def refresh(self) -> None:
        """Show what is asked for as it is now."""
        request = self.controller.request
        with self._lock:
            for end in ("q_start", "q_goal"):
                self._arms[end].move(getattr(request, end))
            self.handles.refresh()
            self.panel.refresh_lines()

    def _set_stage(self) -> None:
        """Put the robot that is asked for on the stage."""
        request = self.controller.request
        robot = loaded(request.robot)
        with self._lock:
            for arm in self._arms.values():
                arm.remove()
            self.server.scene.remove_by_name("/path")
            self._shown = None
            scene = self.server.scene
            self._size = size_of(robot, request)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                bodies = robot_bodies(robot)
            ghost = outlines(robot, bodies)
            tints = ("q_start", START_RGB), ("q_goal", GOAL_RGB)
            self._arms = {
                end: Arm(scene, f"/{end}", robot, ghost, (color, GHOST_OPACITY))
                for end, color in tints
            }
            self._arms["robot"] = Arm(scene, "/robot", robot, bodies)
            self._arms["robot"].move(request.q_start)
            look_at(self.server, robot, request, self._size)
            self.handles.rebuild(0.16 * self._size)
            self.panel.rebuild()
        self.refresh()

    def _found(self, outcome: Outcome) -> None:
        """Take an outcome of the planning."""
        with self._lock:
            same = outcome.request.robot == self.controller.request.robot
            if not same or not hasattr(self, "handles"):
                return
            if outcome.shown is not None:
                if self._shown is None:
                    self._begun = time.monotonic()
                self._shown = outcome.shown
                draw_path(self.server.scene, outcome.shown, self._size)
            goes_on = self._shown is not None
            self.readout.show(outcome, self.controller.busy, goes_on)

    def _play(self) -> None:
        """Let the robot move, all the time."""
        period, next_bars = 1.0 / FRAMES_PER_SECOND, 0.0
        while not self._ended.wait(period):
            shown = self._shown
            if shown is None:
                continue
            now = self.readout.time(shown, time.monotonic() - self._begun, REST)
            try:
                with self._lock:
                    if shown is self._shown:
                        self._arms["robot"].move(shown.q[shown.row(now)])
                if time.monotonic() >= next_bars:
                    self.readout.show_bars(shown, now)
                    next_bars = time.monotonic() + 1.0 / BARS_PER_SECOND
            except Exception:  # the page goes on, whatever a client does
                logger.exception("a frame could not be shown")

    def export(self, ending: str, dt: float | None, message: str | None) -> None:
        """Hand the motion to the browser as a file."""
        found = self.controller.export(ending, dt, message)
        if found.content:
            self.server.send_file_download(found.name, found.content)
        self.readout.tell(found.remark, bad=not found.content)

    def close(self) -> None:
        """End serving and planning."""
        self._ended.set()
        self.controller.close()
        with redirect_stdout(io.StringIO()):
            self.server.stop()

    def wait(self) -> None:
        """Serve until somebody presses Ctrl-C."""
        try:
            while not self._ended.wait(3600.0):
                pass
        except KeyboardInterrupt:
            pass
        finally:
            self.close()
