"""The command that opens the live page: what it says where it cannot."""

from __future__ import annotations

import socket
import sys

import pytest
from command_line import invoke


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
    code, told = run("planar4r", "--no-browser")
    assert code == 2
    assert "planar4r" in told
