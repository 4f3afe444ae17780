"""CI workflows name existing make targets, jobs, files and Python versions."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))


def jobs(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(path.read_text("utf-8"))["jobs"]
    return found


def commands(path: Path) -> list[str]:
    steps = [step for job in jobs(path).values() for step in job["steps"]]
    return [step["run"] for step in steps if "run" in step]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_steps_name_existing_targets_jobs_and_files(path: Path) -> None:
    every = "\n".join(commands(path))
    named_targets = set(re.findall(r"\bmake ([a-z-]+)", every))
    assert named_targets <= TARGETS
    for name, job in jobs(path).items():
        needs = job.get("needs", [])
        assert {needs} if isinstance(needs, str) else set(needs) <= set(jobs(path)), (
            name
        )
        assert job["runs-on"] and job["steps"]
        for step in job["steps"]:
            assert ("run" in step) != ("uses" in step)
            # Actions are named with a version: a branch may change at any time.
            assert re.search(r"@(v\d|release/v\d)", step.get("uses", "@v1"))
    # Lock files that are keys of caches exist.
    for file in re.findall(r"[\w/]*requirements\.lock", path.read_text("utf-8")):
        assert (ROOT / file).is_file()


def test_every_declared_python_version_is_tested() -> None:
    matrix = jobs(ROOT / ".github/workflows/ci.yml")["test"]["strategy"]["matrix"]
    classed = re.findall(r"Python :: (3\.\d+)", (ROOT / "pyproject.toml").read_text())
    assert matrix["python"] == classed
    assert {name.partition("-")[0] for name in matrix["os"]} == {"ubuntu", "macos"}


def test_job_passed_needs_all_other_jobs() -> None:
    found = jobs(ROOT / ".github/workflows/ci.yml")
    assert set(found["passed"]["needs"]) == set(found) - {"passed"}
