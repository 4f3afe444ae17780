"""The core works without the folders of the add-ons."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import tominpmp

TESTS = Path(__file__).parent
SOURCE = Path(tominpmp.__file__).parent
ADD_ONS = ("app", "cell", "exact", "physics")
# Quick tests that plan, write and read files, verify motions and show the help.
SELECTION = (
    "unit/test_options.py",
    "unit/test_trajectory.py",
    "cli/test_cli_constraints.py",
)


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package, without the add-ons."""
    folder = tmp_path_factory.mktemp("core") / "src"

    def ignored(at: str, names: list[str]) -> set[str]:
        return set(ADD_ONS) & set(names) if Path(at) == SOURCE else set()

    shutil.copytree(SOURCE, folder / "tominpmp", ignore=ignored)
    robots = SOURCE.parents[1] / "robots"
    if robots.is_dir():  # of a checkout; an installed package contains the robots
        (folder.parent / "robots").symlink_to(robots)
    return folder


def run_python(core: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python with the copy in place of the package."""
    return subprocess.run(
        [sys.executable, *words],
        cwd=TESTS,
        env={**os.environ, "PYTHONPATH": str(core)},
        capture_output=True,
        text=True,
    )


def test_every_module_of_the_core_imports_without_add_ons(core: Path) -> None:
    program = (
        "import importlib, pkgutil, sys, tominpmp\n"
        "for item in pkgutil.walk_packages(tominpmp.__path__, 'tominpmp.'):\n"
        "    if item.name != 'tominpmp.__main__':\n"
        "        importlib.import_module(item.name)\n"
        "print(tominpmp.__file__, len([n for n in sys.modules if 'tominpmp.' in n]))"
    )
    done = run_python(core, "-c", program)
    assert done.returncode == 0, done.stderr
    file, count = done.stdout.split()
    assert Path(file).is_relative_to(core) and int(count) > 200


def test_commands_of_missing_add_ons_are_named_in_the_error(core: Path) -> None:
    shown = run_python(core, "-m", "tominpmp", "--help")
    assert shown.returncode == 0, shown.stderr
    names = {line.split()[0] for line in shown.stdout.splitlines() if line[:2] == "  "}
    assert {"plan", "verify", "play", "info", "robots"} <= names
    assert not {"batch", "replay", "app", "tour"} & names
    lacking = run_python(core, "-m", "tominpmp", "tour", "cell.toml")
    assert lacking.returncode == 2
    assert (
        "tour is a command of the add-on cell, which is not installed" in lacking.stderr
    )
    assert run_python(core, "-m", "tominpmp", "plan", "--help").returncode == 0


def test_tests_of_the_core_pass_without_add_ons(core: Path) -> None:
    words = ("-m", "pytest", "-q", "-x", "-p", "no:cacheprovider")
    done = run_python(core, *words, *SELECTION)
    assert done.returncode == 0, done.stdout[-3000:]
