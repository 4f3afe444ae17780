"""Fixtures for tests of the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli_samples import (
    REQUEST,
    SCENARIO,
    SCENE,
    SLIDER,
    Judge,
    Planner,
    Run,
    passed,
    straight,
)
from command_line import invoke

from tominpmp.files.export import export
from tominpmp.files.scenario import load_scenario
from tominpmp.robot.robot import Robot, load_robot


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """Run the command line in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *args: invoke(args)


@pytest.fixture
def slider(tmp_path: Path) -> Robot:
    """A cart with a pole: one joint slides, one turns."""
    path = tmp_path / "slider.urdf"
    path.write_text(SLIDER, encoding="utf-8")
    return load_robot(path)


@pytest.fixture
def planner(monkeypatch: pytest.MonkeyPatch) -> Planner:
    """The planner is replaced by a stand-in that takes no time."""
    fake = Planner()
    monkeypatch.setattr("tominpmp.planner.planning.plan", fake)
    # The motions of the stand-in satisfy no limits.
    monkeypatch.setattr("tominpmp.files.export_check.check_export", passed)
    return fake


@pytest.fixture
def judge(monkeypatch: pytest.MonkeyPatch) -> Judge:
    """The verification is replaced by a stand-in that takes no time."""
    fake = Judge()
    monkeypatch.setattr("tominpmp.files.export_check.verify", fake)
    return fake


@pytest.fixture
def files(run: Run, tmp_path: Path) -> None:
    """The files of the examples, in the folder where the command line runs."""
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    (tmp_path / "scene.yaml").write_text(json.dumps(SCENE))
    (tmp_path / "request.yaml").write_text(json.dumps(REQUEST))
    problem = load_scenario(tmp_path / "scenario.toml").problem
    export(straight(problem), tmp_path / "motion.yaml")
