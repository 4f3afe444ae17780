"""The playback page in a real browser, without a screen or a network."""

from __future__ import annotations

import base64
import fcntl
import io
import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from matplotlib.image import imread

from tominpmp.dynamics import RobotDynamics
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Sphere
from tominpmp.scene.scene import Scene
from tominpmp.viz.playback import play

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
CHROMIUM = next((found for name in NAMES if (found := shutil.which(name))), None)

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(
        CHROMIUM is None, reason=f"none of {', '.join(NAMES)} is on the path"
    ),
]

WIDTH, HEIGHT = 900, 600
FLAGS = (
    "--headless",
    "--no-sandbox",  # which root, in a container, cannot have
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-extensions",
    "--disable-sync",
    "--no-first-run",
    "--no-default-browser-check",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
)
PATIENCE = 300.0  # a loaded machine renders slowly [s]

START, END = (0.5, 1.7, -1.7), (0.9, -1.2, -0.9)
DURATION = 1.1

# The browser reads from descriptor 3 and writes to descriptor 4.
START_BROWSER = """
import os, sys
os.dup2(int(sys.argv[1]), 3)
os.dup2(int(sys.argv[2]), 4)
os.execv(sys.argv[3], sys.argv[3:])
"""

RED, GREEN, BLUE = range(3)


class Browser:
    """Chromium, controlled by its DevTools protocol over a pair of pipes."""

    def __init__(self, home: Path) -> None:
        theirs_in, self._out = os.pipe()
        self._in, theirs_out = os.pipe()
        # High numbers, which do not collide with the descriptors of the browser.
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 20) for end in (theirs_in, theirs_out)]
        self._log = (home / "log").open("wb")
        command = [str(CHROMIUM), *FLAGS, f"--user-data-dir={home / 'profile'}"]
        numbers = [str(end) for end in ends]
        self._process = subprocess.Popen(
            [sys.executable, "-c", START_BROWSER, *numbers, *command],
            pass_fds=ends,
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=self._log,
            env={**os.environ, "HOME": str(home)},
        )
        for end in (theirs_in, theirs_out, *ends):
            os.close(end)
        self._waiting = b""
        self._calls = 0
        self._target: str | None = None
        self.events: list[dict[str, Any]] = []

    def close(self) -> None:
        """End the browser."""
        self._process.terminate()
        try:
            self._process.wait(20.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for end in (self._in, self._out):
            os.close(end)
        self._log.close()

    def call(self, method: str, session: str | None = None, **params: Any) -> Any:
        """Call a method of the protocol and return its result."""
        self._calls += 1
        message = {"id": self._calls, "method": method, "params": params}
        if session is not None:
            message["sessionId"] = session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + PATIENCE
        while True:
            answer = self._read(deadline)
            if answer.get("id") == self._calls:
                assert "error" not in answer, answer
                return answer["result"]
            self.events.append(answer)

    def open(self, address: str) -> Page:
        """Open a page and close the previous page: hidden pages draw no frames."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        if self._target is not None:
            self.call("Target.closeTarget", targetId=self._target)
        self._target = str(target)
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        return Page(self, str(attached["sessionId"]), address)

    def wait_for(self, method: str, session: str) -> None:
        """Wait for an event that has not been read yet."""
        deadline = time.monotonic() + PATIENCE
        while not self.named(method, session):
            self.events.append(self._read(deadline))

    def named(self, method: str, session: str) -> list[Any]:
        """The parameters of all events with this name."""
        return [
            event["params"]
            for event in self.events
            if event.get("method") == method and event.get("sessionId") == session
        ]

    def _read(self, deadline: float) -> dict[str, Any]:
        while b"\0" not in self._waiting:
            left = max(0.0, deadline - time.monotonic())
            ready, _, _ = select.select([self._in], [], [], left)
            assert ready, "the browser does not answer"
            part = os.read(self._in, 1 << 20)
            assert part, "the browser has ended"
            self._waiting += part
        message, _, self._waiting = self._waiting.partition(b"\0")
        return dict(json.loads(message))


class Page:
    """A page in the browser, loaded."""

    def __init__(self, browser: Browser, session: str, address: str) -> None:
        self._browser, self._session = browser, session
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._call(f"{domain}.enable")
        self._call(
            "Emulation.setDeviceMetricsOverride",
            width=WIDTH,
            height=HEIGHT,
            deviceScaleFactor=1,
            mobile=False,
        )
        self._call("Page.navigate", url=address)
        browser.wait_for("Page.loadEventFired", self._session)

    def _call(self, method: str, **params: Any) -> Any:
        return self._browser.call(method, self._session, **params)

    def evaluate(self, expression: str) -> Any:
        """Value of an expression of JavaScript, awaited if it is a promise."""
        answer = self._call(
            "Runtime.evaluate",
            expression=expression,
            awaitPromise=True,
            returnByValue=True,
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def frames(self, count: int = 3) -> None:
        """Let the page draw some frames."""
        self.evaluate(
            f"new Promise((done) => {{ let left = {count}; const next = () => "
            "left-- ? requestAnimationFrame(next) : done(); next(); })"
        )

    def text(self, element: str) -> str:
        """Text of an element by its identifier."""
        return str(self.evaluate(f"document.getElementById('{element}').textContent"))

    def folders(self) -> set[str]:
        """The folders in Meshcat's controls, one for each node of the scene."""
        found = "document.querySelectorAll('li.title')"
        return set(self.evaluate(f"Array.from({found}, (item) => item.textContent)"))

    def picture(self) -> np.ndarray:
        """A screenshot: colours from 0 to 1, shape (height, width, 3)."""
        self.frames()
        shot = self._call("Page.captureScreenshot", format="png")["data"]
        pixels = np.asarray(imread(io.BytesIO(base64.b64decode(shot))))[..., :3]
        assert pixels.shape == (HEIGHT, WIDTH, 3)
        return pixels

    def complaints(self) -> list[Any]:
        """Exceptions, and log entries of errors."""
        entries = self._browser.named("Log.entryAdded", self._session)
        return self._browser.named("Runtime.exceptionThrown", self._session) + [
            entry for entry in entries if entry["entry"]["level"] == "error"
        ]

    def fetched(self) -> list[str]:
        """The requested addresses, without those inside the page itself."""
        requests = self._browser.named("Network.requestWillBeSent", self._session)
        addresses = [str(request["request"]["url"]) for request in requests]
        return [a for a in addresses if not a.startswith(("data:", "blob:"))]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    found = Browser(tmp_path_factory.mktemp("home"))
    yield found
    found.close()


def motion(robot: Robot) -> Trajectory:
    """From rest to rest along a quintic polynomial."""
    first, last = np.array(START), np.array(END)
    s = np.linspace(0.0, 1.0, 41)[:, None]
    q = first + (10 * s**3 - 15 * s**4 + 6 * s**5) * (last - first)
    v = (30 * s**2 - 60 * s**3 + 30 * s**4) * (last - first) / DURATION
    a = (60 * s - 180 * s**2 + 120 * s**3) * (last - first) / DURATION**2
    u = RobotDynamics(robot).inverse(q, v, a)
    return Trajectory(robot.joint_names, s[:, 0] * DURATION, q, v, u)


@pytest.fixture(scope="module")
def address(planar3r: Robot, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The paper's arm and obstacle on a page."""
    scene = Scene([Sphere("O", radius=0.8, position=(4, 0, 0))])
    problem = Problem(planar3r, START, PositionGoal("tip", (4, 1, 0)), scene=scene)
    path = tmp_path_factory.mktemp("page") / "motion.html"
    return str(play(problem, motion(planar3r), path=path).as_uri())


@pytest.fixture
def page(browser: Browser, address: str) -> Page:
    """The page, paused in the middle of the motion."""
    return browser.open(f"{address}#t=0.5")


def where(pixels: np.ndarray, strong: int, than: dict[int, float]) -> np.ndarray:
    """Rows and columns of the pixels in which a channel exceeds others by these
    factors.
    """
    hit = np.ones(pixels.shape[:2], dtype=bool)
    for weak, factor in than.items():
        hit &= pixels[..., strong] > factor * pixels[..., weak]
    return np.argwhere(hit)


def test_page_has_arm_obstacle_and_animation(page: Page) -> None:
    links = {f"link{i}_{k}" for i in (1, 2, 3) for k in (0, 1)}
    joints = {"joint1", "joint2", "joint3"}
    expected = links | joints | {"base_0", "obstacles", "O", "goal", "path of tip"}
    assert expected <= page.folders()
    assert page.evaluate("document.body.dataset.clips") == "3"
    page.frames()
    assert page.text("clock") == "0.500 / 1.100 s"
    assert page.text("toggle") == "Play"
    assert page.evaluate("document.title") == "planar3r: T = 1.1 s"
    assert float(page.evaluate("slider.max")) == pytest.approx(DURATION)
    assert float(page.evaluate("slider.value")) == pytest.approx(0.5)


def test_page_fetches_nothing_and_has_no_errors(page: Page, address: str) -> None:
    page.frames()
    assert page.fetched() == [address]
    assert page.complaints() == []
    assert page.text("problem") == ""


def test_fetches_and_errors_of_a_page_are_detected(
    browser: Browser, tmp_path: Path
) -> None:
    """The previous test would find a page that fetches, or fails."""
    path = tmp_path / "bad.html"
    path.write_text(
        '<img src="http://example.invalid/a.png"><script>nothing();</script>'
    )
    bad = browser.open(path.as_uri())
    assert "http://example.invalid/a.png" in bad.fetched()
    assert len(bad.complaints()) == 2


def test_page_shows_the_arm_at_its_configuration(page: Page) -> None:
    pictures = []
    for instant in (0.0, DURATION):
        page.evaluate(f"location.hash = '#t={instant}'")
        page.frames()
        assert page.text("clock") == f"{instant:.3f} / 1.100 s"
        pictures.append(page.picture())
    pixels = WIDTH * HEIGHT
    for picture in pictures:
        assert len(where(picture, BLUE, {RED: 2.0, GREEN: 1.4})) > 0.004 * pixels
        assert len(where(picture, RED, {GREEN: 1.4, BLUE: 2.5})) > 0.002 * pixels
        assert len(where(picture, GREEN, {RED: 1.5, BLUE: 1.2})) > 0.001 * pixels
        assert len(where(picture, RED, {GREEN: 1.8, BLUE: 1.8})) > 0.01 * pixels
    moved = np.abs(pictures[0] - pictures[1]).max(axis=2) > 0.1
    assert 0.01 < moved.mean() < 0.3
    # The obstacle stays where it is.
    obstacles = [
        where(picture, RED, {GREEN: 1.8, BLUE: 1.8}).mean(axis=0)
        for picture in pictures
    ]
    np.testing.assert_allclose(*obstacles, atol=6.0)
    # The hand moves from the upper left to the right, down to the obstacle.
    hands = [
        where(picture, GREEN, {RED: 1.5, BLUE: 1.2}).mean(axis=0)
        for picture in pictures
    ]
    row, column = hands[1] - hands[0]
    assert row > 60
    assert column > 60


def test_page_plays_the_motion_in_a_loop(browser: Browser, address: str) -> None:
    # The times between two returns to the start, slow enough for several frames on any
    # machine.
    seen = browser.open(address).evaluate(
        """new Promise((done) => {
          speed.value = "0.5";
          speed.onchange();
          let seen = null, before = 0;
          const look = () => {
            if (animator.time < before) {
              if (seen && new Set(seen).size > 3) return done(seen);
              if (seen) animator.mixer.timeScale *= 0.5;
              seen = [];
            }
            before = animator.time;
            if (seen) seen.push(before);
            requestAnimationFrame(look);
          };
          look();
        })"""
    )
    assert np.all(np.diff(seen) >= 0.0)
    assert seen[0] < DURATION
    assert seen[-1] == pytest.approx(DURATION)
    assert len(set(seen)) > 2


def test_speed_play_and_slider_control_the_animation(
    browser: Browser, address: str
) -> None:
    page = browser.open(f"{address}#t=0.5")
    assert page.evaluate("animator.mixer.timeScale") == 1.0
    # Slow enough not to reach the end.
    page.evaluate("speed.value = '0.1'; speed.onchange(); toggle.click()")
    assert page.evaluate("animator.mixer.timeScale") == 0.1
    page.evaluate(
        "new Promise((done) => { const look = () => animator.time > 0.5 ? "
        "done(toggle.click()) : requestAnimationFrame(look); look(); })"
    )
    page.frames()
    paused = page.evaluate("animator.time")
    assert 0.5 < paused
    assert page.text("toggle") == "Play"
    page.frames(10)
    assert page.evaluate("animator.time") == paused
    page.evaluate("slider.value = '0.25'; slider.dispatchEvent(new Event('input'))")
    page.frames()
    assert page.text("clock") == "0.250 / 1.100 s"
    assert page.complaints() == []


def test_page_shows_all_shapes_ghosts_and_a_pose_goal(
    browser: Browser, planar3r: Robot, tmp_path: Path
) -> None:
    scene = Scene(
        [
            Sphere("ball", radius=0.5, position=(4, -1, 0)),
            Box("crate", size=(1, 1, 1), position=(-1, -2, 0)),
            Cylinder("can", radius=0.4, length=1.0, position=(0.5, -2, 0)),
            Capsule("constructor", radius=0.3, length=1.0, position=(2, -2, 0)),
        ]
    )
    pose = pin.SE3(pin.utils.rotate("z", 0.5), np.array([4.0, 1.0, 0.0]))
    problem = Problem(planar3r, START, PoseGoal("tip", pose), scene=scene)
    path = play(problem, motion(planar3r), path=tmp_path / "all 100%.html", ghosts=5)
    page = browser.open(f"{path.as_uri()}#t=0")
    names = {"ball", "crate", "can", "constructor_", "ghosts", "goal", "x", "y", "z"}
    assert names <= page.folders()
    # The four obstacles stand apart in the picture.
    red = where(page.picture(), RED, {GREEN: 1.8, BLUE: 1.8})
    columns = np.zeros(WIDTH, dtype=bool)
    columns[red[:, 1]] = True
    assert np.sum(np.diff(columns.astype(int)) == 1) >= 4
    assert page.complaints() == []
    assert page.text("problem") == ""


@pytest.mark.parametrize("size", [(900, 600), (800, 360), (358, 636)])
def test_projection_is_undistorted_in_every_window(
    browser: Browser, address: str, size: tuple[int, int]
) -> None:
    page = browser.open(address)
    width, height = size
    sizes = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    page._call("Emulation.setDeviceMetricsOverride", **sizes)
    browser.events.clear()
    page._call("Page.reload")
    browser.wait_for("Page.loadEventFired", page._session)
    page.frames()
    across, along, wide, high = page.evaluate(
        "[0, 5].map((i) => viewer.camera.projectionMatrix.elements[i]).concat("
        "['offsetWidth', 'offsetHeight'].map((side) =>"
        " document.querySelector('#meshcat-pane canvas')[side]))"
    )
    assert across * wide == pytest.approx(along * high)
    pane = page.evaluate("document.getElementById('meshcat-pane').offsetHeight")
    assert high == pane


# Torques that rise to their limit and fall again; the pixels drawn above this limit.
ABOVE_THE_LIMIT = """(() => {
shares.t = Array.from({length: 401}, (_, i) => duration * i / 400);
shares.torque[0] = shares.t.map((_, i) => 1 - Math.abs(i % 20 - 10) / 10);
shares.speed[0] = shares.t.map(() => 0);
fit_curves();
const [half, top] = [background.width / 2, row_of(0, canvas.clientHeight)[0]];
const above = background.getContext("2d").getImageData(half, top - 5, half, 3);
return above.data.filter(Boolean).length; })()"""


def test_curves_are_not_drawn_beyond_a_limit_they_touch(page: Page) -> None:
    """Regression: the pointed corners of the lines were drawn beyond the limit."""
    assert page.evaluate(ABOVE_THE_LIMIT) == 0


def test_title_does_not_overlap_the_controls_of_meshcat(page: Page) -> None:
    """Regression: the controls covered the end of a long title."""
    right, left = page.evaluate(
        "[document.getElementById('about').getBoundingClientRect().right,"
        " document.querySelector('.dg.main').getBoundingClientRect().left]"
    )
    assert right <= left


@pytest.mark.parametrize(
    ("width", "height", "below"),
    [(358, 636, True), (358, 380, False), (320, 568, True)],
)
def test_curves_are_below_the_motion_on_telephones(
    browser: Browser, address: str, width: int, height: int, below: bool
) -> None:
    page = browser.open(address)
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": True}
    page._call("Emulation.setDeviceMetricsOverride", **size)
    page.frames()
    places = page.evaluate(
        "['meshcat-pane', 'player', 'shares'].map((id) => {"
        " const r = document.getElementById(id).getBoundingClientRect();"
        " return [r.top, r.bottom, r.width]; })"
    )
    pane, player, shares = places
    # The arm is below the title, which covers all of the width.
    title = "document.getElementById('about').getBoundingClientRect().bottom"
    assert page.evaluate(f"viewer.camera.view.offsetY + {title}") == pytest.approx(0.0)
    assert pane[2] == width and player[1] <= pane[1]
    # No control ends beyond the player.
    last = page.evaluate(
        "document.getElementById('speed').getBoundingClientRect().right"
    )
    assert last <= width - 0.03 * width - 10
    # The canvas is as high as the pane, so that no part of the arm is cut off.
    drawn = page.evaluate("document.querySelector('#meshcat-pane canvas').offsetHeight")
    assert drawn == pytest.approx(pane[1] - pane[0], abs=1.0)
    assert (shares[2] > 0) is below
    assert pane[1] == pytest.approx(shares[0] if below else height, abs=1.0)
