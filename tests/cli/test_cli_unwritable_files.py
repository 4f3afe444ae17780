"""A motion that cannot be written to its file is saved in another folder."""

from __future__ import annotations

import errno
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from cli_samples import GOAL, PLAN, START, Planner, Run

import tominpmp as tm


class FullDisk:
    """Writing below a folder fails, after the file was created."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.sync = folder.resolve(), os.fsync
        monkeypatch.setattr(os, "fsync", self)

    def __call__(self, handle: int) -> None:
        path = Path(os.readlink(f"/proc/self/fd/{handle}"))
        if path.is_relative_to(self.folder):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.sync(handle)


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc")
def test_motion_for_a_full_disk_is_saved_in_the_temporary_folder(
    run: Run, planner: Planner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full, other = tmp_path / "full", tmp_path / "other"
    full.mkdir()
    other.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(other))
    monkeypatch.chdir(full)
    FullDisk(full, monkeypatch)
    result = run(*PLAN, "-o", full / "motion.npz")
    assert result.exit_code == 2
    assert "No space left on device" in result.output
    kept = Path(re.search(r"kept in (\S+)", result.output).group(1))
    assert kept.is_relative_to(other)
    assert tm.load_motion(kept).q.shape[1] == 3
    assert not list(full.iterdir())
    assert "planning time" in result.output  # the report is printed as well


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc")
def test_command_reports_that_the_motion_is_saved_nowhere(
    run: Run, planner: Planner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    FullDisk(tmp_path, monkeypatch)
    (tmp_path / "a").mkdir()
    result = run(*PLAN, "-o", tmp_path / "a" / "motion.csv")
    assert result.exit_code == 2
    assert "not saved elsewhere" in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_motion_with_too_many_samples_is_saved_elsewhere(
    run: Run, planner: Planner
) -> None:
    result = run(*PLAN, "-o", "motion.csv", "--dt", "1.5e-7")
    assert result.exit_code == 2
    assert "too small for a motion of 2 s" in result.output
    kept = re.search(r"kept in (\S+)", result.output).group(1)
    assert tm.load_motion(kept).t[-1] == 2.0


@pytest.mark.skipif(os.name == "nt", reason="no such limit")
def test_file_size_limit_leaves_no_partial_file(tmp_path: Path) -> None:
    script = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (500, 500));"
        "from tominpmp.cli import main; main()"
    )
    command = ["plan", "planar3r", "--start", START, "--goal", GOAL, "-o", "m.csv"]
    command += ["--planning-effort", "quick", "--refine", "none"]
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.argv[1:] = {command!r}\n{script}"],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=900,
        env={**os.environ, "TMPDIR": str(tmp_path), "TOMINPMP_CACHE": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 2
    assert "File too large" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())
