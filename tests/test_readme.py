"""The README's examples run without changes, and its duration is that of a plan."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

import tominpmp as tm
from examples import payload
from tominpmp.description.files import robot_names

README = Path(__file__).parents[1] / "README.md"

pytestmark = [
    pytest.mark.skipif(
        "panda" not in robot_names(), reason="example-robot-data is not installed"
    ),
    pytest.mark.skipif(find_spec("meshcat") is None, reason="meshcat is not installed"),
]


def test_examples_run_and_write_their_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", README.read_text("utf-8"), re.DOTALL)
    assert len(blocks) == 4
    names: dict[str, Any] = {}
    exec(blocks[0], names)
    for file in ("motion.png", "motion.html", "motion.csv"):
        assert (tmp_path / file).stat().st_size > 1000
    exec(blocks[1], names)
    assert (tmp_path / "proof.png").stat().st_size > 1000
    problem = names["problem"]
    on_robot = dict(names, q_start=problem.q_start, goal=problem.goal)
    exec(blocks[2], on_robot)
    assert on_robot["solution"].success
    assert tm.check_export(on_robot["solution"], tmp_path / "goal.yaml").ok
    names["changed_problem"] = replace(problem, margin=0.5 * problem.margin)
    exec(blocks[3], names)
    assert names["quiet"].roughness < names["solution"].roughness
    assert names["again"].success
    assert names["cell"].problem is not None
    again = replace(problem, motion_limits=names["limits"], scene=tm.Scene())
    found = again.motion_limits.by_joint("acceleration", again.robot.joint_names)
    assert found.tolist() == [10.0] * again.robot.n


def test_duration_of_the_film_is_that_of_its_example() -> None:
    """Regression: the README said 0.67 s of a motion that by then took 0.62 s."""
    arm = tm.load_robot(
        "panda", limits="urdf", locked_joints={"panda_finger_joint1": 0.04}
    )
    problem = payload.problem(arm.with_payload(payload.box()))
    found = tm.plan(problem, tm.Options(intervals=20, seed=0))
    stated = re.search(r"in its hand: ([\d.]+) s", README.read_text("utf-8"))
    assert stated is not None
    assert stated[1] == f"{found.T:.2f}"
