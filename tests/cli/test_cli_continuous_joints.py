"""The flag `--wrap` and the key `goal.wrap`: joints of a goal that are angles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cli_samples import Run

FILE = Path(__file__).parents[1] / "reports" / "continuous_across_pi" / "robot.urdf"
SCENARIO = f"""
start = {{q = [3.0, 0.1]}}
robot = {{path = {str(FILE)!r}}}
goal = {{type = "joint", q = [-3.0, 0.4], wrap = WRAP}}
"""


def final_angle(file: Path) -> float:
    return float(np.loadtxt(file, delimiter=",", skiprows=1)[-1, 1])


@pytest.mark.parametrize(("words", "expected"), [("none", -3.0), ("j2", 3.28319)])
def test_wrap_flag_selects_the_joints_that_are_angles(
    run: Run, tmp_path: Path, words: str, expected: float
) -> None:
    ends = ["--start", "3.0", "0.1", "--goal", "-3.0", "0.4"]
    found = run("plan", str(FILE), *ends, "--wrap", words, "-o", "out.csv")
    assert found.exit_code == 0
    assert final_angle(tmp_path / "out.csv") == pytest.approx(expected, abs=1e-4)


def test_wrap_flag_with_an_unknown_joint_is_an_error(run: Run) -> None:
    ends = ["--start", "3.0", "0.1", "--goal", "-3.0", "0.4"]
    found = run("plan", str(FILE), *ends, "--wrap", "j2,j9")
    assert found.exit_code == 2
    assert "j9" in found.output


@pytest.mark.parametrize(("wrap", "expected"), [("false", -3.0), ("true", 3.28319)])
def test_wrap_key_of_a_scenario_is_used(
    run: Run, tmp_path: Path, wrap: str, expected: float
) -> None:
    (tmp_path / "s.toml").write_text(SCENARIO.replace("WRAP", wrap))
    found = run("plan", "s.toml", "-o", "out.csv")
    assert found.exit_code == 0, found.output
    assert final_angle(tmp_path / "out.csv") == pytest.approx(expected, abs=1e-4)


def test_invalid_wrap_key_is_named_in_the_error(run: Run, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(SCENARIO.replace("WRAP", "3"))
    found = run("plan", "s.toml")
    assert found.exit_code == 2
    assert "goal.wrap" in found.output
    assert "expected True, False or names of joints" in found.output
