"""What is lacking is told of in flags, which can be copied as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from cli_samples import Run

from tominpmp.cli.terminal import as_command_line_flags

URDF = """<robot name="a"><link name="base"/><link name="arm"><inertial>
<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
</inertial></link><joint name="turn" type="continuous"><parent link="base"/>
<child link="arm"/><axis xyz="0 0 1"/></joint></robot>"""


def test_what_is_told_can_be_typed(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    told = run("info", path)
    assert told.exit_code == 2
    flags = re.findall(r"give (--\S+ \S+=\.\.\.)", told.stderr)
    assert flags == ["--effort turn=...", "--velocity turn=..."]
    words = " ".join(flags).replace("...", "5").split()
    assert run("info", path, *words).exit_code == 0


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (
            "give position_lower={'a': ..., 'b': ...} and position_upper={'a': ...}",
            "give --position-lower a=...,b=... and --position-upper a=...",
        ),
        ("and self_collision=False lets", "and --no-self-collision lets"),
        ("given in package_dirs", "given in --package-dir"),
        ("my_package_dirs", "my_package_dirs"),
        ("cell.toml: give effort={'a': 0}", "cell.toml: give effort={'a': 0}"),
        ("effort_scale=0.5", "effort_scale=0.5"),
    ],
)
def test_words(message: str, said: str) -> None:
    assert as_command_line_flags(message) == said


@pytest.mark.parametrize(
    ("message", "typed", "said"),
    [
        ("goal.q: joint a", "--goal 1", "--goal: joint a"),
        ("goal.pose is 0", "--goal-pose=t,0", "--goal-pose is 0"),
        (
            "start: the motion holds",
            "--start-from a.csv",
            "--start-from: the motion holds",
        ),
        (
            "effort_rate has 2 numbers",
            "--effort-rate=1,2",
            "--effort-rate has 2 numbers",
        ),
        ("effort: there is", "--planning-effort quick", "effort: there is"),
        ("cell.toml: goal.q: joint a", "--goal 1", "cell.toml: goal.q: joint a"),
    ],
)
def test_the_argument_at_fault_is_the_flag_that_was_typed(
    message: str, typed: str, said: str
) -> None:
    assert as_command_line_flags(message, typed.split()) == said
