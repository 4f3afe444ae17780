"""Scenario files in TOML: reading, writing, and messages about mistakes."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tominpmp as tm
from tominpmp.description.fields import tomllib
from tominpmp.exceptions import ScenarioError
from tominpmp.files.records import classes, toml_text
from tominpmp.files.scenario import load_scenario, save_scenario
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.motion_limits import EffortCurve, MotionLimits
from tominpmp.options import Options
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere
from tominpmp.scene.scene import Scene

START, GOAL = [0.5, 1.7, -1.7], [2.0, -1.0, 0.5]
TURN = pin.rpy.rpyToMatrix(0.3, -0.2, 0.9)
PLACE = pin.SE3(TURN, np.array([4.0, 1.0, 0.0]))

SMALL = """
[robot]
name = "planar3r"
[start]
state = "start"
[goal]
type = "joint"
q = [2.0, -1.0, 0.5]
"""


def write(folder: Path, text: str, name: str = "s.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def round_trip(problem: Problem, options: Options, folder: Path) -> str:
    """Save, load and save a problem, which must change nothing; return the text."""
    path = save_scenario(folder / "a.toml", problem, options)
    found = load_scenario(path)
    assert found.problem == problem
    assert found.options == options
    saved_again = save_scenario(folder / "b.toml", found.problem, found.options)
    assert saved_again.read_text(encoding="utf-8") == path.read_text(encoding="utf-8")
    return path.read_text(encoding="utf-8")


def problem_of(robot: Robot, goal: Goal | None = None, **values: Any) -> Problem:
    return Problem(robot, START, JointGoal(GOAL) if goal is None else goal, **values)


def test_smallest_scenario_is_loaded_with_default_options(
    planar3r: Robot, tmp_path: Path
) -> None:
    found = load_scenario(write(tmp_path, SMALL))
    assert found.problem == problem_of(planar3r)
    assert found.options == Options()
    assert tm.load_scenario is load_scenario
    assert tm.save_scenario is save_scenario


def test_saved_scenario_omits_default_values(planar3r: Robot, tmp_path: Path) -> None:
    text = round_trip(problem_of(planar3r), Options(), tmp_path)
    assert tomllib.loads(text) == {
        "robot": {"name": "planar3r"},
        "start": {"q": START},
        "goal": {"type": "joint", "q": GOAL},
    }


def test_keys_of_a_saved_scenario_keep_their_order(
    planar3r: Robot, tmp_path: Path
) -> None:
    """Regression: results of a batch are found by this text, and were not found any
    more when the keys had another order: all problems were planned again.
    """
    problem = replace(
        problem_of(planar3r),
        scene=Scene([Sphere("ball", position=(9.0, 9.0, 9.0), radius=0.1)]),
        margin=0.01,
        self_collision=False,
        may_touch=[("ball", "link1")],
        constraints=[tm.ToolSpeed("tip", 3.0)],
    )
    text = round_trip(problem, Options(seed=3), tmp_path)
    plain = ["may_touch", "margin", "self_collision", "constraints"]
    tables = ["robot", "start", "goal", "scene", "options"]
    assert [*tomllib.loads(text)] == [*plain, *tables]


@pytest.mark.parametrize(
    "goal",
    [
        JointGoal(GOAL, [0.1, 0.0, -0.2]),
        PositionGoal("tip", [4.0, 1.0, 0.0]),
        PositionGoal("tip", [4.0, 1.0, 0.0], [0.0, 1.0 / 3.0, 0.0]),
        PoseGoal("tip", pin.SE3(TURN, np.array([4.0, 1.0, 0.0]))),
        PoseGoal("tip", pin.SE3(np.eye(3), np.array([4.0, 1.0, 0.0])), [0.0, 1.0, 0.0]),
        PositionGoal("tip", [4.0, 1.0, 0.0], tolerance=0.05),
        PoseGoal("tip", PLACE, tolerance=0.05, angle_tolerance=0.1),
        tm.JointRegionGoal(GOAL, 0.1),
        tm.JointRegionGoal([0.3, 0.2], [0.1, 0.0], ("joint3", "joint1")),
        tm.AxisGoal("tip", [1, 0, 0], [0.0, 0.6, 0.8], angle_tolerance=0.1),
        tm.AxisGoal("tip", [1, 0, 0], [0.0, 1.0, 0.0], [4.0, 1.0, 0.0]),
        tm.RegionGoal("tip", [-0.1, -math.inf, 0.0], [0.1, 0.2, math.inf], PLACE),
        tm.RegionGoal("tip", [-1, -1, -1], [5, 1, 1], None, [0.1, 4.0, 0.2]),
        tm.AnyGoal([JointGoal(GOAL), PositionGoal("tip", [4.0, 1.0, 0.0])]),
        tm.AllGoals(
            [
                PositionGoal("tip", [4.0, 1.0, 0.0], tolerance=0.1),
                tm.JointRegionGoal([0.2], 0.1, ("joint2",)),
            ]
        ),
    ],
    ids=lambda goal: type(goal).__name__,
)
def test_goal_survives_saving_and_loading(
    planar3r: Robot, goal: Goal, tmp_path: Path
) -> None:
    round_trip(problem_of(planar3r, goal), Options(), tmp_path)


def test_primitive_obstacles_survive_saving_and_loading(
    planar3r: Robot, tmp_path: Path
) -> None:
    place: dict[str, Any] = {"position": [9.0, 0.1 + 0.2, 1e-7]}
    scene = Scene(
        [
            Sphere("ball", radius=1 / 3, **place),
            Box('a "box"\n\x7f ü', size=[0.1, 0.2, 0.3], rotation=TURN, **place),
            Cylinder(
                "can", radius=0.03, length=0.14, rotation=[0, 0, 0.6, 0.8], **place
            ),
            Capsule(
                "rod", radius=0.03, length=0.14, rotation=[0.1, 0.2, 0.3, 0.4], **place
            ),
        ]
    )
    state = {"v_start": [0.1, 0.0, 0.0], "a_start": [0.0, 0.2, 0.0]}
    problem = problem_of(planar3r, scene=scene, margin=0.05, **state)
    text = round_trip(problem, Options(), tmp_path)
    assert "rotation = [0.0, 0.0, 0.6, 0.8]" in text


def test_meshes_and_grids_survive_saving_and_loading(
    planar3r: Robot, tmp_path: Path
) -> None:
    corners = [[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0], [0, 0, 0.1 + 0.2]]
    triangles = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    far: dict[str, Any] = {"position": [0.0, 0.0, 9.0]}
    scene = Scene(
        [
            tm.Mesh("wedge", vertices=corners, triangles=triangles, scale=2.0, **far),
            tm.HeightField("ground", heights=[[0.1, 0.2], [0, 1]], size=[2, 3], **far),
            tm.OcTree("cloud", points=corners, resolution=0.05, **far),
        ]
    )
    round_trip(problem_of(planar3r, scene=scene), Options(), tmp_path)


def test_paths_of_meshes_are_relative_to_the_scenario_file(
    planar3r: Robot, tmp_path: Path
) -> None:
    folder, elsewhere = tmp_path / "here", tmp_path / "there"
    (folder / "meshes").mkdir(parents=True)
    content = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3"
    mesh = folder / "meshes" / "part.obj"
    mesh.write_text(content)
    scene = Scene([tm.Mesh("part", path=mesh, position=[0, 0, 9], convex="hull")])
    path = save_scenario(folder / "s.toml", problem_of(planar3r, scene=scene))
    (entry,) = tomllib.loads(path.read_text())["scene"]["obstacles"]
    assert entry["path"] == "meshes/part.obj"
    assert "vertices" not in entry
    assert load_scenario(path).problem.scene == scene
    # The folder as a whole can be moved.
    folder.rename(elsewhere)
    found = load_scenario(elsewhere / "s.toml").problem.scene["part"]
    assert found.path == elsewhere / "meshes" / "part.obj"
    # If the mesh file has changed, the scenario holds the triangles themselves.
    (elsewhere / "meshes" / "part.obj").write_text(content.replace("v 1", "v 2"))
    changed = problem_of(planar3r, scene=Scene([found]))
    saved_again = load_scenario(save_scenario(elsewhere / "b.toml", changed))
    assert saved_again.problem.scene["part"] == found


def test_motions_of_obstacles_survive_saving_and_loading(
    planar3r: Robot, tmp_path: Path
) -> None:
    turns = [[0, 0, 0, 1], [0, 0, 0.6, 0.8], [0.1, 0.2, 0.3, 0.4]]
    line = [[0, 0, 9], [0.1 + 0.2, 0, 9], [1, 1, 9]]
    motions: list[tm.Motion] = [
        tm.ConstantVelocity(velocity=[0.0, 0.2, 1 / 3]),
        tm.ConstantVelocity(angular=[0, 0, 1], pivot=[1, 2, 9], begin=0.5, end=2.5),
        tm.Waypoints([0.0, 0.1, 2.0], line),
        tm.Waypoints([0.0, 0.1, 2.0], rotations=turns),
        tm.Waypoints([0.0, 0.1, 2.0], line, turns),
    ]
    scene = Scene(
        [
            Box(f"box {i}", size=[0.1, 0.2, 0.3], position=[0, 0, 9], motion=motion)
            for i, motion in enumerate(motions)
        ]
    )
    text = round_trip(problem_of(planar3r, scene=scene), Options(), tmp_path)
    assert 'type = "constant_velocity"' in text
    times = np.linspace(0.0, 3.0, 13)
    loaded = load_scenario(tmp_path / "a.toml").problem.scene
    for item in scene:
        for one, other in zip(
            item.poses(times), loaded[item.name].poses(times), strict=True
        ):
            np.testing.assert_array_equal(one, other)


def test_payloads_survive_saving_and_loading(planar3r: Robot, tmp_path: Path) -> None:
    cup = tm.Payload(
        mass=0.1 + 0.2,
        frame="tip",
        com=[0.1, 0.0, 0.0],
        inertia=np.diag([0.01, 0.02, 0.015]),
        geometry=[Box("cup", size=[0.1, 0.2, 0.3], position=[0.2, 0, 0])],
    )
    lid = tm.Payload(mass=0.1, frame="payload", name="lid")
    robot = planar3r.with_payload(cup).with_payload(lid)
    assert robot.payloads == (cup, lid)
    text = round_trip(problem_of(robot), Options(), tmp_path)
    assert text.count("[[robot.payloads]]") == 2
    loaded = load_scenario(tmp_path / "a.toml").problem.robot
    for one, other in zip(loaded.model.inertias, robot.model.inertias, strict=True):
        np.testing.assert_array_equal(
            one.toDynamicParameters(), other.toDynamicParameters()
        )
    assert len(loaded.collision_model.geometryObjects) == 1 + len(
        planar3r.collision_model.geometryObjects
    )


@pytest.mark.parametrize("own", [True, False])
def test_self_collision_flag_survives_saving_and_loading(
    planar3r: Robot, own: bool, tmp_path: Path
) -> None:
    problem = problem_of(planar3r, self_collision=own)
    text = round_trip(problem, Options(), tmp_path)
    assert f"self_collision = {str(own).lower()}" in text


def test_options_except_callbacks_survive_saving_and_loading(
    planar3r: Robot, tmp_path: Path
) -> None:
    options = Options(
        method="adjoint",
        intervals=75,
        smoothing=0.0,
        starts=3,
        max_planning_time=2.5,
        initial_control=[[1.0, 2.0, 3.0]] * 75,
        step_rule="paper",
    )
    round_trip(problem_of(planar3r), options, tmp_path)
    with_callback = Options(intervals=50, callback=print)
    path = save_scenario(tmp_path / "c.toml", problem_of(planar3r), with_callback)
    assert load_scenario(path).options == Options(intervals=50)


@pytest.mark.parametrize(
    "values",
    [
        {"refine": "switching", "method": "collocation"},
        {"refine": "grid", "grid": "uniform", "tolerance": 1e-5},
        {"objective": "feasible", "max_iterations": 7, "seed": 3, "processes": 2},
        {"slack": 0.05, "feasibility": 1e-7, "lp_solver": "highs"},
        {"control": "spline", "trust_region": 0.1, "initial_duration": 1.5},
        {"goal_tolerance": 1e-4, "speed_tolerance": 1e-3, "limit_tolerance": 1e-3},
        {"contact_tolerance": 1e-4, "control_step": 0.1, "time_step": 0.02},
    ],
    ids=lambda values: next(iter(values)),
)
def test_each_option_survives_saving_and_loading(
    planar3r: Robot, values: dict[str, Any], tmp_path: Path
) -> None:
    text = round_trip(problem_of(planar3r), Options(**values), tmp_path)
    assert tomllib.loads(text)["options"] == values


def test_motion_limits_survive_saving_and_loading(
    planar3r: Robot, tmp_path: Path
) -> None:
    limits = MotionLimits(
        acceleration=10.0,
        jerk=[100.0, math.inf, 300.0],
        effort_rate={"joint2": 1000.0},
        effort_scale=0.9,
        effort_curves={"joint1": EffortCurve.droop(20.0, 3.0)},
    )
    problem = problem_of(planar3r, motion_limits=limits)
    text = round_trip(problem, Options(), tmp_path)
    assert "[motion_limits.effort_curves.joint1]" in text


def test_empty_motion_limits_survive_saving_and_loading(
    planar3r: Robot, tmp_path: Path
) -> None:
    """Regression: empty `MotionLimits` became None once they had been saved."""
    problem = problem_of(planar3r, motion_limits=MotionLimits())
    round_trip(problem, Options(), tmp_path)
    free = replace(planar3r, motion_limits=MotionLimits())
    round_trip(problem_of(free), Options(), tmp_path)


def test_changes_of_the_robot_survive_saving_and_loading(tmp_path: Path) -> None:
    robot = load_robot(
        "planar3r",
        locked_joints={"joint3": 0.25},
        gravity=(0.0, 0.0, -1.62),
        velocity={"joint1": math.inf},
        effort={"joint2": (-3.0, 5.0)},
        damping=0.5,
        armature=[0.0, 0.1],
        position_upper={"joint1": 1 / 3 + 1},
    )
    problem = Problem(robot, [0.5, 1.7], JointGoal([0.6, 1.0]))
    text = round_trip(problem, Options(), tmp_path)
    table = tomllib.loads(text)["robot"]
    assert table["locked_joints"] == {"joint3": 0.25}
    assert table["velocity"] == {"joint1": math.inf}
    assert table["effort"] == {"joint2": [-3.0, 5.0]}
    assert "position_lower" not in table
    plain = load_robot("planar3r", locked_joints={"joint3": 0.25})
    assert plain != robot
    assert plain.with_changes(gravity=(0.0, 0.0, -1.62)) != robot


def test_paths_of_robot_files_are_relative_to_the_scenario_file(
    planar3r: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "arms"
    folder.mkdir()
    urdf = folder / "arm.urdf"
    urdf.write_bytes(planar3r.urdf_path.read_bytes())
    srdf = folder / "other.srdf"
    assert planar3r.srdf is not None
    srdf.write_bytes(planar3r.srdf.path.read_bytes())
    robot = load_robot(urdf, srdf=srdf, package_dirs=[folder, tmp_path])
    problem = problem_of(robot)
    text = round_trip(problem, Options(), tmp_path)
    table = tomllib.loads(text)["robot"]
    assert table["path"] == "arms/arm.urdf"
    assert table["srdf"] == "arms/other.srdf"
    assert table["package_dirs"] == ["arms", "."]
    # The scenario loads from any working folder, and after its folder was moved.
    moved = tmp_path.rename(tmp_path.with_name(f"{tmp_path.name}-moved"))
    monkeypatch.chdir(moved)
    found = load_scenario("a.toml").problem
    assert found.robot.urdf_path == moved / "arms" / "arm.urdf"
    # A scenario saved outside the folder of the robot has the absolute path.
    other = moved / "elsewhere"
    other.mkdir()
    path = save_scenario(other / "c.toml", found)
    assert tomllib.loads(path.read_text())["robot"]["path"] == str(
        moved / "arms" / "arm.urdf"
    )
    assert load_scenario(path).problem == found


def test_message_about_an_unbounded_region_names_the_goal_once(tmp_path: Path) -> None:
    goal = 'type = "region"\nframe = "tip"\nlower = [-inf, -inf, -inf]\n'
    text = f"{goal}upper = [inf, inf, inf]\n"
    path = write(
        tmp_path, f'[robot]\nname = "planar3r"\n[start]\nq = [0, 0, 0]\n[goal]\n{text}'
    )
    with pytest.raises(ScenarioError, match=r"toml: goal: the box is infinite"):
        load_scenario(path)


def test_joint_positions_are_lists_named_joints_or_group_states(
    planar3r: Robot, tmp_path: Path
) -> None:
    def positions(start: str, goal: str) -> tuple[list[float], list[float]]:
        text = f'[robot]\nname = "planar3r"\n[start]\n{start}\n[goal]\n'
        found = load_scenario(write(tmp_path, f'{text}type = "joint"\n{goal}')).problem
        assert isinstance(found.goal, JointGoal)
        return found.q_start.tolist(), found.goal.q.tolist()

    assert positions("q = [1, 2, 0.5]", "q = {joint2 = 1}") == (
        [1.0, 2.0, 0.5],
        [1.0, 1.0, 0.5],
    )
    assert positions('q = "start"', 'state = "start"') == (START, START)
    assert positions('state = "start"\nq = {joint3 = 0}', "q = [1, 1, 1]") == (
        [0.5, 1.7, 0.0],
        [1.0, 1.0, 1.0],
    )
    named = "q = {joint3 = 3, joint1 = 1, joint2 = 2}"
    assert positions(named, named) == ([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    for nothing in ("q = {}", 'q = ""', 'state = ""'):
        with pytest.raises(ScenarioError, match="goal: has no joint pos"):
            positions(named, nothing)


def test_goals_of_every_type_accept_values_by_name(
    planar3r: Robot, tmp_path: Path
) -> None:
    def goal(text: str) -> Goal:
        start = '[robot]\nname = "planar3r"\n[start]\nstate = "start"\n[goal]\n'
        return load_scenario(write(tmp_path, start + text)).problem.goal

    one = '{type = "joint", q = {joint2 = 1}, v = {joint2 = 0.5}}'
    found = goal(f'type = "any"\ngoals = [{one}]').alternatives
    assert found == (JointGoal([0.5, 1.0, -1.7], [0.0, 0.5, 0.0]),)
    region = 'type = "joint_region"\nq = {joint3 = 1}\ntolerance = {joint3 = 0.1}'
    assert goal(region) == tm.JointRegionGoal({"joint3": 1.0}, [0.1])
    place = 'type = "position"\nframe = "tip"\nposition = {x = 2, y = 1, z = 0}'
    assert goal(place) == PositionGoal("tip", [2.0, 1.0, 0.0])
    with pytest.raises(ScenarioError, match=r"'jont2' \(did you mean joint2"):
        goal(f'type = "any"\ngoals = [{one.replace("joint2", "jont2")}]')


def test_joint_limits_of_moveit_are_overridden_by_the_scenario(tmp_path: Path) -> None:
    write(
        tmp_path,
        """
joint_limits:
  joint1: {has_velocity_limits: true, max_velocity: 1.25,
           has_acceleration_limits: true, max_acceleration: 5.0}
  joint2: {max_velocity: 1.5, has_jerk_limits: true, max_jerk: 50}
  joint3: {max_acceleration: 7}
""",
        "limits.yaml",
    )
    text = SMALL.replace(
        '"planar3r"',
        '"planar3r"\njoint_limits = "limits.yaml"\nvelocity = {joint2 = 0.75}',
    )
    text += "[motion_limits]\nacceleration = {joint3 = 6.0}\n"
    problem = load_scenario(write(tmp_path, text)).problem
    assert problem.robot.limits.velocity[:2].tolist() == [1.25, 0.75]
    limits = problem.motion_limits
    assert limits is not None
    assert limits.acceleration == {"joint1": 5.0, "joint3": 6.0}
    assert limits.jerk == {"joint2": 50.0}
    round_trip(problem, Options(), tmp_path)


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [
        (
            ("[robot]", "[robots]"),
            "robots",
            r"no such key .did you mean robot\?.; there are: .*margin, .*robot",
        ),
        (('name = "planar3r"', ""), "robot", "either the name or the path"),
        (
            ('"planar3r"', '"planar3r"\nvelocity = {elbow = 1}'),
            "robot.velocity",
            "toml: robot.velocity: there is no joint 'elbow'",
        ),
        (
            ('state = "start"', 'state = "start"\na = "x"'),
            "start.a",
            "toml: start.a: is 'x'",
        ),
        (('"planar3r"', '"planar9r"'), "robot", "no robot 'planar9r'"),
        (('"planar3r"', "3"), "robot.name", "expected a text"),
        (('"planar3r"', '"planar3r"\npath = "a"'), "robot", "either the name or"),
        (('"planar3r"', '"planar3r"\nsped = 1'), "robot.sped", "no such key"),
        (
            ('"planar3r"', '"planar3r"\nvelocity = -1.0'),
            "robot.velocity",
            "joint joint1 got -1",
        ),
        (
            ('"planar3r"', '"planar3r"\npackage_dirs = ["none"]'),
            "robot.package_dirs",
            "there is no folder",
        ),
        (
            ('"planar3r"', '"planar3r"\nlocked_joints = {elbow = 1.0}'),
            "robot.locked_joints",
            "no joint 'elbow'",
        ),
        (
            ('"planar3r"', '"planar3r"\njoint_limits = "no.yaml"'),
            "robot.joint_limits",
            r"there is no file .*no\.yaml",
        ),
        (("[start]\n", "[start]\nq = [1, 2]\n#"), "start.q", "2 numbers, expected 3"),
        (
            ("[start]\n", "[start]\nq = [1, 2, 9]\n#"),
            "start",
            "joint 'joint3' is 9 rad, outside its position limits",
        ),
        (
            ("q = [2.0, -1.0, 0.5]", "q = [2.0, -1.0, 90.0]"),
            "goal.q",
            "goal.q: joint 'joint3' is 90 rad, outside",
        ),
        (('"start"', '"home"'), "start.state", "no group state 'home'.* start"),
        (('state = "start"', ""), "start", "joint2, joint3. or state"),
        (
            ('state = "start"', 'state = "start"\nq = "home"'),
            "start.q",
            "joints by name beside a state",
        ),
        (("[robot]", "options = []\n[robot]"), "options", "expected a table"),
        (('state = "start"', "q = {elbow = 1}"), "start.q", "a value for 'elbow'"),
        (
            ('state = "start"', "q = {joint1 = 1}"),
            "start.q",
            "has no value for joint2, joint3",
        ),
        (('state = "start"', 'q = [1, 2, "x"]'), "start.q", "expected 3 numbers"),
        (('state = "start"', "q = [1, 2, nan]"), "start.q", "'joint3' is nan"),
        (
            ('"start"', '"start"\nv = [9, 9]'),
            "start.v",
            "2 numbers, expected 3",
        ),
        (
            ('"joint"', '"joints"'),
            "goal.type",
            r"no goal .joints. .did you mean joint\?",
        ),
        (('type = "joint"', ""), "goal.type", "is missing"),
        (('"joint"', '"joint"\nframe = "tip"'), "goal.frame", "no such key"),
        (
            ('type = "joint"\nq =', 'type = "position"\nposition ='),
            "goal.frame",
            "is missing",
        ),
        (
            (
                'type = "joint"\nq =',
                'type = "position"\nframe = "hand"\nposition =',
            ),
            "goal",
            "no frame 'hand'",
        ),
        (
            (
                'type = "joint"\nq = [2.0, -1.0, 0.5]',
                'type = "position"\nframe = "tip"\nposition = [2.0, -1.0]',
            ),
            "goal.position",
            "expected three coordinates",
        ),
        (
            (
                'type = "joint"\nq = [2.0, -1.0, 0.5]',
                'type = "position"\nframe = "tip"\nposition = [9.0, -1.0, 0.0]',
            ),
            "goal",
            "outside reach by",
        ),
        (
            (
                'type = "joint"\nq = [2.0, -1.0, 0.5]',
                'type = "pose"\nframe = "tip"\n'
                "pose = {position = [4, 1, 0], rotation = [0, 0, 0, 0]}",
            ),
            "goal.pose.rotation",
            "or a quaternion",
        ),
        (("[goal]", "[options]\nintervals = 2\n[goal]"), "options.intervals", ">= 4"),
        (("[goal]", '[options]\nmode = "x"\n[goal]'), "options.mode", "no such key"),
        (
            ("[goal]", '[options]\ncallback = "x"\n[goal]'),
            "options.callback",
            "expected a function",
        ),
        (("[robot]", "margin = -1\n[robot]"), "margin", "a finite number >= 0"),
        (("[robot]", 'margin = "x"\n[robot]'), "margin", "a finite number"),
        (
            ("[goal]", "[motion_limits]\nacceleration = -1\n[goal]"),
            "motion_limits",
            "expected positive numbers",
        ),
        (
            ("[goal]", '[motion_limits]\njerk = {joint2 = "x"}\n[goal]'),
            "motion_limits",
            "jerk: joint 'joint2' is 'x', expected positive numbers",
        ),
        (
            ("[goal]", '[motion_limits]\nfile = "no.yaml"\n[goal]'),
            "motion_limits.file",
            r"there is no file .*no\.yaml",
        ),
        (
            (
                "[goal]",
                "[motion_limits.effort_curves]\n"
                "joint1 = {stall = -5, no_load_speed = 3}\n[goal]",
            ),
            "motion_limits.effort_curves.joint1.stall",
            r"is -5, expected a finite number >= 0 \[N m or N\]",
        ),
        (
            ("[goal]", "[motion_limits.effort_curves]\njoint1 = {speed = [0]}\n[goal]"),
            "motion_limits.effort_curves.joint1.effort",
            "is missing",
        ),
    ],
)
def test_message_about_a_wrong_scenario_names_file_and_key(
    change: tuple[str, str], key: str | None, words: str, tmp_path: Path
) -> None:
    assert change[0] in SMALL
    path = write(tmp_path, SMALL.replace(*change))
    with pytest.raises(ScenarioError, match=words) as caught:
        load_scenario(path)
    assert caught.value.key == key
    if key is not None:
        assert caught.value.path == path
        assert str(caught.value).startswith(f"{path}: {key}: ")
        for repeated in (f": {key}: {key}: ", f": {key}: {key} is "):
            assert repeated not in str(caught.value)


def test_locked_joints_may_be_named_where_they_are_locked(tmp_path: Path) -> None:
    """They were unknown joints, although a problem takes them."""
    start = "q = {joint1 = 0.5, joint2 = 1.0, joint3 = 0.2}"
    text = SMALL.replace('state = "start"', start).replace(
        "[2.0, -1.0, 0.5]", "[2, -1]"
    )
    lock = '"planar3r"\nlocked_joints = {joint3 = 0.2}'
    path = write(tmp_path, text.replace('"planar3r"', lock))
    assert load_scenario(path).problem.q_start.tolist() == [0.5, 1.0]
    path = write(tmp_path, text.replace('"planar3r"', lock.replace("0.2", "0.3")))
    with pytest.raises(ScenarioError, match=r"locked at 0.3 \[rad or m\]"):
        load_scenario(path)
    # A locked joint has no velocity, whatever its position.
    text = text.replace('"planar3r"', lock)
    for rate in "va":
        path = write(tmp_path, text.replace(start, f"{start}\n{rate} = {{joint3 = 0}}"))
        assert load_scenario(path).problem.v_start.tolist() == [0.0, 0.0]
        path = write(
            tmp_path, text.replace(start, f"{start}\n{rate} = {{joint3 = 0.2}}")
        )
        with pytest.raises(ScenarioError, match=rf"start.{rate}: .*locked at 0$"):
            load_scenario(path)


@pytest.mark.parametrize(
    ("obstacle", "key", "words"),
    [
        ('name = "a"\nradius = 1', "type", "is missing"),
        ('type = "torus"', "type", "no obstacle 'torus'; there are: sphere, box"),
        ('type = "sphere"\nname = "a"', "radius", "is missing"),
        ('type = "sphere"\nname = "a"\nradius = -1', "radius", "positive length"),
        ('type = "sphere"\nname = "a"\nradius = "x"', "radius", "positive length"),
        ('type = "sphere"\nname = ""\nradius = 1', "name", "needs a name"),
        ('type = "sphere"\nradius = 1', "name", "is missing"),
        ('type = "sphere"\nname = "a"\nradius = 1\nsize = 2', "size", "no such key"),
        (
            'type = "sphere"\nname = "a"\nradius = 1\nposition = [1, 2]',
            "position",
            "three coordinates",
        ),
        (
            'type = "sphere"\nname = "a"\nradius = 1\nposition = {x = 1}',
            "position",
            "three coordinates",
        ),
        (
            'type = "box"\nname = "a"\nsize = [1, 1, 1]\nrotation = [[1, 2, 3]]',
            "rotation",
            "expected a rotation matrix .3x3",
        ),
        ('type = "sphere"\nname = "a"\nradius = 4', None, "toml: start: in collis"),
    ],
)
def test_message_about_a_wrong_obstacle_names_its_key(
    obstacle: str, key: str | None, words: str, tmp_path: Path
) -> None:
    path = write(tmp_path, f"{SMALL}\n[[scene.obstacles]]\n{obstacle}\n")
    with pytest.raises(ScenarioError, match=words) as caught:
        load_scenario(path)
    expected = "start" if key is None else f"scene.obstacles[0].{key}".rstrip(".")
    assert caught.value.key == expected


@pytest.mark.parametrize(
    "content", [b"\xff", b"a = ", b"a = 1\na = 2", b"a = " + b"[" * 20_000, b"[robot"]
)
def test_malformed_toml_raises_scenario_error(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_bytes(content)
    with pytest.raises(ScenarioError, match="is not TOML") as caught:
        load_scenario(path)
    assert caught.value.path == path


def test_save_scenario_rejects_problems_that_no_file_can_hold(
    planar3r: Robot, tmp_path: Path
) -> None:
    class Cone(Obstacle):
        """A shape of the caller's own."""

    problem = problem_of(planar3r)
    with pytest.raises(ScenarioError, match="there is no folder"):
        save_scenario(tmp_path / "none" / "s.toml", problem)
    object.__setattr__(problem, "scene", Scene([Cone("a")]))
    with pytest.raises(ScenarioError, match="scene: cannot be saved: a Cone") as caught:
        save_scenario(tmp_path / "s.toml", problem)
    assert caught.value.key == "scene"
    heavy = planar3r.model.copy()
    heavy.inertias[3] = heavy.inertias[3] + heavy.inertias[3]
    problem = problem_of(replace(planar3r, model=heavy))
    with pytest.raises(
        ScenarioError, match=r"robot: cannot be saved: .*other inertias"
    ):
        save_scenario(tmp_path / "s.toml", problem)
    gate = Sphere("gate", radius=0.1, motion=lambda t: np.eye(4) * [1, 1, 1, 1])
    object.__setattr__(problem, "robot", planar3r)
    object.__setattr__(problem, "scene", Scene([gate]))
    with pytest.raises(ScenarioError, match=r"'gate' is moved by a fun.*Waypoints can"):
        save_scenario(tmp_path / "s.toml", problem)
    pair = tm.Workcell({"a": (planar3r, (0, 0, 0)), "b": (planar3r, (20, 0, 0))})
    both = Problem(pair.robot, START * 2, JointGoal(GOAL * 2))
    with pytest.raises(ScenarioError, match=r"robot: .*combined from several: a, b"):
        save_scenario(tmp_path / "s.toml", both)
    assert list(tmp_path.iterdir()) == []


def test_robots_with_different_inertias_are_unequal(planar3r: Robot) -> None:
    heavy = planar3r.model.copy()
    heavy.inertias[3] = heavy.inertias[3] + heavy.inertias[3]
    other = replace(planar3r, model=heavy)
    assert other != planar3r
    assert planar3r == load_robot("planar3r")
    assert hash(planar3r) == hash(load_robot("planar3r"))


def test_effort_curves_accept_the_three_forms_of_yaml_files(tmp_path: Path) -> None:
    curves = """
[motion_limits.effort_curves]
joint1 = {stall = 20.0, no_load_speed = 3.0}
joint2 = {effort = 20.0, power = 30.0, top_speed = 4.0}
joint3 = {speed = [0.0, 2.0], effort = [20.0, 10.0]}
"""
    problem = load_scenario(write(tmp_path, SMALL + curves)).problem
    assert problem.motion_limits == MotionLimits(
        effort_curves={
            "joint1": EffortCurve.droop(20.0, 3.0),
            "joint2": EffortCurve.power(20.0, 30.0, 4.0),
            "joint3": EffortCurve(np.array([0.0, 2.0]), np.array([20.0, 10.0])),
        }
    )
    round_trip(problem, Options(), tmp_path)


def test_classes_are_registered_by_the_names_used_in_files() -> None:
    assert {"sphere", "box", "cylinder", "capsule"} <= set(classes(Obstacle))
    assert {"joint", "position", "pose"} <= set(classes(Goal))
    assert "frame" not in classes(Goal)


scalars = (
    st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
)
keys = st.text(st.characters(exclude_categories=["Cs"]), max_size=6)
values = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=3)
    ),
    max_leaves=12,
)


@given(st.dictionaries(keys, values, max_size=4))
def test_any_table_survives_writing_and_parsing_toml(table: dict[str, Any]) -> None:
    assert tomllib.loads(toml_text(table)) == table


def test_toml_writer_puts_each_row_of_numbers_on_one_line() -> None:
    """Rows on lines of their own are readable, and versions of a file are easy to
    compare.
    """
    rows = [[1.0, 0.0], [0.0, -1e-9]]
    table = {"q": [0.5, 1.7], "of": {"turn": rows, "names": ["a [b,", "c"]}, "no": []}
    text = toml_text(table)
    assert tomllib.loads(text) == table
    assert "q = [0.5, 1.7]\n" in text
    assert re.search(
        r"^turn = \[\n *\[1.0, 0.0\],\n *\[0.0, -1e-09\],\n\]$", text, re.M
    )


FUZZ = """margin = 0.01
[robot]
name = "planar3r"
velocity = {joint1 = 2.5}
[start]
q = [0.5, 1.7, -1.7]
[goal]
type = "pose"
frame = "tip"
pose = {position = [4, 1, 0], rotation = [0, 0, 0.6, 0.8]}
[[scene.obstacles]]
type = "box"
name = "a"
size = [0.1, 0.2, 0.3]
position = [0, 9, 0]
[motion_limits]
acceleration = [10, 20, 30]
[options]
intervals = 50
"""


def test_damaged_scenario_raises_only_scenario_error(
    rng: np.random.Generator, tmp_path: Path
) -> None:
    path = tmp_path / "s.toml"
    lines = FUZZ.splitlines()
    whole = np.frombuffer(FUZZ.encode(), dtype=np.uint8)
    refused = 0
    for case in range(150):
        if case % 3 == 0:  # lines swapped or left out
            kept = (
                rng.permutation(len(lines))[:-1] if case % 2 else np.arange(len(lines))
            )
            kept = np.delete(kept, rng.integers(len(kept)))
            content = "\n".join(lines[i] for i in kept).encode()
        else:
            damaged = whole.copy()
            damaged[rng.integers(len(whole), size=2)] = rng.integers(32, 127, size=2)
            end = int(rng.integers(len(whole))) if case % 4 == 0 else len(whole)
            content = damaged[:end].tobytes()
        path.write_bytes(content)
        try:
            load_scenario(path)
        except ScenarioError as error:
            assert str(path) in str(error)
            refused += 1
    assert 75 < refused < 150
