"""Fixtures for tests of the command line."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_samples import (
    SLIDER,
    Planner,
    Run,
)
from typer.testing import CliRunner

from tominpmp.cli.app import app
from tominpmp.robot import Robot, load_robot


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """Run the command line in an empty folder."""
    monkeypatch.chdir(tmp_path)
    runner = CliRunner()
    return lambda *args: runner.invoke(app, [str(arg) for arg in args])


@pytest.fixture
def slider(tmp_path: Path) -> Robot:
    """A cart with a pole: one joint slides, one turns."""
    path = tmp_path / "slider.urdf"
    path.write_text(SLIDER, encoding="utf-8")
    return load_robot(path)


@pytest.fixture
def planner(monkeypatch: pytest.MonkeyPatch) -> Planner:
    """A planner that takes no time."""
    fake = Planner()
    monkeypatch.setattr("tominpmp.planner.plan", fake)
    return fake
