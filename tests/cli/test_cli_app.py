"""The command that opens the live page: what it says where it cannot."""

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


def test_without_viser_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    code, told = run("planar3r")
    assert code == 2
    assert "tominpmp[app]" in told


def test_a_port_that_is_taken_and_a_robot_that_is_none_are_told() -> None:
    pytest.importorskip("viser")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, told = run("planar3r", "--port", str(port), "--no-browser")
    assert code == 2
    assert f"port {port} of 127.0.0.1 cannot be used" in told
    code, told = run("planar3r", "--host", "no.invalid", "--no-browser")
    assert code == 2
    assert "of no.invalid cannot be used" in told and "another port or host" in told
    code, told = run("planar3r", "--host", "", "--no-browser")
    assert code == 2
    assert "an empty host would let others on the network open it" in told
    code, told = run("planar4r", "--no-browser")
    assert code == 2
    assert "planar4r" in told


def test_a_robot_without_dynamics_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its error offered a flag that the command had not."""
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
    code, told = run(*words)
    assert code == 2 and "--kinematic" in told
    code, told = run(*words, "--kinematic")
    assert code == 0, told
    assert shown[0].problem().robot.kinematic
