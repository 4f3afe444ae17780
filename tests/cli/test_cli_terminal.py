"""The terminal: fast imports, encodings, completion, hints and similar names."""

from __future__ import annotations

import ast
import importlib.metadata
import io
import re
import subprocess
import sys
from pathlib import Path

import pytest
from cli_samples import Run
from command_line import invoke

import tominpmp as tm
from tominpmp.cli.parser import new_app
from tominpmp.cli.terminal import say
from tominpmp.description.files import manipulators_first, robot_names

# Libraries that take more than a moment to import.
HEAVY = {"numpy", "scipy", "pinocchio", "coal", "yourdfpy", "trimesh", "matplotlib"}


@pytest.mark.parametrize(
    "program",
    [
        "import tominpmp",
        "import sys; sys.argv = ['tominpmp', '--help']; "
        "from tominpmp.cli import main\ntry: main()\nexcept SystemExit: pass",
        "import sys; sys.argv = ['tominpmp', '--version']; "
        "from tominpmp.cli import main\ntry: main()\nexcept SystemExit: pass",
    ],
    ids=["import", "--help", "--version"],
)
def test_import_and_help_load_no_heavy_library(program: str) -> None:
    shown = f"{program}\nimport sys; print(sorted({HEAVY!r} & {{*sys.modules}}))"
    done = subprocess.run(
        [sys.executable, "-c", shown], capture_output=True, text=True, check=True
    )
    assert ast.literal_eval(done.stdout.splitlines()[-1]) == []


def test_package_import_loads_only_the_standard_library() -> None:
    program = (
        "import sys; bare = set(sys.modules); import tominpmp; "
        "print(sorted({m.partition('.')[0] for m in set(sys.modules) - bare}))"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-c", program],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = set(ast.literal_eval(done.stdout)) - sys.stdlib_module_names
    assert found == {"tominpmp"}


@pytest.mark.parametrize("err", [False, True])
def test_output_is_encoded_for_its_own_stream(
    err: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: standard error was written in the encoding of standard output."""
    written = {name: io.BytesIO() for name in ("stdout", "stderr")}
    for name, encoding in (("stdout", "ascii"), ("stderr", "utf-8")):
        stream = io.TextIOWrapper(written[name], encoding)
        monkeypatch.setattr(sys, name, stream)
    say("Gelenk \u00e4", err=err)
    output = written["stderr" if err else "stdout"].getvalue()
    assert output == (b"Gelenk \xc3\xa4\n" if err else b"Gelenk \\xe4\n")


# Version 5 of cyclopts, for Python 3.11 and later, asks for the values of options.
needs_completion_of_values = pytest.mark.skipif(
    importlib.metadata.version("cyclopts").startswith("4."),
    reason="cyclopts 4, for Python 3.10, completes commands and options only",
)


def completed(*words: object, kind: str = "plan") -> list[str]:
    """Completions of the last word, as the script of a shell requests them."""
    shown = invoke(["__complete", kind, *words]).stdout
    return [line.split("\t")[0] for line in shown.split("begin\n")[1].splitlines()]


@needs_completion_of_values
def test_completion_of_robots_joints_states_and_groups(tmp_path: Path) -> None:
    assert "planar3r" in completed("plan")
    joints = ["joint1=", "joint2=", "joint3="]
    assert completed("planar3r", "--lock", "joint") == joints
    assert "start" in completed("planar3r", "--start", "s")
    srdf = tmp_path / "x.srdf"
    srdf.write_text('<robot name="r"><group name="arm"/><group name="hand"/></robot>')
    given = ("planar3r", "--srdf", srdf)
    assert completed(*given, "--group", "a") == ["arm", "hand"]
    for robot in ("nobody", "", tmp_path, "x\0"):
        assert completed(robot, "--lock", "") == []
        assert completed(robot, "--group", "") == []


@needs_completion_of_values
def test_completion_of_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("zz.urdf", "zz.toml", "zz.txt", ".zz.urdf"):
        Path(name).touch()
    Path("zzfolder").mkdir()
    Path("zzfolder/a.urdf").touch()

    def files(typed: str) -> list[str]:
        return [name for name in completed(typed) if name.startswith(typed)]

    assert files("zz") == ["zz.toml", "zz.urdf", "zzfolder/"]
    assert files("zzfolder/") == ["zzfolder/a.urdf"]
    assert files("nofolder/") == []
    assert files(f"{tmp_path}/zz.u") == [f"{tmp_path}/zz.urdf"]


@pytest.mark.parametrize("shell", ("bash", "zsh", "fish"))
def test_show_completion_prints_the_script_of_a_shell(
    shell: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SHELL", f"/bin/{shell}")
    shown = invoke(["--show-completion"])
    assert shown.exit_code == 0
    assert "tominpmp" in shown.stdout


@needs_completion_of_values
@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("plan planar3r --lock ", "joint2="),
        ("plan planar3r --goal-position ", "tip"),
        ("info planar", "planar3r"),
    ],
)
def test_completion_of_values_in_a_process(typed: str, expected: str) -> None:
    words = ["__complete", *typed.split(" ")]
    done = subprocess.run(
        [sys.executable, "-m", "tominpmp", *words], capture_output=True, text=True
    )
    assert expected in [line.split("\t")[0] for line in done.stdout.splitlines()]


def test_completion_script_names_commands_and_options() -> None:
    script = new_app().generate_completion(shell="bash")
    words = set(re.findall(r"[\w-]+", script))
    assert {"verify", "tour", "--goal-position"} <= words
    assert {"thorough", "datasheet", "quintic", "RobotTrajectory"} <= words


@pytest.mark.parametrize("start", [["4", "90", "-90"], ["0.5", "1.7", "-1.7"]])
def test_error_of_values_in_degrees_suggests_the_flag(
    start: list[str], run: Run
) -> None:
    words = ("plan", "planar3r", "--start", *start, "--goal", "90", "0", "0")
    result = run(*words)
    assert result.exit_code == 2
    assert "give radians, or add --degrees" in result.stderr
    assert "radians" not in run(*words[:-3], "9000", "0", "0", "--degrees").stderr


def test_error_of_radians_out_of_range_does_not_suggest_degrees(run: Run) -> None:
    start, goal = ["--start", "5", "1", "0"], ["--goal", "1", "1", "0"]
    result = run("plan", "planar3r", *start, *goal)
    assert result.exit_code == 2
    assert "position limits" in result.stderr
    assert "degrees" not in result.stderr


def test_unknown_name_suggests_similar_names() -> None:
    robot = tm.load_robot("planar3r")
    with pytest.raises(tm.FrameNotFound, match=r"\(did you mean tip\?\); the robot"):
        robot.frame_id("tipp")
    with pytest.raises(tm.JointNotFound, match=r"\(did you mean joint1") as told:
        tm.load_robot("planar3r", locked_joints={"jiont1": 0.0})
    assert told.value.field == "locked_joints"
    with pytest.raises(tm.FrameNotFound, match="'zzzzz'; the robot has"):
        robot.frame_id("zzzzz")
    with pytest.raises(tm.FrameNotFound, match="no frame 5; the robot has"):
        robot.frame_id(5)
    with pytest.raises(tm.SolverNotFound, match="did you mean highs"):
        raise tm.SolverNotFound("highspy", ["highs", "piqp"])


def test_robots_lists_manipulators_first(run: Run) -> None:
    names = ["anymal", "panda", "talos", "ur5_gripper", "zebra", "xarm7"]
    expected = ("panda", "ur5_gripper", "xarm7", "anymal", "talos", "zebra")
    assert manipulators_first(names) == expected
    assert run("robots").stdout.split()[0] == manipulators_first(robot_names())[0]
