"""Messages of the library are shown with the flags of the command line."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from cli_samples import PLAN, SCENARIO, Planner, Run

from tominpmp.cli.terminal import as_command_line_flags

URDF = """<robot name="a"><link name="base"/><link name="arm"><inertial>
<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
</inertial></link><joint name="turn" type="continuous"><parent link="base"/>
<child link="arm"/><axis xyz="0 0 1"/></joint></robot>"""


def test_flags_suggested_by_an_error_can_be_copied(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    result = run("info", path)
    assert result.exit_code == 2
    flags = re.findall(r"give (--\S+ \S+=\.\.\.)", result.stderr)
    assert flags == ["--effort turn=...", "--velocity turn=..."]
    words = " ".join(flags).replace("...", "5").split()
    assert run("info", path, *words).exit_code == 0


def test_remarks_on_a_plan_name_flags_or_keys(
    run: Run, planner: Planner, tmp_path: Path
) -> None:
    """A status message advised ``locked_joints`` where the flag is ``--lock``."""
    planner.remark = "Lock it (locked_joints). max_iterations allows more."
    told = run(*PLAN, "--no-output").stdout
    assert "Lock it (--lock). --max-iterations allows more." in told
    (tmp_path / "s.toml").write_text(SCENARIO)
    assert planner.remark in run("plan", "s.toml", "--no-output").stdout


@pytest.mark.parametrize(
    ("message", "expected"),
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
def test_arguments_in_a_message_become_flags(message: str, expected: str) -> None:
    assert as_command_line_flags(message) == expected


@pytest.mark.parametrize(
    ("message", "typed", "expected"),
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
        ("constraints[1]: no frame", "--constraint k", "--constraint: no frame"),
        ("cell.toml: goal.q: joint a", "--goal 1", "cell.toml: goal.q: joint a"),
    ],
)
def test_message_names_the_flag_that_the_user_typed(
    message: str, typed: str, expected: str
) -> None:
    assert as_command_line_flags(message, typed.split()) == expected
