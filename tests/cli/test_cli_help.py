"""The help of the command line: commands, options, examples, and fast display."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from importlib.metadata import version

import pytest
from cli_samples import (
    Judge,
    Planner,
    Run,
    needs_panda,
)

from tominpmp.cli.front import COMMANDS, EXAMPLES
from tominpmp.options import CHOICES


def test_help_names_every_command_on_one_line(run: Run) -> None:
    result = run("--help")
    assert result.exit_code == 0
    assert "Plan time-optimal motions of robot arms" in result.stdout
    expected = {"plan", "batch", "tour", "verify", "replay", "play", "app"}
    expected |= {"info", "robots"}
    assert set(COMMANDS) == expected
    for name in expected:
        line = re.search(rf"^  {name} .*\.$", result.stdout, re.MULTILINE)
        assert line is not None, name
        assert "..." not in line[0]
    assert all(len(line) <= 90 for line in result.stdout.splitlines())


def test_program_without_a_command_shows_its_help(run: Run) -> None:
    assert run().stdout == run("--help").stdout
    assert run("-h").stdout == run("--help").stdout


def test_help_of_plan_groups_all_options(run: Run) -> None:
    text = run("plan", "--help").stdout
    groups = re.findall(r"^(\w+):$", text, re.MULTILINE)
    assert groups == [
        "Arguments",
        "Motion",
        "Scene",
        "Robot",
        "Planning",
        "Output",
        "General",
        "Examples",
    ]
    for name in (*CHOICES["method"], "highs", "piqp"):
        assert re.search(rf"\b{name}\b", text), name
    for code in (0, 1, 2, 130):
        assert re.search(rf"^    {code} +\w", text, re.MULTILINE), code
    assert " plan [OPTIONS] ROBOT\n" in text


@pytest.mark.parametrize("width", ["60", "80"])
def test_descriptions_are_wrapped_at_the_width_of_the_terminal(
    run: Run, width: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: lines ended where they end in the source, and at the edge as well."""
    monkeypatch.setenv("COLUMNS", width)
    for name in ("app", "batch", "plan"):
        _, _, paragraph, *_ = run(name, "--help").stdout.split("\n\n")
        *lines, _ = paragraph.splitlines()
        assert all(int(width) - 15 < len(line) < int(width) for line in lines), name


def examples() -> list[list[str]]:
    """The examples of the help, as lists of words."""
    lines = EXAMPLES.replace("\\\n", " ").splitlines()
    return [shlex.split(line)[1:] for line in lines if line.startswith("  tominpmp")]


@needs_panda
@pytest.mark.parametrize("words", examples(), ids=" ".join)
def test_examples_of_the_help_run(
    words: list[str], run: Run, planner: Planner, judge: Judge, files: None
) -> None:
    result = run(*words)
    assert result.exit_code == 0, result.stderr
    assert result.stdout


def test_help_shows_every_example_verbatim(run: Run) -> None:
    shown = run("--help").stdout, run("plan", "--help").stdout
    for line in EXAMPLES.splitlines():
        assert all(line in text for text in shown)


def test_version_flag_prints_the_installed_version(run: Run) -> None:
    result = run("--version")
    assert result.exit_code == 0
    assert result.stdout == f"tominpmp {version('tominpmp')}\n"


HEAVY = ("pinocchio", "coal", "scipy", "matplotlib", "meshcat", "highspy", "yaml")


@pytest.mark.parametrize("words", [["--help"], ["plan", "--help"], ["plan", "--nay"]])
def test_help_imports_no_heavy_library(words: list[str]) -> None:
    """Help, and the error of an unknown option, need no robotics library."""
    program = (
        "import sys; from tominpmp.cli.app import run\n"
        f"try: run({words!r})\n"
        f"finally: print(sorted(set({HEAVY!r}) & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=600
    )
    assert done.stderr.splitlines()[-1] == "[]"
