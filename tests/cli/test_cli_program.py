"""The commands `robots`, `info` and `play`, and the program: exit codes and output."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from cli_samples import (
    PLAN,
    SCENARIO,
    Planner,
    Run,
    needs_panda,
)

from tominpmp.cli.app import run as run_words
from tominpmp.cli.report import robot_data
from tominpmp.description.files import robot_names
from tominpmp.exceptions import (
    TominpmpWarning,
)
from tominpmp.robot.robot import Robot


def test_robots_lists_the_known_robots(run: Run) -> None:
    result = run("robots")
    assert result.exit_code == 0
    assert sorted(result.stdout.split()) == sorted(robot_names())
    assert "planar3r" in result.stdout.split()


def test_info_shows_joints_limits_and_frames(run: Run) -> None:
    changes = ["--velocity", "joint2=inf", "--friction", "joint1=0.5"]
    result = run("info", "planar3r", *changes, "--lock", "joint3=1")
    assert result.exit_code == 0
    rows = [line.split() for line in result.stdout.splitlines()]
    assert ["joint1", "revolute", "0.18", "3", "100", "20", "5", "0", "0.5"] in rows
    assert ["joint2", "revolute", "-3", "3", "inf", "7", "3", "0", "0"] in rows
    assert ["locked", "joint3=1"] in rows
    assert ["group", "states", "start"] in rows
    assert ["collision", "3", "geometries"] in rows
    assert any(row[:1] == ["frames"] and row[-1] == "tip" for row in rows)


def test_info_prints_json(run: Run, slider: Robot) -> None:
    result = run("info", "slider.urdf", "--json")
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    assert data == robot_data(slider)
    slide, swing = data["joints"]
    assert (slide["name"], slide["kind"], slide["position_upper"]) == (
        "slide",
        "prismatic",
        2.0,
    )
    assert (swing["kind"], swing["position_lower"]) == ("continuous", None)
    assert data["group_states"] == {}
    assert data["collision_geometries"] == 0


def test_info_shows_the_robot_of_a_scenario(run: Run, tmp_path: Path) -> None:
    """Regression: the error said that the scenario file is not XML."""
    (tmp_path / "arm.toml").write_text(SCENARIO)
    result = run("info", "arm.toml")
    assert result.exit_code == 0, result.stderr
    assert result.stdout == run("info", "planar3r").stdout


def test_lock_and_group_flags_take_lists_of_joints(run: Run) -> None:
    locked = json.loads(
        run("info", "planar3r", "--json", "--lock", "joint2=0,joint3=1").stdout
    )
    assert locked["locked_joints"] == {"joint2": 0.0, "joint3": 1.0}
    for group, moving in (
        ("joint1,joint3", ["joint1", "joint3"]),
        ("base, link2", ["joint1", "joint2"]),
    ):
        chosen = json.loads(run("info", "planar3r", "--json", "--group", group).stdout)
        assert [joint["name"] for joint in chosen["joints"]] == moving


@needs_panda
def test_info_lists_mimic_joints_that_are_not_locked(run: Run) -> None:
    data = json.loads(run("info", "panda", "--json").stdout)
    assert data["mimic_joints"] == ["panda_finger_joint2"]
    locked = run("info", "panda", "--json", "--lock", "panda_finger_joint1=0.02")
    assert json.loads(locked.stdout)["mimic_joints"] == []


def test_play_writes_a_page(run: Run, planner: Planner) -> None:
    run(*PLAN, "-o", "a.csv")
    result = run("play", "a.csv", "--robot", "planar3r", "-o", "a.html")
    assert result.exit_code == 0, result.stderr
    assert result.stdout == "page  a.html\n"
    assert "planar3r: T = 2 s" in Path("a.html").read_text(encoding="utf-8")
    other = run("play", "a.csv", "--robot", "planar3r", "--lock", "joint3=0")
    assert other.exit_code == 2
    assert "a.csv: joint3: is up to 1.7 away from 0" in other.stderr


def test_play_suggests_lock_for_joints_missing_in_a_motion(
    run: Run, planner: Planner
) -> None:
    run(*PLAN, "-o", "a.csv")
    rows = [line.split(",") for line in Path("a.csv").read_text().splitlines()]
    kept = [k for k, name in enumerate(rows[0]) if not name.endswith("joint3")]
    text = "\n".join(",".join(row[k] for k in kept) for row in rows)
    Path("b.csv").write_text(text)
    lacking = run("play", "b.csv", "--robot", "planar3r", "-o", "a.html")
    assert lacking.exit_code == 2
    (flag,) = re.findall(r"give (--lock joint3=)\.\.\.", lacking.stderr)
    typed = f"{flag}0.5".split()
    shown = run("play", "b.csv", "--robot", "planar3r", *typed, "-o", "a.html")
    assert shown.exit_code == 0, shown.stderr
    stranger = run("play", "a.csv", "--robot", "ur5", "-o", "a.html")
    assert "--lock" not in stranger.stderr


def test_play_shows_a_motion_that_ends_in_an_obstacle(
    run: Run, planner: Planner
) -> None:
    run(*PLAN, "-o", "a.csv")
    ball = ("--obstacle", "sphere:ball:r=9:at=0,0,0")
    assert "start in collision" in run(*PLAN, *ball).stderr
    result = run("play", "a.csv", "--robot", "planar3r", *ball, "-o", "a.html")
    assert result.exit_code == 0, result.stderr
    assert "1 obstacle" in Path("a.html").read_text(encoding="utf-8")


def test_play_shows_a_motion_with_ends_beyond_limits(
    run: Run, planner: Planner
) -> None:
    """Regression: these motions were rejected, although users need to see them."""
    run(*PLAN, "-o", "a.csv")
    beyond = ("--position-upper", "1.5", "--velocity", "0.1", "--effort", "0.01")
    result = run("play", "a.csv", "--robot", "planar3r", *beyond, "-o", "a.html")
    assert result.exit_code == 0, result.stderr
    assert "planar3r: T = 2 s" in Path("a.html").read_text(encoding="utf-8")


# As a program


def program(*args: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tominpmp", *args],
        text=True,
        encoding="utf-8",
        **{"capture_output": True, **options},
    )


def on_a_full_disk(*args: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the program with a standard output that cannot be written."""
    with open("/dev/full", "w") as full:
        streams = {"capture_output": False, "stdout": full, "stderr": -1}
        return program(*args, **streams, **options)


@pytest.mark.skipif(sys.platform == "darwin", reason="names of files are UTF-8 there")
@pytest.mark.parametrize("encoding", ["ascii", "utf-8:strict"])
def test_info_escapes_file_names_that_a_terminal_cannot_show(
    encoding: str, tmp_path: Path
) -> None:
    """Regression: a report on a file with this name ended as an internal error."""
    arm = Path(__file__).parents[2] / "docs" / "static" / "arm.urdf"
    path = tmp_path / os.fsdecode(b"\xc3\xa4\xff.urdf")
    path.write_bytes(arm.read_bytes())
    env = {**os.environ, "PYTHONIOENCODING": encoding}
    result = program("info", str(path), env=env)
    assert (result.returncode, result.stderr) == (0, "")
    shown = "\\xe4" if encoding == "ascii" else "\xe4"
    assert f"{shown}\\udcff.urdf" in result.stdout


def test_python_module_runs_the_command() -> None:
    result = program("--help")
    assert result.returncode == 0
    assert result.stdout.startswith("Usage: tominpmp [OPTIONS] COMMAND [ARGS]...\n")
    assert result.stderr == ""


def test_python_module_returns_the_exit_code(tmp_path: Path) -> None:
    result = program("plan", "planar3r", "--start", "1", "--goal", "1", cwd=tmp_path)
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.startswith("error: --start has 1 number, expected 3")
    assert result.stderr.count("\n") == 1


@pytest.mark.skipif(os.name != "posix", reason="signals and pipes of POSIX")
@pytest.mark.parametrize("args", [["robots"], ["--help"], ["info", "planar3r"]])
def test_closed_pipe_ends_the_program_with_exit_code_141(args: list[str]) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        result = program(*args, capture_output=False, stdout=writer, stderr=-1)
    finally:
        os.close(writer)
    assert result.returncode == 141
    assert result.stderr == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("args", [["robots"], ["--help"], ["plan", "--help"]])
def test_full_standard_output_ends_with_exit_code_74(
    args: list[str], unbuffered: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    result = on_a_full_disk(*args)
    assert result.returncode == 74
    assert result.stderr == "error: standard output: No space left on device\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_full_disk_for_the_report_ends_with_exit_code_74(tmp_path: Path) -> None:
    words = "plan planar3r --start start --goal 2,-1,0.5 --planning-effort quick"
    words += " --refine none"
    result = on_a_full_disk(*words.split(), "-o", "m.csv", cwd=tmp_path)
    assert result.returncode == 74
    assert result.stderr == "error: standard output: No space left on device\n"
    assert [path.name for path in tmp_path.iterdir()] == ["m.csv"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_motion_for_a_full_standard_output_is_saved_elsewhere(tmp_path: Path) -> None:
    """Regression: the exit code was that of invalid input."""
    words = "plan planar3r --start start --goal 2,-1,0.5 --planning-effort quick"
    words += " --refine none -o -"
    result = on_a_full_disk(*words.split(), cwd=tmp_path)
    assert result.returncode == 74
    kept = tmp_path / result.stderr.rpartition("kept in ")[2].strip()
    assert kept.name == "motion.csv" and kept.stat().st_size > 1000
    assert "error: standard output: No space left on device; the" in result.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_full_standard_error_does_not_change_the_exit_code() -> None:
    with open("/dev/full", "w") as full:
        streams = {"capture_output": False, "stdout": full, "stderr": full}
        assert program("robots", **streams).returncode == 74
        assert program("info", "no.urdf", **streams).returncode == 2


QUICK = "plan planar3r --start start --goal 2,-1,0.5 --planning-effort quick"


def output_with(redirection: str, folder: Path, *words: str) -> str:
    """Run a command in a shell with a redirected standard error; returns its output."""
    command = shlex.join([sys.executable, "-m", "tominpmp", *words])
    result = subprocess.run(
        f"{command} {redirection}",
        shell=True,
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert result.returncode == 0
    return result.stdout


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("more", [(), ("--verbose",)])
def test_standard_error_that_cannot_be_written_leaves_the_motion_as_it_is(
    more: tuple[str, ...], tmp_path: Path
) -> None:
    """Regression: with ``2>&-`` the report was written into the motion, and on a full
    disk the exit code was that of wrong input.
    """
    words = [*QUICK.split(), "--refine", "none", "-o", "-"]
    expected = output_with("2>/dev/null", tmp_path, *words)
    for redirection in ("2>&-", "2>/dev/full"):
        assert output_with(redirection, tmp_path, *words, *more) == expected


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("words", ["info no.urdf", "info --no", QUICK])
def test_exit_codes_are_the_same_in_colour_on_a_full_standard_error(
    words: str, tmp_path: Path
) -> None:
    """Regression: what Rich could not write ended as a traceback with exit code 1."""
    coloured = {"cwd": tmp_path, "env": {**os.environ, "FORCE_COLOR": "1"}}
    with open("/dev/full", "w") as full:
        streams = {"capture_output": False, "stdout": -1, "stderr": full}
        result = program(*words.split(), **streams, **coloured)
    assert result.returncode == (0 if words == QUICK else 2)


def test_lines_of_the_log_are_not_broken_on_a_terminal(tmp_path: Path) -> None:
    """Regression: above a status line they were broken at the width of the terminal."""
    narrow = {**os.environ, "FORCE_COLOR": "1", "COLUMNS": "30"}
    result = program(*QUICK.split(), "--verbose", env=narrow, cwd=tmp_path)
    assert result.returncode == 0
    assert "info: start 0: A locally time-optimal motion was found." in result.stderr


@pytest.mark.skipif(os.name != "posix", reason="shells of POSIX")
def test_batch_runs_without_a_standard_error(tmp_path: Path) -> None:
    """Regression: loky cannot start a process then, which was called a defect."""
    (tmp_path / "arm.toml").write_text(SCENARIO)
    words = "batch arm.toml --quiet --planning-effort quick"
    assert "1 of 1" in output_with("2>&-", tmp_path, *words.split())


@pytest.mark.parametrize("words", [["--version"], ["--help"], ["plan", "--help"]])
def test_closed_standard_output_ends_with_exit_code_74(
    words: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Regression: a shell's ``>&-`` lost the motion, or the help of a command, and the
    exit code was 0.
    """
    monkeypatch.setattr(sys, "stdout", None)
    assert run_words(words) == 74
    assert capsys.readouterr().err == "error: standard output: Bad file descriptor\n"


def test_library_warnings_are_printed_with_python_w_error() -> None:
    """``-W error`` is meant for defects, not for warnings like a start on its limit."""
    program_text = (
        "import warnings; from tominpmp.cli.terminal import guarded\n"
        "from tominpmp.exceptions import TominpmpWarning\n"
        "with guarded(): warnings.warn('a [b] c', TominpmpWarning)\n"
    )
    result = subprocess.run(
        [sys.executable, "-W", f"error::{UserWarning.__name__}", "-c", program_text],
        capture_output=True,
        text=True,
    )
    assert (result.returncode, result.stderr) == (0, "warning: a [b] c\n")
    assert issubclass(TominpmpWarning, UserWarning)
