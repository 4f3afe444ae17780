"""The flag `--constraint`: constraints along the motion."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_samples import PLAN, SCENARIO, Planner, Run

import tominpmp as tm
from tominpmp.cli.problem import constraint
from tominpmp.constraints.path import PathConstraint
from tominpmp.files.records import classes
from tominpmp.files.scenario import load_scenario

SPEED = "tool_speed:frame=tip:limit=2.5"


def test_constraints_reach_the_problem(run: Run, planner: Planner) -> None:
    cone = "keep_upright:frame=tip:axis=0 0 1:direction=0,0,1:tolerance=0.2"
    words = ("--constraint", SPEED, "--constraint", cone)
    result = run(*PLAN, *words, "--save-scenario", "s.toml")
    assert result.exit_code == 0, result.stderr
    upright = tm.KeepUpright("tip", (0, 0, 1), (0, 0, 1), tolerance=0.2)
    expected = (tm.ToolSpeed("tip", 2.5), upright)
    assert planner.problem.constraints == expected
    # The saved scenario has the same constraints.
    assert load_scenario("s.toml").problem.constraints == expected


def test_constraint_flag_adds_to_the_constraints_of_a_scenario(
    run: Run, planner: Planner
) -> None:
    slow = '[[constraints]]\ntype = "tool_speed"\nframe = "link2"\nlimit = 9.0\n'
    Path("s.toml").write_text(SCENARIO + slow)
    assert run("plan", "s.toml", "--constraint", SPEED).exit_code == 0
    slower = (tm.ToolSpeed("link2", 9.0), tm.ToolSpeed("tip", 2.5))
    assert planner.problem.constraints == slower


def test_every_constraint_class_has_a_text_form() -> None:
    kinds = classes(PathConstraint)
    assert {"tool_speed", "keep_upright"} <= set(kinds)
    speed = constraint("tool_speed:frame=7:limit=1")  # the name of a frame may be 7
    assert speed == tm.ToolSpeed("7", 1.0)
    coupling = constraint("joint_coupling:joints=joint1,joint2:weights=1,-2:upper=0.5")
    assert coupling == tm.JointCoupling(("joint1", "joint2"), (1.0, -2.0), 0.5)


def test_planned_motion_satisfies_its_tool_speed_constraint(run: Run) -> None:
    """The motion is planned with a limit, and verified with it and a lower limit."""
    words = ("--constraint", SPEED, "--intervals", 20, "-o", "m.csv")
    result = run(*PLAN, *words)
    assert result.exit_code == 0, (result.stdout, result.stderr)
    judge = ("verify", "planar3r", "m.csv", *PLAN[2:])
    assert run(*judge, "--constraint", SPEED).exit_code == 0
    found = run(*judge, "--constraint", SPEED.replace("2.5", "2"))
    assert found.exit_code == 1
    assert "speed of frame tip" in found.stdout


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tool_sped:frame=tip", "no kind 'tool_sped' (did you mean tool_speed"),
        ("tool_speed:frame=tip", "limit: is missing"),
        (
            "tool_speed:frame=tip:limits=1",
            "did you mean limit?); there are: during, frame, limit",
        ),
        ("tool_speed:frame=tip:limit=0", "limit: is 0.0, expected a positive number"),
        ("tool_speed:frame=nose:limit=1", "no frame 'nose'"),
        (
            "keep_upright:frame=tip:axis=0,0,0",
            "axis: is [0.0, 0.0, 0.0], expected three",
        ),
        ("", "there is no kind ''"),
    ],
)
def test_invalid_constraint_flag_is_an_error(
    text: str, message: str, run: Run, planner: Planner
) -> None:
    result = run(*PLAN, "--constraint", text)
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
    assert planner.problem is None
