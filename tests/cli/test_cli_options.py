"""Flags generated from the fields of Options, MotionLimits and Problem."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import pytest
from cli_samples import GOAL, PLAN, SCENARIO, START, Planner, Run, needs_panda
from command_line import invoke

from tominpmp.arrays import field_type
from tominpmp.cli.option_fields import (
    attribute_texts,
    fields_of,
    number,
    typed_values,
)
from tominpmp.cli.options import ProblemOptions
from tominpmp.cli.parser import new_app
from tominpmp.description.fields import parse_toml
from tominpmp.exceptions import ScenarioError
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import Options
from tominpmp.problem.problem import Problem
from tominpmp.scene.meshes import Mesh

if TYPE_CHECKING:
    from nowhere import Unknown

# Fields that cannot be typed as numbers, words, truth values, or values for each joint.
UNTYPED = {"callback", "initial_control", "effort_curves"}
# Fields whose flag has another name, as --effort gives torque limits.
RENAMED = {(Options, "effort"): "planning_effort"}


def flag_of(kind: type[Any], name: str) -> str:
    return f"--{RENAMED.get((kind, name), name).replace('_', '-')}"


def option_names(run: Run, *words: str) -> set[str]:
    return set(run(*words, "--help").stdout.replace(",", " ").split())


@pytest.mark.parametrize("kind", [Options, MotionLimits])
def test_fields_of_options_and_motion_limits_are_flags(
    kind: type[Any], run: Run
) -> None:
    flags = {flag_of(kind, f.name) for f in fields(kind) if f.name not in UNTYPED}
    assert flags <= option_names(run, "plan")
    assert {item.name for item in fields(kind)} <= set(attribute_texts(kind))
    absent = {f"--{name.replace('_', '-')}" for name in UNTYPED}
    assert not absent & option_names(run, "plan")


def test_fields_of_a_problem_are_flags() -> None:
    """A flag that may be repeated has the name of one item.

    Segments and the pairs that may touch are in scenario files alone.
    """
    elsewhere = {"robot", "q_start", "goal", "scene", "v_start", "a_start"}
    elsewhere |= {"segments", "may_touch"}
    options = {item.name for item in fields(ProblemOptions)}
    for item in fields(Problem):
        if item.init and item.name not in elsewhere:
            assert {item.name, item.name.removesuffix("s")} & options, item.name


VALUES: dict[str, Any] = {
    "method": "adjoint", "grid": "uniform", "control": "linear", "refine": "grid",
    "objective": "feasible", "step_rule": "paper", "lp_solver": "piqp", "slack": 0.5,
    "tolerance": 3e-3, "feasibility": 1e-5, "effort": "quick",
    "energy": "work",
}  # fmt: skip


def test_every_option_reaches_the_planner(run: Run, planner: Planner) -> None:
    given: dict[str, Any] = {}
    for item in fields(Options):
        if item.name not in UNTYPED:
            kind = getattr(field_type(Options, item.name), "__origin__", None)
            whole = int in (kind, *get_args(kind))
            given[item.name] = VALUES.get(item.name, 7 if whole else 0.25)
    words = [
        word
        for name, value in given.items()
        for word in (flag_of(Options, name), value)
    ]
    result = run(*PLAN, *words, "--no-output")
    assert result.exit_code == 0, result.stderr
    for name, value in given.items():
        if name != "max_planning_time":  # the time of loading is subtracted
            assert getattr(planner.options, name) == value, name


@dataclass
class Later:
    """A record whose fields are declared nowhere else.

    Attributes:
        colour: What the next version knows,
            see :class:`~tominpmp.nowhere.Colour`.
        count: How ``many``; None for any.

        maybe: Whether, or the planner chooses.
        share: Of what.
        really: Whether at all.
        others: What cannot be typed.
        nothing: Nor this.
    """

    colour: Literal["red", "blue"] = "red"
    count: int | None = None
    maybe: bool | None = None
    made: str = field(default_factory=str)
    share: float = 0.5
    really: bool = True
    others: list[int] | None = None
    nothing: Unknown | None = None


def test_new_field_of_a_record_becomes_a_flag_with_its_text(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    option_fields = fields_of(Later, "Planning")
    received: list[Any] = []

    defaults = option_fields()

    def show(*, later: Any = defaults) -> int:
        received.append(typed_values(later))
        return 3

    show.__annotations__["later"] = option_fields
    app = new_app()
    app.command(show)
    monkeypatch.setattr("tominpmp.cli.parser.new_app", lambda: app)
    text = " ".join(invoke(["show", "--help"]).stdout.split())
    assert "--colour NAME What the next version knows. Default: red." in text
    assert "--count N How many; none for any." in text
    assert "--share NUMBER Of what. Default: 0.5." in text
    assert "--really, --no-really Whether at all. Default: True." in text
    assert "--maybe, --no-maybe Whether, or the planner chooses. --" in text
    assert "--made NAME --" in text  # the field has no description
    assert "others" not in text and "nothing" not in text
    words = ["show", "--colour", "blue", "--count", "none", "--no-really", "--maybe"]
    assert invoke(words).exit_code == 3
    typed = {"colour": "blue", "count": None, "really": False, "maybe": True}
    assert received.pop() == typed
    invoke(["show"])
    assert received.pop() == {}
    wrong = invoke(["show", "--count", "many"])
    assert wrong.exit_code == 2 and not received


def test_value_none_overrides_an_option_of_the_scenario(
    run: Run, planner: Planner
) -> None:
    Path("s.toml").write_text(SCENARIO + 'refine = "grid"\nstarts = 3\n')
    assert run("plan", "s.toml").exit_code == 0
    assert (planner.options.refine, planner.options.starts) == ("grid", 3)
    words = ("--refine", "none", "--starts", "none")
    assert run("plan", "s.toml", *words).exit_code == 0
    assert (planner.options.refine, planner.options.starts) == (None, None)
    result = run("plan", "s.toml", "--starts", "1.5")
    assert result.exit_code == 2
    assert "--starts is '1.5', expected a whole number or none" in result.stderr


def test_motion_limit_flags_override_files_and_scenarios(
    run: Run, planner: Planner
) -> None:
    words = ("--acceleration", 9, 8, 7, "--jerk", "joint2=50", "--effort-scale", 0.9)
    assert run(*PLAN, *words).exit_code == 0
    limits = planner.problem.motion_limits
    names = planner.problem.robot.joint_names
    assert limits.by_joint("acceleration", names).tolist() == [9.0, 8.0, 7.0]
    assert limits.by_joint("jerk", names).tolist() == [np.inf, 50.0, np.inf]
    assert limits.effort_scale == 0.9
    # Flags override a file of limits, which overrides a scenario.
    Path("s.toml").write_text(
        SCENARIO + "[motion_limits]\njerk = 5\nacceleration = 4\n"
    )
    Path("more.yaml").write_text("acceleration: 3\neffort_rate: 2\n")
    words = ("--motion-limits", "more.yaml", "--effort-rate", 1)
    assert run("plan", "s.toml", *words).exit_code == 0
    limits = planner.problem.motion_limits
    for name, value in (("jerk", 5), ("acceleration", 3), ("effort_rate", 1)):
        assert limits.by_joint(name, names).tolist() == [value] * 3
    words = ("--motion-limits", "more.yaml", "--acceleration", "none")
    assert run(*PLAN, *words).exit_code == 0
    limits = planner.problem.motion_limits
    assert limits.acceleration is None and limits.effort_rate is not None
    wrong = run(*PLAN, "--jerk", "elbow=3")
    assert wrong.exit_code == 2 and "no joint 'elbow'" in wrong.stderr


def test_position_limit_and_self_collision_flags_reach_the_problem(
    run: Run, planner: Planner
) -> None:
    words = ("--position-upper", "joint1=2.5", "--no-self-collision")
    assert run(*PLAN, *words).exit_code == 0
    assert planner.problem.robot.limits.position_upper[0] == 2.5
    assert planner.problem.self_collision is False
    assert run(*PLAN, "--self-collision").exit_code == 0
    assert planner.problem.self_collision is True
    assert run(*PLAN).exit_code == 0
    assert planner.problem.self_collision is None


@pytest.mark.parametrize(
    ("old", "new", "refused", "words"),
    [
        ("0.01", "9", "start: in collision", ("--margin", "0.01")),
        (
            '"planar3r"',
            '"planar3r"\nkinematic = true',
            "no acceleration limit",
            ("--acceleration", "3"),
        ),
    ],
)
def test_scenario_is_checked_after_its_changes_by_flags(
    run: Run, planner: Planner, old: str, new: str, refused: str, words: tuple[str, str]
) -> None:
    Path("s.toml").write_text(SCENARIO.replace(old, new))
    unchanged = run("plan", "s.toml", "--no-output")
    assert unchanged.exit_code == 2 and refused in unchanged.stderr
    found = run("plan", "s.toml", *words, "--no-output")
    assert (found.exit_code, found.stderr) == (0, "")
    wrong = run("plan", "s.toml", "--margin", "-1")
    assert wrong.stderr.startswith(
        "error: --margin is -1.0, expected a finite number >= 0"
    )


FOLDED = [0.0, -1.2, 2.9, 0.0, 0.0, 0.0]
LINKS_MEET = f"""
[robot]
name = "ur5"
[start]
q = {FOLDED}
[goal]
type = "any"
goals = [{{type = "joint", q = {FOLDED}}}, {{type = "joint", q = {[0.1] * 6}}}]
"""


@needs_panda
def test_no_self_collision_flag_allows_links_to_touch_at_both_ends(
    run: Run, planner: Planner
) -> None:
    Path("s.toml").write_text(LINKS_MEET)
    assert "start: in collision" in run("plan", "s.toml", "--no-output").stderr
    found = run("plan", "s.toml", "--no-output", "--no-self-collision")
    assert (found.exit_code, found.stderr) == (0, "")
    assert len(planner.problem.alternatives) == 2


def test_obstacle_flag_takes_a_mesh(run: Run, planner: Planner, tmp_path: Path) -> None:
    corners = ("0 0 0", "1 0 0", "0 1 0", "0 0 1")
    faces = ("1 2 3", "1 2 4", "1 3 4", "2 3 4")
    lines = [f"v {c}" for c in corners] + [f"f {f}" for f in faces]
    (tmp_path / "tent.obj").write_text("\n".join(lines) + "\n")
    words = ("--obstacle", "mesh:tent:path=tent.obj:scale=0.1:convex=hull:at=0,9,0")
    result = run(*PLAN, *words)
    assert result.exit_code == 0, result.stderr
    (tent,) = planner.problem.scene
    assert isinstance(tent, Mesh)
    assert tent.convex == "hull"
    np.testing.assert_array_equal(tent.scale, 0.1)
    lacking = run(*PLAN, "--obstacle", "mesh:tent:at=0,9,0")
    assert lacking.exit_code == 2 and "tent" in lacking.stderr


def test_verify_uses_the_torque_limits_of_the_flags(run: Run) -> None:
    """The motion passes with the flags of its plan, and fails with weaker motors."""
    words = ("planar3r", "--start", START, "--goal", GOAL, "--effort", "30,15,15")
    assert run("plan", *words, "--intervals", 10, "-o", "m.csv").exit_code == 0
    good = run("verify", "planar3r", "m.csv", *words[1:])
    assert good.exit_code == 0, (good.stdout, good.stderr)
    weak = run("verify", "planar3r", "m.csv", *words[1:5], "--effort", "29,8,4")
    assert weak.exit_code == 1
    assert "effort limit" in weak.stdout


def test_verify_uses_the_goal_tolerance_of_the_flag(run: Run) -> None:
    words = ("planar3r", "--start", START, "--goal", GOAL)
    few = ("--intervals", 10, "--planning-effort", "quick", "--refine", "none")
    assert run("plan", *words, *few, "-o", "m.csv").exit_code == 0
    off = ("verify", "planar3r", "m.csv", "--start", START, "--goal", "2,-1,0.52")
    assert run(*off).exit_code == 1
    assert run(*off, "--goal-tolerance", 0.03).exit_code == 0
    # The flag overrides the tolerance of a scenario.
    Path("s.toml").write_text(SCENARIO)
    assert run("plan", "s.toml", *few, "-o", "m.csv").exit_code == 0
    goal = "q = [2.0, -1.0, 0.5]"
    text = SCENARIO.replace(goal, "q = [2.0, -1.0, 0.52]") + "goal_tolerance = 0.03\n"
    Path("s.toml").write_text(text)
    assert run("verify", "s.toml", "m.csv").exit_code == 0
    assert run("verify", "s.toml", "m.csv", "--goal-tolerance", 0.01).exit_code == 1
    assert "--seed" not in option_names(run, "verify")


@pytest.mark.parametrize("word", ["1_000", "1_0.5", "1__0", "_1", "1_", "+2e3"])
def test_numbers_have_the_syntax_of_scenario_files(word: str) -> None:
    try:
        written = parse_toml(f"x = {word}".encode(), Path("a.toml")).value["x"]
    except ScenarioError:
        written = None
    assert number(word) == written
