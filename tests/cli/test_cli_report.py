"""Exit codes, reports in text and JSON, warnings, and progress of `plan`."""

from __future__ import annotations

import json
import math
import os
import re
import warnings
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from cli_samples import (
    GOAL,
    PLAN,
    Planner,
    Run,
    straight,
)
from record_samples import record
from rich.console import Console

from tominpmp.cli.plan import Progress
from tominpmp.cli.report import limit_shares, report_data
from tominpmp.cli.terminal import error_console, guarded
from tominpmp.exceptions import (
    ProblemError,
    TominpmpWarning,
)
from tominpmp.files.export import load_motion
from tominpmp.goals.joints import JointGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import load_robot
from tominpmp.solution import Solution
from tominpmp.status import Status


def test_report_of_a_plan_is_a_message_and_a_table(
    run: Run, planner: Planner, tmp_path: Path
) -> None:
    result = run(*PLAN)
    assert result.exit_code == 0
    assert result.stderr == ""
    first, blank, *rows = result.stdout.splitlines()
    assert first == f"{Status.CONVERGED.value} And so on."
    assert blank == ""
    table = dict(re.split(r" {2,}", row.strip(), maxsplit=1) for row in rows)
    assert table["duration"] == "2.0000 s"
    assert table["iterations"] == "3 (6 linear programs, 2 starts)"
    assert table["planning time"] == "0.25 s"
    assert table["violations"] == "torque 2.0e-09, velocity 0 (scaled)"
    assert table["motion"] == "motion.csv"
    motion = load_motion(tmp_path / "motion.csv")
    np.testing.assert_array_equal(motion.q[-1], [2.0, -1.0, 0.5])


@pytest.mark.parametrize(
    ("status", "code"), [(Status.TIME_LIMIT, 0), (Status.INTERRUPTED, 130)]
)
def test_plan_stopped_early_writes_its_motion(
    run: Run, planner: Planner, status: Status, code: int
) -> None:
    planner.status = status
    assert run(*PLAN).exit_code == code
    assert Path("motion.csv").exists()


@pytest.mark.parametrize(
    ("status", "code"),
    [
        (Status.INFEASIBLE, 1),
        (Status.TIME_LIMIT, 1),
        (Status.NUMERICAL_FAILURE, 1),
        (Status.INTERRUPTED, 130),
    ],
)
@pytest.mark.parametrize("motion", [True, False])
def test_failed_plan_writes_no_file(
    run: Run, planner: Planner, status: Status, code: int, motion: bool
) -> None:
    planner.status, planner.feasible, planner.motion = status, False, motion
    result = run(*PLAN)
    assert result.exit_code == code
    assert status.value in result.stdout
    assert ("best attempt" in result.stdout) == motion
    assert "\nduration " not in result.stdout
    assert os.listdir() == []


def test_interrupt_outside_the_planner_ends_with_exit_code_130(
    run: Run, planner: Planner
) -> None:
    planner.error = KeyboardInterrupt()
    result = run(*PLAN)
    assert result.exit_code == 130
    assert result.stderr == "error: interrupted\n"
    assert result.stdout == ""


def test_internal_error_ends_with_exit_code_70(run: Run, planner: Planner) -> None:
    planner.error = ZeroDivisionError("by naught")
    result = run(*PLAN)
    assert result.exit_code == 70
    assert result.stderr.startswith("error: ZeroDivisionError: by naught (this is a")
    assert "Traceback" not in result.stderr
    assert result.stderr.count("\n") == 1


def test_internal_error_is_not_attributed_to_an_argument(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*_: object, **__: object) -> None:
        raise RuntimeError("the hull of a mesh is empty")

    monkeypatch.setattr("tominpmp.collision.checker.CollisionChecker.__init__", failing)
    result = run(*PLAN)
    assert result.exit_code == 70
    assert "RuntimeError: the hull of a mesh is empty (this is a" in result.stderr


def test_debug_flag_shows_the_traceback(run: Run, planner: Planner) -> None:
    planner.error = ProblemError("goal: nothing there", "goal")
    result = run(*PLAN, "--debug")
    assert result.exit_code == 2
    assert "Traceback" in result.stderr
    assert result.stderr.endswith("error: --goal: nothing there\n")


def test_json_report_has_the_results_and_files(run: Run, planner: Planner) -> None:
    result = run(*PLAN, "--json", "--plot", "motion.png")
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    assert data["success"] is True
    assert data["status"] == "CONVERGED"
    assert data["T"] == 2.0
    assert data["iterations"] == 3
    assert data["programs"] == 6
    assert data["starts"] == 2
    assert data["robot"] == "planar3r"
    assert data["joint_names"] == ["joint1", "joint2", "joint3"]
    assert data["q_start"] == [0.5, 1.7, -1.7]
    assert data["q_end"] == [2.0, -1.0, 0.5]
    assert data["violations"] == {"torque": 2e-9, "velocity": 0.0}
    assert data["files"] == {"motion": "motion.csv", "plot": "motion.png"}
    assert Path("motion.png").read_bytes().startswith(b"\x89PNG")


def test_json_report_of_a_failed_plan_has_no_duration(
    run: Run, planner: Planner
) -> None:
    planner.status, planner.feasible, planner.motion = Status.INFEASIBLE, False, False
    result = run(*PLAN, "--json")
    assert result.exit_code == 1
    data = json.loads(result.stdout)
    assert data["success"] is False
    assert data["T"] is None
    assert data["files"] == {}


def test_quiet_flag_prints_failures_only(run: Run, planner: Planner) -> None:
    result = run(*PLAN, "--quiet")
    assert (result.exit_code, result.stdout, result.stderr) == (0, "", "")
    assert Path("motion.csv").exists()
    planner.status, planner.feasible = Status.INFEASIBLE, False
    result = run(*PLAN, "--quiet")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == f"{Status.INFEASIBLE.value} And so on.\n"


def test_library_warning_is_one_line_on_standard_error(
    run: Run, planner: Planner
) -> None:
    result = run("plan", "planar3r", "--start", "0.1799999 0 0", "--goal", GOAL)
    assert result.exit_code == 0
    start = "warning: q_start: joint 'joint1' is 0.1799999 rad, outside"
    assert result.stderr.startswith(start)
    assert result.stderr.count("\n") == 1
    assert planner.problem.q_start[0] == 0.18


def test_repeated_warning_is_printed_once(
    run: Run, planner: Planner, files: None
) -> None:
    far = "world: {collision_objects: [{id: far, primitives: [{type: sphere, "
    far += "dimensions: [1]}], primitive_poses: [{position: [500, 0, 0]}]}]}"
    Path("scene.yaml").write_text(far)
    words = ("--scene", "scene.yaml", "--obstacle", "sphere:b:r=0.1:at=9,9,9")
    for _ in range(2):
        result = run(*PLAN, *words)
        assert (result.exit_code, len(planner.problem.scene)) == (0, 2)
        assert result.stderr.count("in millimetres") == 1


def test_limit_shares_weigh_intervals_at_torque_or_speed_limits() -> None:
    arm = load_robot("planar3r", velocity=1.0)
    t = np.array([0.0, 1.0, 4.0, 8.0, 10.0])
    u = np.zeros((5, 3))
    u[0, 0] = -20.0  # at its limit for 1 s
    u[2, 1] = 6.98  # nearly at its limit of 7 for 4 s
    v = np.zeros((5, 3))
    q = np.zeros((5, 3))
    q[4, 2] = 2.0 * (1.0 / 1.5)  # a cubic from rest to rest: 1.5 times the mean
    motion = Trajectory(arm.joint_names, t, q, v, u)
    problem = Problem(arm, np.ones(3), JointGoal(np.array([0.5, 1.7, -1.7])))
    torque, either = limit_shares(problem, motion)
    assert torque == pytest.approx(0.5)
    assert either == pytest.approx(0.7)


def test_report_shows_an_infinite_violation(run: Run, planner: Planner) -> None:
    planner.violations = {"goal": math.inf, "torque": 0.0}
    assert "violations     goal infinite, torque 0 (scaled)\n" in run(*PLAN).stdout


def test_report_of_infinite_velocity_limits_is_valid_json() -> None:
    arm = load_robot("planar3r", velocity=math.inf)
    problem = Problem(arm, np.array([0.5, 1.7, -1.7]), JointGoal(np.array([1, 1, 1.0])))
    solution = Solution(
        problem, Options(), Status.CONVERGED, "Done.", True, straight(problem)
    )
    data = report_data(solution, {})
    assert data["limited_share"] == 0.0
    json.dumps(data, allow_nan=False)


# Progress


def test_progress_on_a_terminal_shows_start_and_iteration() -> None:
    screen = StringIO()
    console = Console(file=screen, force_terminal=True, width=100)
    with Progress(console, quiet=False, verbose=False) as progress:
        progress.phase("loading [arm]")
        assert progress(record(12, start=1, duration=1.25, violation=3e-5)) is None
    shown = screen.getvalue()
    assert "planning: start 2, iteration 12, T 1.2500 s, violation 3.0e-05" in shown


def test_warning_is_printed_above_the_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = StringIO()
    console = Console(file=screen, force_terminal=True, width=100, color_system=None)
    monkeypatch.setattr("tominpmp.cli.terminal.error_console", lambda: console)
    with Progress(console, quiet=False, verbose=False) as progress, guarded():
        progress.phase("loading")
        warnings.warn("a start [1] was moved", TominpmpWarning, stacklevel=1)
    shown = screen.getvalue()
    assert "warning: a start [1] was moved\n" in shown
    assert re.search(r"loading[^\r\n]*warning", shown) is None
    assert shown.index("warning") < shown.rindex("loading")


def test_error_console_is_shared() -> None:
    assert error_console() is error_console()


@pytest.mark.parametrize("quiet", [True, False])
def test_progress_is_silent_in_files_and_with_quiet(
    quiet: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    log = StringIO()
    console = Console(file=log, force_terminal=quiet)
    with Progress(console, quiet=quiet, verbose=False) as progress:
        progress.phase("loading")
        progress(record(1))
    assert log.getvalue() == capsys.readouterr().err == ""


def test_progress_in_a_log_is_printed_every_three_seconds(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    console = Console(file=StringIO(), force_terminal=False)
    with Progress(console, quiet=False, verbose=True) as progress:
        for iteration in range(20):
            progress(record(iteration))
            now[0] += 0.5
    log = capsys.readouterr().err
    assert re.findall(r"iteration (\d+),.*\n", log) == ["6", "12", "18"]


def test_verbose_flag_shows_the_log(run: Run) -> None:
    few = ("--no-output", "--intervals", 10, "--planning-effort", "quick")
    result = run(*PLAN, "--verbose", *few)
    assert result.exit_code == 0
    assert re.search(r"^info: start 0: ", result.stderr, re.MULTILINE)
    again = run(*PLAN, *few)
    assert again.stderr == ""
