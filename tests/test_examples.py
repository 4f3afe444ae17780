"""The examples run, and their scripts and scenarios agree."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import tominpmp as tm
from tominpmp.description.files import robot_names

EXAMPLES = Path(__file__).parents[1] / "examples"

needs_robots = pytest.mark.skipif(
    "panda" not in robot_names(),
    reason="example-robot-data is not installed",
)
needs_meshcat = pytest.mark.skipif(
    find_spec("meshcat") is None, reason="meshcat is not installed"
)


def output_of(name: str, *arguments: str | Path) -> str:
    """The output that an example prints."""
    command = [sys.executable, EXAMPLES / f"{name}.py", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout


@needs_robots
@needs_meshcat
def test_ur5_post_example_proves_its_clearance(tmp_path: Path) -> None:
    assert "Proved: " in output_of("ur5_post", "--out", tmp_path)
    problem = tm.load_scenario(EXAMPLES / "scenarios" / "ur5_post.toml").problem
    motion = tm.load_motion(tmp_path / "ur5_post.csv")
    assert tm.verify(problem, motion).ok
    for ending in ("png", "html"):
        assert (tmp_path / f"ur5_post.{ending}").stat().st_size > 10_000


@needs_robots
@needs_meshcat
def test_pick_and_place_example_writes_a_verified_motion(tmp_path: Path) -> None:
    assert "segment 7: " in output_of("pick_and_place", "--out", tmp_path)
    problem = tm.load_scenario(EXAMPLES / "scenarios" / "pick_and_place.toml").problem
    motion = tm.load_motion(tmp_path / "pick_and_place.csv")
    assert tm.verify(problem, motion).ok
    for ending in ("png", "html"):
        assert (tmp_path / f"pick_and_place.{ending}").stat().st_size > 10_000


@needs_robots
@needs_meshcat
@pytest.mark.parametrize(
    ("name", "printed"),
    [("seam", "speed on the seam"), ("handing_over", "both at the bar after")],
)
def test_segment_examples_print_their_results(
    name: str, printed: str, tmp_path: Path
) -> None:
    assert printed in output_of(name, "--out", tmp_path)
    for ending in ("png", "html"):
        assert (tmp_path / f"{name}.{ending}").stat().st_size > 10_000


@needs_robots
@needs_meshcat
def test_spot_weld_example_writes_a_cycle(tmp_path: Path) -> None:
    printed = output_of("spot_weld", "--out", tmp_path, "--spots", "3")
    assert "cycle " in printed and "of which welding 1.05 s" in printed
    assert all(f"weld {number}" in printed for number in (1, 2, 3))
    for ending in ("png", "html", "csv"):
        assert (tmp_path / f"spot_weld.{ending}").stat().st_size > 10_000


@needs_meshcat
def test_certificate_example_accepts_and_rejects_motions(tmp_path: Path) -> None:
    output = output_of("certificate", "--out", tmp_path)
    assert "The motion satisfies the first-order conditions" in output
    assert "does not satisfy the first-order conditions" in output
    assert (tmp_path / "certificate.png").stat().st_size > 10_000


HELP = """
import runpy, sys
from pathlib import Path
paths = sys.argv[1:]
sys.path.insert(0, str(Path(paths[0]).parent))
for path in paths:
    print("EXAMPLE", Path(path).stem)
    sys.argv = [path, "--help"]
    try:
        runpy.run_path(path, run_name="__main__")
    except SystemExit as end:
        assert not end.code, path
"""


def test_every_example_has_a_help_text() -> None:
    """All examples run in one process: starting a process takes longer than showing the
    help.
    """
    paths = sorted(str(path) for path in EXAMPLES.glob("*.py"))
    done = subprocess.run(
        [sys.executable, "-c", HELP, *paths],
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr
    _, *helps = done.stdout.split("EXAMPLE ")
    assert len(helps) == len(paths)
    for text in helps:
        assert "--out" in text, text


@needs_robots
@pytest.mark.parametrize(
    "path", sorted((EXAMPLES / "scenarios").glob("*.toml")), ids=lambda path: path.stem
)
def test_example_scenarios_load(path: Path) -> None:
    scenario = tm.load_scenario(path)
    assert scenario.problem.robot.n > 0


@needs_robots
@pytest.mark.parametrize("name", ["ur5_post", "swinging_gate", "pick_and_place"])
def test_example_script_and_scenario_are_the_same_problem(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    script = import_module(name)
    assert tm.load_scenario(EXAMPLES / "scenarios" / f"{name}.toml").problem == (
        script.problem()
    )
