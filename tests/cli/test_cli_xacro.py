"""The flag `--xacro-arg`, and the optional dependency on xacrodoc."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest
from cli_samples import Run

REPORT = Path(__file__).parents[1] / "reports" / "xacro_without_ros"
FILE = "my_arm_description/urdf/arm.urdf.xacro"


@pytest.fixture(autouse=True)
def files(tmp_path: Path) -> None:
    shutil.copytree(REPORT, tmp_path, dirs_exist_ok=True)


def test_xacro_arguments_have_the_syntax_of_ros(run: Run) -> None:
    pytest.importorskip("xacrodoc", reason="the extra xacro is not installed")
    assert run("info", FILE, "--xacro-arg", "reach:=0.5").exit_code == 0
    wrong = run("info", FILE, "--xacro-arg", "reach=0.5")
    assert wrong.exit_code == 2
    assert "--xacro-arg: got 'reach=0.5', expected NAME:=VALUE" in wrong.output
    unknown = run("info", FILE, "--xacro-arg", "rech:=0.5")
    assert unknown.exit_code == 2
    assert "did you mean reach" in unknown.output


def test_command_names_the_missing_extra_for_xacro_files(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    result = run("info", FILE)
    assert result.exit_code == 2
    assert "xacrodoc" in result.output
    assert "pip install 'tominpmp[xacro]'" in " ".join(result.output.split())
