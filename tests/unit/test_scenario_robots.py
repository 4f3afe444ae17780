"""Scenarios with robots that no file holds; hints in messages about misspelt keys."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import tominpmp as tm
from tominpmp.description.files import find_robot, robot_names
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ScenarioError
from tominpmp.files.scenario import difference_of
from tominpmp.robot.robot import Robot

URDF = find_robot("planar3r").urdf
START, GOAL = [0.5, 1.7, -1.7], [0.6, 1.6, -1.6]
SRDF = """<robot name="planar3r">
  <group name="arm"><joint name="joint1"/><joint name="joint2"/></group>
  <group_state name="up" group="arm"><joint name="joint1" value="1.5"/></group_state>
  <disable_collisions link1="link1" link2="link3"/>
  <rotor_params><joint name="joint2" mass="0.25" gear_ratio="2.0"/></rotor_params>
</robot>"""


def from_text() -> Robot:
    text = URDF.read_text("utf-8")
    return tm.load_robot(text, srdf=SRDF, effort={"joint1": 9.0}, gravity=(0, 1, 0))


def from_model() -> Robot:
    model = pin.buildModelFromUrdf(str(URDF))
    model.armature[:] = [0.1, 0.0, 0.2]
    model.lowerEffortLimit[1] = -3.0
    model.upperPositionLimit[2] = np.finfo(float).max
    geometry = pin.GeometryModel()
    frame = model.getFrameId("tip")
    joint = model.frames[frame].parentJoint
    place = model.frames[frame].placement
    cone = pin.GeometryObject("cone", joint, frame, place, pin.hppfcl.Cone(0.1, 0.2))
    ball = pin.GeometryObject("ball", joint, frame, place, pin.hppfcl.Capsule(0.1, 0.2))
    geometry.addGeometryObject(cone)
    geometry.addGeometryObject(ball)
    return tm.load_robot(model, geometry=geometry)


def saved_and_loaded(robot: Robot, folder: Path) -> tuple[tm.Problem, tm.Problem]:
    problem = tm.Problem(robot, START, tm.JointGoal(GOAL), self_collision=False)
    path = tm.save_scenario(folder / "cell.toml", problem)
    return problem, tm.load_scenario(path).problem


@pytest.mark.parametrize("make", [from_text, from_model])
def test_robot_without_a_file_is_saved_beside_its_scenario(
    make: Any, tmp_path: Path
) -> None:
    robot = make()
    load = tm.Payload(
        0.1, "tip", com=(0.1, 0, 0), geometry=[tm.Sphere("s", radius=0.05)]
    )
    problem, found = saved_and_loaded(robot.with_payload(load), tmp_path)
    assert not difference_of(found.robot, problem.robot)
    assert found.robot.urdf_path == tmp_path / "cell_robot.urdf"
    state = START, [1.0, -2.0, 0.5], [3.0, 1.0, -1.0]
    states = [np.array([row]) for row in state]
    torques = [RobotDynamics(p.robot).inverse(*states) for p in (problem, found)]
    np.testing.assert_allclose(torques[1], torques[0], rtol=1e-12)
    again = tmp_path / "again"
    again.mkdir()
    # The loaded robot has files, so that it is saved and loaded without rounding.
    assert saved_and_loaded(found.robot, again)[1].robot == found.robot


def test_robot_in_a_parent_folder_of_its_scenario_is_found_again(
    tmp_path: Path,
) -> None:
    """Regression: paths of robot files were saved without "..", which names another
    path, and behind a link to a folder another file.
    """
    (tmp_path / "arms" / "cells").mkdir(parents=True)
    (tmp_path / "linked").symlink_to(tmp_path / "arms" / "cells")
    (tmp_path / "arms" / "arm.urdf").write_text(URDF.read_text("utf-8"))
    for folder in ("arms/cells", "linked"):
        robot = tm.load_robot(tmp_path / folder / "../arm.urdf")
        for place in (tmp_path, tmp_path / folder, tmp_path / folder / ".."):
            problem, loaded = saved_and_loaded(robot, place)
            assert loaded.robot == problem.robot


def test_srdf_given_as_text_survives_saving_and_loading(tmp_path: Path) -> None:
    problem, found = saved_and_loaded(from_text(), tmp_path)
    mine, theirs = found.robot.srdf, problem.robot.srdf
    assert mine is not None and theirs is not None
    assert mine.path == tmp_path / "cell_robot.srdf"
    assert mine.disabled_pairs == theirs.disabled_pairs == (("link1", "link3"),)
    assert mine.states == theirs.states == {("arm", "up"): {"joint1": 1.5}}
    assert mine.groups == theirs.groups
    assert mine.rotor_inertias == {"joint2": 1.0}
    assert found.robot.armature[1] == 1.0


def test_states_of_several_groups_survive_saving_and_loading(tmp_path: Path) -> None:
    """Of several group states with one name, the unlocked joints decide which state
    holds.
    """
    up = '<group_state name="up" group="{0}"><joint name="joint1" value="{1}"/>'
    joints = '<joint name="joint1"/>', '<joint name="joint1"/><joint name="joint2"/>'
    srdf = "".join(
        f'<group name="g{i}">{inside}</group>{up.format(f"g{i}", i)}</group_state>'
        for i, inside in enumerate(joints)
    )
    text = URDF.read_text("utf-8")
    robot = tm.load_robot(text, srdf=f'<robot name="planar3r">{srdf}</robot>')
    problem, found = saved_and_loaded(robot, tmp_path)
    for locks in ({"joint3": 0.0}, {"joint2": 0.0, "joint3": 0.0}):
        one, other = (p.robot.with_locked(locks) for p in (problem, found))
        assert one.group_states == other.group_states


@pytest.mark.parametrize("reason", ["", "Never", "User"])
def test_reasons_of_disabled_pairs_survive_saving_and_loading(
    reason: str, tmp_path: Path
) -> None:
    """A disabled pair of distant links without a reason counts as links that never
    touch.
    """
    pair = '<disable_collisions link1="base" link2="link3" reason="{}"/>'
    srdf = f'<robot name="planar3r">{pair.format(reason)}</robot>'
    robot = tm.load_robot(URDF.read_text("utf-8"), srdf=srdf)
    problem, found = saved_and_loaded(robot, tmp_path)
    assert problem.robot.srdf.never_touch == found.robot.srdf.never_touch
    assert bool(found.robot.srdf.never_touch) == (reason != "User")


def test_save_scenario_does_not_overwrite_robot_files_of_others(tmp_path: Path) -> None:
    problem, found = saved_and_loaded(from_text(), tmp_path)
    changed = problem.robot.with_changes(damping=0.5)
    # A scenario is replaced together with the files of its robot.
    assert saved_and_loaded(changed, tmp_path)[1].robot.damping.tolist() == [0.5] * 3
    scenario, urdf = tmp_path / "cell.toml", found.robot.urdf_path
    scenario.rename(tmp_path / "other.toml")
    urdf.write_bytes(urdf.read_bytes() + b"<!-- mine -->")
    before = urdf.read_bytes()
    with pytest.raises(ScenarioError, match=r"cell_robot\.urdf: would be") as caught:
        saved_and_loaded(problem.robot, tmp_path)
    assert caught.value.path == urdf
    assert urdf.read_bytes() == before
    assert not scenario.exists()


def test_difference_of_names_the_first_field_in_which_robots_differ() -> None:
    one = from_text()
    assert not difference_of(one, one)
    heavy = one.model.copy()
    heavy.inertias[2] = heavy.inertias[2] + heavy.inertias[2]
    for change in ({"damping": 1.0}, {"gravity": (0, 0, 0)}):
        assert difference_of(one, one.with_changes(**change)) == next(iter(change))
    assert difference_of(one, replace(one, model=heavy)) == "inertias"


def test_scenario_text_rejects_a_robot_without_a_file(tmp_path: Path) -> None:
    from tominpmp.files.scenario import scenario_text

    problem = tm.Problem(from_text(), START, tm.JointGoal(GOAL))
    with pytest.raises(ScenarioError, match=r"<text of \d+ bytes>.*from a file"):
        scenario_text(tmp_path / "s.toml", problem)
    assert list(tmp_path.iterdir()) == []


SMALL = """
{top}
[robot]
name = "planar3r"
{robot}
[start]
q = [0.5, 1.7, -1.7]
[goal]
type = "joint"
q = [0.6, 1.6, -1.6]
{goal}
[options]
{options}
[[scene.obstacles]]
type = "sphere"
name = "O"
radius = 0.1
{obstacle}
"""


@pytest.mark.parametrize(
    ("place", "line", "key", "meant"),
    [
        ("top", "margins = 0.1", "margins", "margin"),
        ("robot", "dampings = 0.1", "robot.dampings", "damping"),
        ("goal", "stat = 'start'", "goal.stat", "state"),
        ("options", "interval = 3", "options.interval", "intervals"),
        ("obstacle", "pos = [1, 0, 0]", "scene.obstacles[0].pos", "position"),
    ],
)
def test_message_about_a_misspelt_key_suggests_the_right_key(
    place: str, line: str, key: str, meant: str, tmp_path: Path
) -> None:
    blanks = dict.fromkeys(("top", "robot", "goal", "options", "obstacle"), "")
    path = tmp_path / "s.toml"
    path.write_text(SMALL.format(**(blanks | {place: line})), "utf-8")
    with pytest.raises(ScenarioError, match=rf"did you mean {meant}\b") as caught:
        tm.load_scenario(path)
    assert str(caught.value).startswith(f"{path}: {key}: there is no such key")
    assert caught.value.key == key


def test_message_about_a_misspelt_type_suggests_the_right_type(tmp_path: Path) -> None:
    text = SMALL.format(top="", robot="", goal="", options="", obstacle="")
    path = tmp_path / "s.toml"
    path.write_text(text.replace('"sphere"', '"spheer"'), "utf-8")
    with pytest.raises(ScenarioError, match=r"'spheer' \(did you mean sphere\?\)"):
        tm.load_scenario(path)


@pytest.mark.skipif("panda" not in robot_names(), reason="needs example-robot-data")
def test_robot_with_mimic_joints_survives_saving_and_loading(tmp_path: Path) -> None:
    files = find_robot("panda")
    folders = [files.urdf.parents[3]]
    robot = tm.load_robot(
        files.urdf.read_text("utf-8"),
        package_dirs=folders,
        group="panda_arm",
        srdf=None if files.srdf is None else files.srdf.read_text("utf-8"),
    )
    limits = robot.limits.position_lower, robot.limits.position_upper
    start, goal = (np.clip(np.full(7, value), *limits) for value in (0.0, 0.1))
    problem = tm.Problem(robot, start, tm.JointGoal(goal), self_collision=False)
    path = tm.save_scenario(tmp_path / "cell.toml", problem)
    assert not difference_of(tm.load_scenario(path).problem.robot, robot)
