"""The live page in a real browser: dragging a goal leads to a new verified motion."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import test_browser
from test_browser import CHROMIUM, Browser

from tominpmp.app.controller import Controller
from tominpmp.app.first_request import first_request, known
from tominpmp.app.planning import Outcome
from tominpmp.app.request import loaded
from tominpmp.exceptions import OptionsError

viser = pytest.importorskip("viser")
msgspec = pytest.importorskip("msgspec")
client = pytest.importorskip("websockets.sync.client")
websockets = pytest.importorskip("websockets.exceptions")

PATIENCE = 300.0  # on a loaded machine [s]
# Clicks a checkbox by the text of its label.
SWITCH = """(text) => document.getElementById(
Array.from(document.querySelectorAll('label'))
.find((label) => label.textContent.trim() === text).htmlFor).click()"""

# Threads and sockets of the server may outlive a test.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")


def verified(outcome: Outcome) -> bool:
    """Whether there is a motion that keeps all limits."""
    return outcome.shown is not None and outcome.shown.verified


def free_port() -> int:
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return int(trial.getsockname()[1])


@contextlib.contextmanager
def opened(robot: str) -> Iterator[object]:
    """The page of a robot, at a free port."""
    from tominpmp.app.page import Page

    found = None
    while found is None:
        # Another program may have taken the port meanwhile.
        with contextlib.suppress(OptionsError):
            found = Page(first_request(known(robot)), port=free_port())
    yield found
    found.close()


@pytest.fixture
def unplanned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages whose requests are not planned."""
    idle = SimpleNamespace(plan=lambda *_: None, close=lambda: None)
    planning = partial(Controller, planning=lambda _: idle)
    monkeypatch.setattr("tominpmp.app.page.Controller", planning)


@pytest.fixture(scope="module")
def page() -> Iterator[object]:
    with opened("planar3r") as found:
        yield found


def send(page: object, **message: object) -> None:
    """Send a message of the page in the browser, and wait for the changed request."""
    address = page.address.replace("http", "ws")  # type: ignore[attr-defined]
    version = f"viser-v{viser.__version__}"
    controller = page.controller  # type: ignore[attr-defined]
    before, deadline = controller.request, time.monotonic() + PATIENCE
    with client.connect(
        address, subprotocols=[version], max_size=None, open_timeout=PATIENCE
    ) as connection:
        connection.send(msgspec.msgpack.encode(message))
        while controller.request is before:
            assert time.monotonic() < deadline, "the request did not change"
            time.sleep(0.02)


def drag(page: object, handle: str, position: list[float]) -> None:
    send(
        page,
        type="TransformControlsUpdateMessage",
        name=f"/handles/{handle}",
        wxyz=[1.0, 0.0, 0.0, 0.0],
        position=position,
        owner="",
    )


def outcome_of(page: object) -> Outcome:
    """The last outcome of the present request."""
    controller = page.controller  # type: ignore[attr-defined]
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        last = controller.outcome
        if last is not None and not controller.busy:
            return last
        time.sleep(0.05)
    raise AssertionError(f"no last outcome of the request: {controller.outcome}")


def test_port_in_use_is_named_in_the_error(page: object) -> None:
    from tominpmp.app.page import check_port

    port = int(page.address.rpartition(":")[2])  # type: ignore[attr-defined]
    with pytest.raises(OptionsError, match=f"port {port} of host '127"):
        check_port("127.0.0.1", port)
    with pytest.raises(OptionsError, match="port 99999999"):
        check_port("127.0.0.1", 99999999)


@pytest.mark.skipif(not socket.has_ipv6, reason="needs IPv6")
def test_page_opens_at_any_free_port_of_an_ipv6_address() -> None:
    """Regression: IPv6 hosts were rejected, and port 0 stood in the address."""
    from tominpmp.app.page import Page

    found = Page(first_request(known("planar3r")), "::1", 0)
    try:
        assert found.address.startswith("http://[::1]:")
        assert not found.address.endswith(":0")
        address = found.address.replace("http", "ws")
        version = f"viser-v{viser.__version__}"
        client.connect(
            address, subprotocols=[version], max_size=None, open_timeout=PATIENCE
        ).close()
    finally:
        found.close()


def test_dragged_goal_leads_to_a_new_verified_motion(page: object) -> None:
    first = outcome_of(page)
    assert verified(first)
    controller = page.controller  # type: ignore[attr-defined]
    position, _ = controller.request.pose(controller.request.q_goal)
    aim = position + np.array([0.2, 0.3, 0.0])
    drag(page, "q_goal", aim.tolist())
    second = outcome_of(page)
    assert verified(second)
    assert second.shown is not None
    np.testing.assert_allclose(second.shown.path[-1], aim, atol=5e-3)


def test_obstacle_dragged_onto_the_start_is_reported(page: object) -> None:
    controller = page.controller  # type: ignore[attr-defined]
    outcome_of(page)
    start, _ = controller.request.pose(controller.request.q_start)
    home = controller.request.items[0].position
    drag(page, "item_O", start.tolist())
    refused = outcome_of(page)
    assert not verified(refused)
    assert "start" in refused.message
    drag(page, "item_O", home.tolist())
    assert verified(outcome_of(page))


def test_unreadable_uploaded_file_is_rejected_with_a_reason(page: object) -> None:
    """Regression: empty files, and files of more than 20 MB, were ignored without a
    message.
    """
    request = page.controller.request  # type: ignore[attr-defined]
    for content, reason in ((b"", "is not XML"), (b" " * 40_000_000, "it may have")):
        file = SimpleNamespace(name="arm.urdf", content=content)
        page.panel._take_file(file)  # type: ignore[attr-defined]
        assert reason in page.readout._notice.content  # type: ignore[attr-defined]
    assert page.controller.request == request  # type: ignore[attr-defined]


def test_new_via_point_is_on_the_shown_path(page: object) -> None:
    """Regression: the via point was put between start and goal, on the Panda's page
    into its post.
    """
    first = outcome_of(page)
    assert first.shown is not None
    path, controller = first.shown.path, page.controller  # type: ignore[attr-defined]
    middle = path[len(path) // 2]
    page.panel._add_point()  # type: ignore[attr-defined]
    np.testing.assert_allclose(controller.request.via, [middle], atol=1e-3)
    found = outcome_of(page)
    assert verified(found)
    page.panel._add_point()  # type: ignore[attr-defined]
    assert np.linalg.norm(controller.request.via[1] - path[-1]) < np.linalg.norm(
        middle - path[-1]
    )
    controller.change(via=())
    outcome_of(page)


def test_slider_has_the_time_in_seconds(
    page: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown, readout = outcome_of(page).shown, page.readout  # type: ignore[attr-defined]
    assert shown is not None
    assert readout._slider.max == pytest.approx(shown.T, abs=1e-3)
    monkeypatch.setattr(readout, "_pause", lambda: None)
    readout._playing.value = False
    readout._slider.value = 0.3
    assert readout.time(shown, 9.9) == 0.3
    readout._playing.value = True


@pytest.mark.usefixtures("unplanned")
def test_page_without_obstacles_has_no_fields_for_obstacles() -> None:
    with opened("so100") as page:
        panel = page.panel  # type: ignore[attr-defined]
        assert panel._items.options == ("none",)
        assert not any(field.visible for field in (*panel._sizes, panel._remove))


@pytest.mark.usefixtures("unplanned")
def test_size_fields_follow_the_obstacle_of_the_chosen_robot() -> None:
    """Regression: a box had the radius and the length of the post of the previous
    robot.
    """
    with opened("ur5") as page:
        panel = page.panel  # type: ignore[attr-defined]
        assert [field.label for field in panel._sizes[:2]] == [
            "radius [m]",
            "length [m]",
        ]
        page.choose(known("panda"))  # type: ignore[attr-defined]
        assert [field.value for field in panel._sizes] == [0.1, 0.1, 1.0]
        assert panel._sizes[2].visible and panel._sizes[2].label == "z [m]"


@pytest.mark.usefixtures("unplanned")
def test_buttons_and_handles_change_the_request() -> None:
    with opened("planar3r") as page:
        panel, handles = page.panel, page.handles  # type: ignore[attr-defined]
        controller = page.controller  # type: ignore[attr-defined]
        before = controller.request
        panel._swap()
        assert controller.request.q_start == before.q_goal
        assert controller.request.q_goal == before.q_start
        panel._add_item("capsule")
        assert controller.request.items[-1].name == panel._items.value == "capsule1"
        node = SimpleNamespace(position=np.array([9.0, 1, 0]), wxyz=np.eye(4)[0])
        handles._drag_item("capsule1", node)
        assert controller.request.items[-1].position.tolist() == [9.0, 1.0, 0.0]
        far = SimpleNamespace(position=np.full(3, 1e12), wxyz=np.eye(4)[0])
        handles._drag_item("capsule1", far)
        assert "capsule1" in page.readout._notice.content  # type: ignore[attr-defined]
        assert controller.request.items[-1].position.tolist() == [9.0, 1.0, 0.0]
        panel._remove_item()
        assert controller.request.items == before.items
        panel._add_point()
        handles._drag_via(0, node)
        assert controller.request.via == ((9.0, 1.0, 0.0),)
        page.ask(via=())  # type: ignore[attr-defined]
        assert "via0" not in handles._known
        handles._drag_via(0, node)  # an event that comes too late
        handles._drag_end("q_goal", node)
        notice = page.readout._notice.content  # type: ignore[attr-defined]
        assert "handle of the goal is out of reach by 3." in notice
        page.export(".csv", None, None)  # type: ignore[attr-defined]
        notice = page.readout._notice.content  # type: ignore[attr-defined]
        assert "no motion to export" in notice
        panel._groups.value = "arm"
        panel._choose_part()
        assert controller.request.robot.group == "arm"
        # Regression: a drag while another robot is chosen, before it is on the stage.
        locked = (("joint3", 0.0),)
        choice = replace(controller.request.robot, group=None, locked=locked)
        controller.choose(choice)
        handles._drag_end("q_goal", node)
        assert len(controller.request.q_goal) == 2
        page._set_stage()  # type: ignore[attr-defined]
        place = handles._known["q_goal"][1].position
        goal = controller.request.pose(controller.request.q_goal)[0]
        np.testing.assert_allclose(place, goal)


@pytest.mark.usefixtures("unplanned")
def test_hidden_handles_keep_their_obstacles_visible() -> None:
    """Regression: obstacles vanished with their handles, and came back with another
    size.
    """
    with opened("ur5") as page:
        handles = page.handles  # type: ignore[attr-defined]
        shown = page.panel.handles_shown  # type: ignore[attr-defined]
        shown.value = False
        page.refresh()  # type: ignore[attr-defined]
        page.panel._add_point()  # type: ignore[attr-defined]
        page.panel._sizes[0].value = 0.1  # type: ignore[attr-defined]
        page.panel._resize()  # type: ignore[attr-defined]
        nodes = [node for _, node in handles._known.values()]
        assert len(nodes) == 4
        for node in nodes:
            assert node.visible and node.disable_axes and node.disable_rotations
        shown.value = True
        page.refresh()  # type: ignore[attr-defined]
        assert not any(node.disable_axes for _, node in handles._known.values())


def test_choosing_a_robot_resets_limits_and_curves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Regression: the page still showed the curves and the limit of the
    previous robot.
    """
    with opened("planar3r") as page:
        panel, readout = page.panel, page.readout  # type: ignore[attr-defined]
        controller = page.controller  # type: ignore[attr-defined]
        outcome_of(page)
        panel._bounded.value, panel._acceleration.value = True, 40.0
        panel._change_limits()
        assert outcome_of(page).request.acceleration == 40.0
        monkeypatch.setattr(controller._planning, "plan", lambda *_: None)
        page.choose(replace(known("planar3r"), kinematic=True))  # type: ignore[attr-defined]
        assert panel._acceleration.value == controller.request.acceleration == 15.0
        assert "Planning the first motion" in readout._headline.content
        assert not readout.bars.content and not readout._curves.content


def test_dropped_file_without_a_robot_is_reported(page: object) -> None:
    from viser import UploadedFile

    before = page.controller.request  # type: ignore[attr-defined]
    page.panel._take_file(UploadedFile("cat.urdf", b"\x89PNG"))  # type: ignore[attr-defined]
    notice = page.readout._notice.content  # type: ignore[attr-defined]
    assert "cat.urdf" in notice
    assert page.controller.request == before  # type: ignore[attr-defined]


@pytest.mark.usefixtures("unplanned")
def test_uploaded_files_are_removed_with_the_page() -> None:
    """Regression: each file stayed in the folder of temporary files for ever."""
    from viser import UploadedFile

    content = loaded(known("planar3r")).urdf_path.read_bytes()
    with opened("planar3r") as page:
        for _ in range(2):
            before = page.controller.request  # type: ignore[attr-defined]
            page.panel._take_file(UploadedFile("arm.urdf", content))  # type: ignore[attr-defined]
            path = Path(page.controller.request.robot.source)  # type: ignore[attr-defined]
            assert path.is_file() and str(path) != before.robot.source
    assert not path.exists() and not path.parents[1].exists()


def handshake(page: object, host: str, origin: str | None, path: str = "/") -> int:
    """The status code with which the page answers a websocket from a host and an
    origin.
    """
    port = int(page.address.rpartition(":")[2])  # type: ignore[attr-defined]
    try:
        with client.connect(
            f"ws://{host.replace('PORT', str(port))}{path}",
            origin=None if origin is None else origin.replace("PORT", str(port)),
            subprotocols=[f"viser-v{viser.__version__}"],
            max_size=None,
            open_timeout=PATIENCE,
            sock=socket.create_connection(("127.0.0.1", port)),
        ) as connection:
            assert connection.recv(timeout=PATIENCE)  # the scene
            return 101
    except websockets.InvalidStatus as refused:
        return int(refused.response.status_code)


@pytest.mark.parametrize(
    ("host", "origin", "code"),
    [
        ("localhost:PORT", "http://localhost:PORT", 101),
        ("127.0.0.1:PORT", "http://127.0.0.1:PORT", 101),
        ("[::1]:PORT", "http://[::1]:PORT", 101),
        ("LOCALHOST:PORT", "http://localhost:PORT", 101),
        # Through a tunnel from another port, or behind a TLS proxy.
        ("localhost:9000", "http://localhost:9000", 101),
        ("localhost", "https://localhost", 101),
        # Programs that are no browsers.
        ("localhost:PORT", None, 101),
        # Other sites in the browser of the user.
        ("localhost:PORT", "http://attacker.example", 403),
        ("localhost:PORT", "http://attacker.example:PORT", 403),
        ("localhost:PORT", "http://localhost:9000", 403),
        ("127.0.0.1:PORT", "http://localhost.attacker.example:PORT", 403),
        ("localhost:PORT", "null", 403),
        # Names of other sites that resolve to this machine.
        ("attacker.example:PORT", "http://attacker.example:PORT", 403),
        ("attacker.example:PORT", None, 403),
        ("127.0.0.1.attacker.example:PORT", None, 403),
    ],
)
def test_page_rejects_websockets_of_other_origins(
    page: object, host: str, origin: str | None, code: int
) -> None:
    assert handshake(page, host, origin) == code


@pytest.mark.usefixtures("unplanned")
def test_unsupported_viser_is_rejected_before_it_serves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from tominpmp.app.page import Page
    from tominpmp.exceptions import TominpmpError

    stopped = []

    class Other:
        """A server that opens its websocket in another way."""

        def __init__(self, *where: object, **settings: object) -> None:
            pass

        def stop(self) -> None:
            stopped.append(self)

    monkeypatch.setattr(viser, "ViserServer", Other)
    with pytest.raises(TominpmpError, match=f"viser {viser.__version__} opens"):
        Page(first_request(known("planar3r")), port=free_port())
    assert stopped


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is on the path")
def test_browser_shows_the_new_motion_after_a_drag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The page loads from this machine only.
    rules = "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE localhost"
    flags = [f for f in test_browser.FLAGS if not f.startswith("--host-resolver")]
    monkeypatch.setattr(test_browser, "FLAGS", (*flags, rules))
    with opened("planar3r") as page, contextlib.closing(Browser(tmp_path)) as browser:
        before = outcome_of(page)
        assert before.shown is not None
        view = browser.open(page.address)  # type: ignore[attr-defined]

        def headline(expected: str) -> str:
            deadline = time.monotonic() + PATIENCE
            text = ""
            while expected not in text and time.monotonic() < deadline:
                time.sleep(0.2)
                text = str(view.evaluate("document.body.innerText"))
            return text

        assert f"{before.shown.T:.3f} s" in headline(f"{before.shown.T:.3f} s")
        assert view.evaluate("document.querySelectorAll('canvas').length") >= 1
        position, _ = page.controller.request.pose(  # type: ignore[attr-defined]
            page.controller.request.q_goal  # type: ignore[attr-defined]
        )
        drag(page, "q_goal", (position - np.array([0.2, 0.0, 0.0])).tolist())
        after = outcome_of(page)
        assert after.shown is not None
        assert f"{after.shown.T:.3f}" != f"{before.shown.T:.3f}"
        shown = headline(f"{after.shown.T:.3f} s")
        assert f"{after.shown.T:.3f} s" in shown
        assert "verified by replay" in headline("verified by replay")
        # Without the dynamics, the bars show accelerations, not torques.
        view.evaluate(f"({SWITCH})('Kinematic')")
        assert "\nacceleration\n" in headline("\nacceleration\n")
        assert verified(outcome_of(page))
        request, panel = page.controller.request, page.panel  # type: ignore[attr-defined]
        assert request.robot.kinematic and request.acceleration == 15.0
        assert panel._bounded.value and panel._acceleration.visible
        assert not panel._sliders["effort_scale"].visible
        # A telephone has the duration at the top of the sheet, in one line.
        size = {"width": 400, "height": 800, "deviceScaleFactor": 1, "mobile": True}
        view._call("Emulation.setDeviceMetricsOverride", **size)
        view.frames(10)
        top, height = view.evaluate(
            "(() => { const r = document.getElementById('tominpmp-T')"
            ".getBoundingClientRect(); return [r.top, r.height]; })()"
        )
        assert 0.0 < height < 60.0 and top + height < 800.0
        assert view.complaints() == []
