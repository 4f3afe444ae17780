"""The command `app`, which opens the live page: errors and robots without dynamics."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

import pytest
from command_line import invoke

from tominpmp.app.request import Request


def run(*words: str) -> tuple[int, str]:
    result = invoke(["app", *words])
    return result.exit_code, result.output


def test_app_without_viser_names_the_extra_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    code, output = run("planar3r")
    assert code == 2
    assert "tominpmp[app]" in output


def test_app_reports_an_unusable_port_host_or_robot() -> None:
    pytest.importorskip("viser")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, output = run("planar3r", "--port", str(port), "--no-browser")
    assert code == 2
    assert f"port {port} of host '127.0.0.1' cannot be used" in output
    code, output = run("planar3r", "--host", "no.invalid", "--no-browser")
    assert code == 2
    assert "of host 'no.invalid' cannot be used" in output
    assert "another port or host" in output
    code, output = run("planar3r", "--host", "", "--no-browser")
    assert code == 2
    assert "an empty host would let others on the network open it" in output
    code, output = run("planar4r", "--no-browser")
    assert code == 2
    assert "planar4r" in output


def test_app_shows_a_robot_without_dynamics(monkeypatch: pytest.MonkeyPatch) -> None:
    """Regression: the error suggested a flag that the command did not have."""
    pytest.importorskip("viser")
    shown = []

    class Page:
        def __init__(self, request: Request, *_: object) -> None:
            shown.append(request)
            self.address = "somewhere"

        def wait(self) -> None:
            pass

    monkeypatch.setattr("tominpmp.app.page.Page", Page)
    report = Path(__file__).parents[1] / "reports" / "kinematic_no_effort_no_inertia"
    words = str(report / "robot.urdf"), "--no-browser"
    code, output = run(*words)
    assert code == 2 and "--kinematic" in output
    code, output = run(*words, "--kinematic")
    assert code == 0, output
    assert shown[0].problem().robot.kinematic
