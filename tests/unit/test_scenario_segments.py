"""Segments in scenario files: reading, writing, and messages about mistakes."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from command_line import invoke

import tominpmp as tm
from tominpmp.cli.report import json_text, report_data, report_text
from tominpmp.description.fields import tomllib
from tominpmp.files.export_check import check_file
from tominpmp.viz.skeleton import end_frame

START = np.array([0.5, 1.7, -1.7])
MIDDLE = np.array([1.2, 0.6, -0.6])
END = np.array([2.0, -1.0, 0.5])
FAR: dict[str, Any] = {"position": [0.0, 0.0, 9.0]}
BALL = tm.Sphere("ball", radius=0.1, **FAR)

SMALL = """
[robot]
name = "planar3r"
[start]
q = [0.5, 1.7, -1.7]
"""
FIRST = """
[[segments]]
goal = {type = "joint", q = [1.2, 0.6, -0.6]}
"""
LAST = """
[[segments]]
goal = {type = "joint", q = [2.0, -1.0, 0.5]}
"""


@pytest.fixture(scope="module")
def arm() -> tm.Robot:
    return tm.load_robot("planar3r")


def at(q: Any, **changes: Any) -> tm.Segment:
    return tm.Segment(tm.JointGoal(q), **changes)


def problem_of(arm: tm.Robot, *segments: tm.Segment, **changes: Any) -> tm.Problem:
    return tm.Problem(arm, START, segments=segments, **changes)


def round_trip(problem: tm.Problem, folder: Path) -> dict[str, Any]:
    """Save, load and save a problem again, which must change nothing; returns the
    table.
    """
    path = tm.save_scenario(folder / "a.toml", problem)
    found = tm.load_scenario(path).problem
    assert found == problem
    assert found.segments == problem.segments
    assert len(found.phases) == len(problem.phases)
    saved_again = tm.save_scenario(folder / "b.toml", found)
    assert saved_again.read_text(encoding="utf-8") == path.read_text(encoding="utf-8")
    return tomllib.loads(path.read_text(encoding="utf-8"))


def loaded(folder: Path, text: str) -> tm.Problem:
    path = folder / "s.toml"
    path.write_text(SMALL + text, encoding="utf-8")
    return tm.load_scenario(path).problem


def refused(folder: Path, text: str) -> tm.ScenarioError:
    with pytest.raises(tm.ScenarioError) as caught:
        loaded(folder, text)
    return caught.value


# -- saving and loading ----------------------------------------------------------------


def test_saved_plain_segments_have_only_their_goals(
    arm: tm.Robot, tmp_path: Path
) -> None:
    document = round_trip(problem_of(arm, at(MIDDLE), at(END)), tmp_path)
    assert document == {
        "robot": {"name": "planar3r"},
        "start": {"q": START.tolist()},
        "segments": [
            {"goal": {"type": "joint", "q": MIDDLE.tolist()}},
            {"goal": {"type": "joint", "q": END.tolist()}},
        ],
    }


@pytest.mark.parametrize(
    "changes",
    [
        {"stop": True},
        {"dwell": 0.1 + 0.2},
        {"stop": True, "dwell": 0.25},
        {"scene": tm.Scene()},
        {"scene": tm.Scene([BALL, tm.Box("box", size=[0.1, 0.2, 0.3], **FAR)])},
        {"scene": tm.Scene([BALL]), "may_touch": [("link1", "ball"), ("ball", "tip")]},
        {"motion_limits": tm.MotionLimits()},
        {"motion_limits": tm.MotionLimits(acceleration=3.0, jerk=[9.0, 8.0, np.inf])},
        {"motion_limits": tm.MotionLimits(effort_rate={"joint2": 10.0})},
        {"motion_limits": tm.MotionLimits(acceleration={}, effort_scale=0.9)},
        {
            "motion_limits": tm.MotionLimits(
                effort_curves={"joint1": tm.EffortCurve.droop(20.0, 3.0)}
            )
        },
        {"constraints": (tm.ToolSpeed("tip", 1.5),)},
        {"constraints": (tm.ToolSpeed("tip", 1.5), tm.ToolSpeed("link2", 1.0))},
        {"payload": tm.Payload(0.1, "tip")},
        {
            "payload": tm.Payload(
                0.1 + 0.2,
                "tip",
                com=[0.1, 0.0, 0.0],
                inertia=np.diag([0.01, 0.02, 0.015]),
                geometry=[tm.Box("a", size=[0.1, 0.1, 0.1], position=[0.2, 0, 0])],
                name="cup",
            ),
            "constraints": (tm.ToolSpeed("cup", 1.5),),
        },
    ],
    ids=lambda changes: "+".join(changes),
)
@pytest.mark.parametrize("number", [0, 1])
def test_each_field_of_a_segment_survives_saving_and_loading(
    arm: tm.Robot, changes: dict[str, Any], number: int, tmp_path: Path
) -> None:
    changes = dict(changes)
    if "may_touch" in changes:
        changes["may_touch"] = [("link1", "ball"), ("ball", "link2")]
    segments = [at(MIDDLE), at(END)]
    segments[number] = replace(segments[number], **changes)
    round_trip(problem_of(arm, *segments, scene=tm.Scene([BALL])), tmp_path)


@pytest.mark.parametrize(
    "goal",
    [
        tm.JointGoal(MIDDLE, [0.1, 0.0, -0.2]),
        tm.PositionGoal("tip", [4.0, 1.0, 0.0]),
        tm.PoseGoal("tip", pin.SE3(np.eye(3), np.array([4.0, 1.0, 0.0]))),
        tm.JointRegionGoal([0.3, 0.2], [0.1, 0.0], ("joint3", "joint1")),
        tm.AnyGoal([tm.JointGoal(MIDDLE), tm.PositionGoal("tip", [4.0, 1.0, 0.0])]),
    ],
    ids=lambda goal: type(goal).__name__,
)
def test_goals_of_segments_survive_saving_and_loading(
    arm: tm.Robot, goal: tm.Goal, tmp_path: Path
) -> None:
    round_trip(problem_of(arm, tm.Segment(goal), at(END)), tmp_path)
    round_trip(problem_of(arm, at(MIDDLE), tm.Segment(goal)), tmp_path)


def test_pairs_that_may_touch_survive_saving_and_loading(
    arm: tm.Robot, tmp_path: Path
) -> None:
    pairs = [("link1", "ball"), ("ball", "link3")]
    scene = tm.Scene([BALL])
    plain = tm.Problem(
        arm, START, tm.JointGoal(END), scene=scene, may_touch=pairs, margin=0.01
    )
    document = round_trip(plain, tmp_path)
    assert document["may_touch"] == [list(pair) for pair in pairs]
    several = problem_of(arm, at(MIDDLE), at(END), scene=scene, may_touch=pairs[:1])
    assert round_trip(several, tmp_path)["may_touch"] == [list(pairs[0])]


def test_fields_of_the_problem_are_saved_beside_its_segments(
    arm: tm.Robot, tmp_path: Path
) -> None:
    gentle = tm.MotionLimits(acceleration=2.0)
    problem = problem_of(
        arm,
        at(MIDDLE, motion_limits=tm.MotionLimits(jerk=50.0), dwell=0.1),
        at(END, payload=tm.Payload(0.2, "tip")),
        scene=tm.Scene([BALL]),
        margin=0.01,
        v_start=[0.1, 0.0, 0.0],
        motion_limits=tm.MotionLimits(acceleration=4.0),
        self_collision=False,
        constraints=(tm.ToolSpeed("tip", 3.0),),
    )
    round_trip(problem, tmp_path)
    of_robot = replace(arm, motion_limits=gentle)
    round_trip(problem_of(of_robot, at(MIDDLE), at(END)), tmp_path)
    own = at(END, motion_limits=tm.MotionLimits(acceleration=np.inf))
    round_trip(problem_of(of_robot, at(MIDDLE), own), tmp_path)


def test_paths_of_meshes_are_relative_to_the_scenario_file(
    arm: tm.Robot, tmp_path: Path
) -> None:
    mesh = tmp_path / "part.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\n")
    shape = tm.Mesh("part", path=mesh, scale=0.01, convex="hull")
    cup = tm.Payload(0.1, "tip", geometry=[shape])
    scene = tm.Scene([tm.Mesh("other", path=mesh, position=[0, 0, 9], convex="hull")])
    problem = problem_of(arm, at(MIDDLE, payload=cup), at(END, scene=scene))
    first, second = round_trip(problem, tmp_path)["segments"]
    assert first["payload"]["geometry"][0]["path"] == "part.obj"
    assert second["scene"]["obstacles"][0]["path"] == "part.obj"


def test_segment_that_no_file_can_hold_is_named_in_the_error(
    arm: tm.Robot, tmp_path: Path
) -> None:
    moved = tm.PoseFunction(
        lambda t: pin.SE3(np.eye(3), np.array(FAR["position"])),
        speed=1.0,
        angular_speed=0.0,
    )
    scene = tm.Scene([tm.Sphere("ball", radius=0.01, motion=moved)])
    problem = problem_of(arm, at(MIDDLE), at(END, scene=scene))
    with pytest.raises(tm.ScenarioError, match=r"segments\[1\]: cannot be saved"):
        tm.save_scenario(tmp_path / "a.toml", problem)
    assert not (tmp_path / "a.toml").exists()


# -- files written by hand -------------------------------------------------------------


def test_unnamed_joints_stay_where_the_previous_segment_ends(
    arm: tm.Robot, tmp_path: Path
) -> None:
    text = """
    [[segments]]
    goal = {type = "joint", q = {joint2 = 1.0}}
    [[segments]]
    goal = {type = "joint", q = {joint1 = 0.7}}
    stop = true
    [[segments]]
    goal = {type = "joint", state = "start"}
    """
    first, second, third = loaded(tmp_path, text).segments
    np.testing.assert_array_equal(first.goal.configuration, [0.5, 1.0, -1.7])
    np.testing.assert_array_equal(second.goal.configuration, [0.7, 1.0, -1.7])
    expected = arm.group_state("start")
    np.testing.assert_array_equal(third.goal.configuration, expected)
    assert [item.stop for item in (first, second, third)] == [False, True, False]


def test_joint_goal_after_a_frame_goal_must_name_every_joint(tmp_path: Path) -> None:
    place = """
    [[segments]]
    goal = {type = "position", frame = "tip", position = [4.0, 1.0, 0.0]}
    [[segments]]
    """
    error = refused(tmp_path, place + 'goal = {type = "joint", q = {joint1 = 0.7}}')
    assert error.key == "segments[1].goal.q"
    assert "joint2, joint3" in str(error)
    whole = "{joint1 = 0.7, joint2 = 0.1, joint3 = 0.2}"
    found = loaded(tmp_path, place + f'goal = {{type = "joint", q = {whole}}}')
    np.testing.assert_array_equal(found.goal.configuration, [0.7, 0.1, 0.2])


def test_empty_scene_of_a_segment_replaces_the_scene_of_the_problem(
    tmp_path: Path,
) -> None:
    scene = """
    [[scene.obstacles]]
    type = "sphere"
    name = "ball"
    radius = 0.1
    position = [0.0, 0.0, 9.0]
    """
    phases = loaded(tmp_path, scene + FIRST + LAST + "scene = {}\n").phases
    assert [len(phase.scene) for phase in phases] == [1, 0]


# -- messages about mistakes -----------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "key", "word"),
    [
        ("dwel = 0.1", "segments[1].dwel", "no such key"),
        ("dwell = -0.1", "segments[1].dwell", "dwell: is -0.1, expected a finite"),
        ("dwell = inf", "segments[1].dwell", "finite"),
        ('dwell = "long"', "segments[1].dwell", "number"),
        ("dwell = true", "segments[1].dwell", "number"),
        ("stop = 1", "segments[1].stop", "true or false"),
        ("may_touch = 3", "segments[1].may_touch", "pairs"),
        ('may_touch = "ab"', "segments[1].may_touch", "pairs"),
        ('may_touch = ["ab"]', "segments[1].may_touch", "holds 'ab', expected pairs"),
        ('may_touch = [["link1"]]', "segments[1].may_touch", "expected pairs of names"),
        ('may_touch = [["link1", 2]]', "segments[1].may_touch", "expected pairs of na"),
        ('may_touch = [["link1", "box"]]', "segments[1].may_touch", "box"),
        ("motion_limits = 3", "segments[1].motion_limits", "table"),
        ("motion_limits = {speed = 1}", "segments[1].motion_limits.speed", "no such"),
        ("motion_limits = {jerk = -1}", "segments[1].motion_limits", "positive"),
        (
            "motion_limits = {jerk = {elbow = 1.0}}",
            "segments[1].motion_limits",
            "elbow",
        ),
        ("payload = 3", "segments[1].payload", "table"),
        ("payload = {mass = 1}", "segments[1].payload.frame", "missing"),
        (
            'payload = {mass = -1, frame = "tip"}',
            "segments[1].payload.mass",
            "a finite number >= 0 [kg]",
        ),
        ('payload = {mass = 1, frame = "nose"}', "segments[1].payload", "nose"),
        (
            'payload = {mass = 1, frame = "tip", name = "link1"}',
            "segments[1].payload.name",
            "link1",
        ),
        (
            'payload = {mass = 1, frame = "tip", shape = 1}',
            "segments[1].payload.shape",
            "no such key",
        ),
        ("scene = 3", "segments[1].scene", "table"),
        ("scene = {obstacle = []}", "segments[1].scene.obstacle", "no such key"),
        (
            'scene = {obstacles = [{type = "ball"}]}',
            "segments[1].scene.obstacles[0].type",
            "ball",
        ),
        ("constraints = 3", "segments[1].constraints", "list"),
        (
            'constraints = [{type = "tool_speed", frame = "nose", limit = 1.0}]',
            "segments[1].constraints[0]",
            "nose",
        ),
        (
            'constraints = [{type = "tool_speed", frame = "tip", speed = 1.0}]',
            "segments[1].constraints[0].speed",
            "no such key",
        ),
    ],
)
def test_message_about_a_mistake_names_segment_and_key(
    text: str, key: str, word: str, tmp_path: Path
) -> None:
    error = refused(tmp_path, FIRST + LAST + text)
    assert error.key == key
    assert word in str(error)
    assert str(tmp_path / "s.toml") in str(error)


@pytest.mark.parametrize(
    ("goal", "key", "word"),
    [
        ("", "segments[1].goal", "missing"),
        ("goal = 3", "segments[1].goal", "table"),
        ('goal = {type = "place"}', "segments[1].goal.type", "place"),
        ('goal = {type = "joint"}', "segments[1].goal", "or state (a group state)"),
        ('goal = {type = "joint", q = [1.0]}', "segments[1].goal.q", "expected 3"),
        (
            'goal = {type = "joint", q = [9.0, 0.0, 0.0]}',
            "segments[1].goal.q",
            "segments[1].goal.q: joint 'joint1' is 9 rad",
        ),
        (
            'goal = {type = "joint", q = [1.0, 0.0, 0.0], v = [1.0, 0.0, 0.0]}\n'
            "stop = true",
            "segments[1].stop",
            "velocity",
        ),
        (
            'goal = {type = "position", frame = "nose", position = [4.0, 1.0, 0.0]}',
            "segments[1].goal",
            "nose",
        ),
        (
            'goal = {type = "position", frame = "tip", position = [40.0, 1.0, 0.0]}',
            "segments[1].goal",
            "outside reach",
        ),
    ],
)
def test_message_about_a_wrong_goal_of_a_segment_names_its_key(
    goal: str, key: str, word: str, tmp_path: Path
) -> None:
    error = refused(tmp_path, f"{FIRST}\n[[segments]]\n{goal}\n")
    assert error.key == key
    assert word in str(error)


def test_goal_beside_segments_and_missing_goal_are_rejected(tmp_path: Path) -> None:
    goal = '\n[goal]\ntype = "joint"\nq = [2.0, -1.0, 0.5]\n'
    error = refused(tmp_path, goal + FIRST)
    assert error.key == "goal"
    assert "segments" in str(error)
    error = refused(tmp_path, "")
    assert error.key == "goal"
    assert "missing" in str(error) and "segments" in str(error)
    assert not loaded(tmp_path, goal).segments
    for text in ("segments = 3", "segments = {goal = 1}", "segments = [3]"):
        with pytest.raises(tm.ScenarioError, match="segments"):
            loaded_whole(tmp_path, text)


def loaded_whole(folder: Path, first: str) -> tm.Problem:
    path = folder / "s.toml"
    path.write_text(first + "\n" + SMALL, encoding="utf-8")
    return tm.load_scenario(path).problem


def test_mistake_of_the_problem_is_not_attributed_to_a_segment(tmp_path: Path) -> None:
    text = '[[constraints]]\ntype = "tool_speed"\nframe = "nose"\nlimit = 1.0\n'
    assert refused(tmp_path, text + FIRST + LAST).key == "constraints[0]"
    goal = '[goal]\ntype = "joint"\nq = [2.0, -1.0, 0.5]\n'
    assert refused(tmp_path, text + goal).key == "constraints[0]"
    place = '[goal]\ntype = "position"\nframe = "nose"\nposition = [4.0, 1.0, 0.0]\n'
    assert refused(tmp_path, place).key == "goal"
    with pytest.raises(tm.ScenarioError) as caught:
        loaded_whole(tmp_path, 'may_touch = [["link1", "box"]]\n' + FIRST)
    assert caught.value.key == "may_touch"
    beyond = SMALL.replace("0.5", "9.0") + FIRST
    path = tmp_path / "beyond.toml"
    path.write_text(beyond, encoding="utf-8")
    with pytest.raises(tm.ScenarioError) as caught:
        tm.load_scenario(path)
    assert caught.value.key == "start"


def test_start_beyond_a_limit_of_the_first_segment_names_the_start(
    tmp_path: Path,
) -> None:
    slow = 'constraints = [{type = "tool_speed", frame = "tip", limit = 0.01}]\n'
    path = tmp_path / "s.toml"
    path.write_text(SMALL + "v = [1.0, 0.0, 0.0]\n" + FIRST + slow, encoding="utf-8")
    with pytest.raises(tm.ScenarioError) as caught:
        tm.load_scenario(path)
    assert caught.value.key == "start"


def test_obstacle_at_the_goal_of_a_segment_names_that_segment(tmp_path: Path) -> None:
    there = """
    scene = {obstacles = [{type = "sphere", name = "ball", radius = 0.3,
                           position = [0.0, 0.0, 0.0]}]}
    """.replace("\n   ", "")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        error = refused(tmp_path, FIRST + LAST + there.replace("0.3,", "3.0,"))
    assert error.key in ("segments[1]", "segments[1].goal")
    assert "segment 2 of 2" not in str(error)  # the key names it


# -- the command line ------------------------------------------------------------------

PLANNED = f"""
{FIRST}
[[segments]]
dwell = 0.1
goal = {{type = "joint", q = [1.0, 0.3, -0.6]}}
{LAST}
payload = {{mass = 0.05, frame = "tip"}}
[options]
control = "constant"
intervals = 20
"""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("segments") / "s.toml"
    path.write_text(SMALL + PLANNED, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def solution(scenario: Path) -> tm.Solution:
    loaded = tm.load_scenario(scenario)
    found = tm.plan(loaded.problem, loaded.options)
    assert found.success, found.message
    return found


def test_report_lists_the_segments(solution: tm.Solution) -> None:
    data = report_data(solution, {})
    first, second, third = data["segments"]
    assert first["begin"] == 0.0 and first["end"] == second["begin"]
    assert third["end"] == solution.T
    assert second["end"] - second["arrival"] == pytest.approx(0.1)
    assert [item["stop"] for item in data["segments"]] == [False, True, True]
    assert [item["dwell"] for item in data["segments"]] == [0.0, 0.1, 0.0]
    json.loads(json_text(data))
    rows = [row.split() for row in report_text(data).splitlines() if "segment " in row]
    assert [row[:2] for row in rows[:3]] == [["segment", str(k)] for k in (1, 2, 3)]
    assert [row[4] for row in rows[:3]] == ["passes", "arrives", "arrives"]
    assert rows[1][2] == f"{second['duration']:.4f}"
    assert rows[1][-3:] == ["stays", "0.1", "s"]


@pytest.mark.parametrize(("name", "dt"), [("m.csv", None), ("m.npz", 0.001)])
def test_exported_motion_of_several_segments_passes_the_check(
    solution: tm.Solution, name: str, dt: float | None, tmp_path: Path
) -> None:
    """A segment ends where it reaches its goal best, not where it first is within the
    tolerance.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        path = solution.export(tmp_path / name, dt=dt)
    found = check_file(solution.problem, path)
    assert found.ok, found.message


def test_command_line_plans_and_verifies_segments(
    scenario: Path, tmp_path: Path
) -> None:
    motion = tmp_path / "m.csv"
    planned = invoke(["plan", str(scenario), "-o", str(motion), "--json"])
    assert planned.exit_code == 0, planned.output
    assert len(json.loads(planned.stdout)["segments"]) == 3
    verified = invoke(["verify", str(scenario), str(motion)])
    assert verified.exit_code == 0, verified.output
    # The same motion fails with another via point, and with a longer dwell.
    text = scenario.read_text(encoding="utf-8")
    for before, after in (("[1.2, 0.6, -0.6]", "[1.2, 0.7, -0.6]"), ("0.1", "0.3")):
        other = tmp_path / "other.toml"
        other.write_text(text.replace(before, after, 1), encoding="utf-8")
        verified = invoke(["verify", str(other), str(motion)])
        assert verified.exit_code == 1, verified.output


# -- pictures --------------------------------------------------------------------------


def test_plots_have_lines_at_the_ends_of_segments(solution: tm.Solution) -> None:
    pytest.importorskip("matplotlib")
    panel = solution.plot().axes[0]
    upright = [
        line.get_xdata()[0]
        for line in panel.get_lines()
        if len(line.get_xdata()) == 2 and line.get_xdata()[0] == line.get_xdata()[1]
    ]
    assert upright == [segment.end for segment in solution.segments[:-1]]


def test_goal_on_a_payload_is_drawn_at_a_frame_of_the_robot(arm: tm.Robot) -> None:
    load = tm.Payload(0.01, "tip", name="cup")
    goal = tm.PositionGoal("cup", [4.0, 1.0, 0.0])
    problem = problem_of(arm, at(MIDDLE), tm.Segment(goal, payload=load))
    assert end_frame(problem) in arm.frame_names
