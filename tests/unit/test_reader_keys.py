"""Readers of files use documented keys, and refuse unknown keys or warn of them.

For joint_limits.yaml see test_joint_limits_files.py, for groups test_groups.py.
"""

from __future__ import annotations

import contextlib
import json
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_samples import chain, one_joint, write
from scenario_samples import REQUEST, SCENE, changed
from scenario_samples import write as write_moveit

import tominpmp as tm
from tominpmp.exceptions import RobotLoadError, ScenarioError, TominpmpWarning
from tominpmp.robot.robot import Robot, load_robot

# MoveIt's requests and scenes


@pytest.mark.parametrize(
    ("steps", "warning"),
    [
        (
            ("reference_trajectories", [{"joint_trajectory": [{"x": 1}]}]),
            "reference_tr",
        ),
        (("max_velocty_scaling_factor", 0.5), "max_velocty_scaling_factor"),
        (
            ("start_state", "joint_states", {"name": ["a"]}),
            r"start_state\.joint_states",
        ),
        (
            ("goal_constraints", 0, "joint_constraints", 0, "tolerance", 0.1),
            r"goal_constraints\[0\]\.joint_constraints\[0\]\.tolerance",
        ),
        (("goal_constraints", 0, "joint_constraint", [{"a": 1}]), "joint_constraint"),
        (("max_acceleration_scaling_factor", 0.5), "no limits of accelerations"),
    ],
)
def test_unread_keys_of_requests_give_a_warning(
    planar3r: Robot, steps: tuple[Any, ...], warning: str, tmp_path: Path
) -> None:
    paths = write_moveit(tmp_path, request=changed(REQUEST, *steps))
    with pytest.warns(TominpmpWarning, match=warning):
        tm.load_moveit(planar3r, *paths)


@pytest.mark.parametrize(
    ("steps", "key"),
    [
        (("max_cartesian_speed", 0.25), "max_cartesian_speed"),
        (("max_cartesian_speed", "fast"), "max_cartesian_speed"),
        (
            ("path_constraints", {"joint_constraints": [{"joint_name": "joint1"}]}),
            "path_constraints.joint_constraints",
        ),
        (
            ("goal_constraints", 0, "visibility_constraints", [{"target_radius": 1}]),
            "goal_constraints[0].visibility_constraints",
        ),
        (
            ("start_state", "attached_collision_objects", [{"object": {"id": "a"}}]),
            "start_state.attached_collision_objects",
        ),
        (("group_name", 7), "group_name"),
    ],
)
def test_requests_with_unsupported_conditions_are_refused(
    planar3r: Robot, steps: tuple[Any, ...], key: str, tmp_path: Path
) -> None:
    paths = write_moveit(tmp_path, request=changed(REQUEST, *steps))
    with pytest.raises(ScenarioError) as caught:
        tm.load_moveit(planar3r, *paths)
    assert caught.value.key == key


def test_planner_settings_of_requests_give_no_warning(
    planar3r: Robot, tmp_path: Path
) -> None:
    """All files of MotionBenchMaker have settings; default values are ignored."""
    request = REQUEST | {
        "workspace_parameters": {"min_corner": [-1, -1, -1], "max_corner": [1, 1, 1]},
        "planner_id": "RRTConnect",
        "pipeline_id": "ompl",
        "num_planning_attempts": 2,
        "allowed_planning_time": 60,
        "max_acceleration_scaling_factor": 0,
        "max_cartesian_speed": 0.0,
        "cartesian_speed_limited_link": "",
        "reference_trajectories": [],
        "a_key_to_come": {"x": 0, "y": [], "z": ""},
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        problem = tm.load_moveit(planar3r, *write_moveit(tmp_path, request=request))
    assert problem == tm.load_moveit(planar3r, *write_moveit(tmp_path))


def test_acceleration_limits_are_scaled_by_the_request(
    planar3r: Robot, tmp_path: Path
) -> None:
    limits = tm.MotionLimits(acceleration={"joint1": 8.0}, jerk=100.0)
    robot = replace(planar3r, motion_limits=limits)
    request = REQUEST | {"max_acceleration_scaling_factor": 0.25}
    found = tm.load_moveit(robot, *write_moveit(tmp_path, request=request))
    assert found.motion_limits is not None
    names = robot.joint_names
    rows = found.motion_limits.by_joint("acceleration", names)
    np.testing.assert_array_equal(rows, [2.0, np.inf, np.inf])
    assert found.motion_limits.by_joint("jerk", names).tolist() == [100.0] * 3


@pytest.mark.parametrize(
    ("steps", "warning"),
    [
        (("wold", {"collision_objects": [{"id": "a"}]}), "not read: wold"),
        # Keys may have any length and characters.
        (("\x1b[31m" + 200 * "x", 1), r"not read: \\x1b\[31mx{60,70}\.\.\.$"),
        (("world", "collision_object", [{"id": "a"}]), r"world\.collision_object"),
        (
            ("world", "collision_objects", 0, "padding", 0.1),
            r"collision_objects\[0\]\.padding",
        ),
        (("link_padding", [{"link_name": "a", "padding": 0.1}]), "link_padding"),
        (
            ("robot_state", "multi_dof_joint_state", "twist", [{"linear": {"x": 1}}]),
            "multi_dof_joint_state.twist",
        ),
    ],
)
def test_unread_keys_of_scenes_give_a_warning(
    steps: tuple[Any, ...], warning: str, tmp_path: Path
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(changed(SCENE, *steps)))
    with pytest.warns(TominpmpWarning, match=warning):
        tm.load_moveit_scene(path)


# Motion limits and scenarios: their own formats, which refuse what they do not know

LIMITS = "limits.yaml"
SCENARIO = "scenario.toml"
TOML = """
[robot]
name = "planar3r"
[start]
q = [0.5, 1.7, -1.7]
[goal]
type = "joint"
q = [2.0, -1.0, 0.5]
"""


@pytest.mark.parametrize(
    "text",
    [
        "accelerations: 5",
        "max_acceleration: 5",
        "joints: {joint1: {max_jerk: 5}}",
        "joints: {joint1: {effort_curve: {stall: 5, no_load_speed: 3, k: 1}}}",
        "joints: {elbow: {jerk: 5}}",
        "velocity: 3",
    ],
)
def test_motion_limits_refuse_unknown_keys(
    planar3r: Robot, text: str, tmp_path: Path
) -> None:
    path = tmp_path / LIMITS
    path.write_text(text)
    with pytest.raises(ScenarioError):
        tm.load_motion_limits(path, planar3r)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("[robot]", "speed = 3\n[robot]"),
        ("[robot]", "[robot]\nacceleration = 3"),
        ("[robot]", "[robot]\nlimit = 'datasheet'"),
        ("[robot]", "[robot]\nmotion_limits = {accelerations = 3}"),
        ("[start]", "[start]\nqq = 1"),
        ("[start]", "[motion_limits]\nvelocity = 3\n[start]"),
        ("[start]", "[motion_limits]\njerks = 3\n[start]"),
        ("[start]", "[scene]\nobstacle = []\n[start]"),
        ("[start]", "[options]\ninterval = 3\n[start]"),
        ('type = "joint"', 'type = "joint"\nstates = "x"'),
    ],
)
def test_scenarios_refuse_unknown_keys(old: str, new: str, tmp_path: Path) -> None:
    path = tmp_path / SCENARIO
    path.write_text(TOML.replace(old, new, 1))
    with pytest.raises(ScenarioError, match="no such key"):
        tm.load_scenario(path)
    path.write_text(TOML)
    assert tm.load_scenario(path).problem.motion_limits is None


# URDF files


def test_accelerations_and_jerks_of_a_urdf_file_are_limits(tmp_path: Path) -> None:
    limit = '<limit lower="-1" upper="2" effort="10" velocity="3" {}/>'
    text = one_joint(limit=limit.format('acceleration="7" deceleration="5" jerk="90"'))
    robot = load_robot(write(tmp_path, text))
    assert robot.motion_limits == tm.MotionLimits(
        acceleration={"j1": 5.0}, jerk={"j1": 90.0}
    )
    text = one_joint(limit=limit.format('deceleration="5"'))
    robot = load_robot(write(tmp_path, text))
    assert robot.motion_limits == tm.MotionLimits(acceleration={"j1": 5.0})
    # Files of Drake have a prefix; attributes with another prefix are not read.
    text = one_joint(limit=limit.format('drake:acceleration="6" x:velocitys="1"'))
    robot = load_robot(write(tmp_path, text))
    assert robot.motion_limits == tm.MotionLimits(acceleration={"j1": 6.0})
    text = one_joint(limit=limit.format('acceleration="0"'))
    assert load_robot(write(tmp_path, text)).motion_limits is None
    for wrong in ('acceleration="-1"', 'jerk="fast"'):
        with pytest.raises(RobotLoadError, match="joint j1: limit"):
            load_robot(write(tmp_path, one_joint(limit=limit.format(wrong))))


@pytest.mark.parametrize(
    ("old", "new", "warning"),
    [
        ("<inertial>", "<inertials>", r"<inertials> of link l1 .*<inertial>"),
        (" effort=", " effort_=", "'effort_' of <limit> of joint j1"),
        ("<axis xyz=", "<axis xy=", "'xy' of <axis>"),
        ("</joint>", '<dynamic friction="3"/></joint>', "<dynamic> of joint j1"),
        ('ixx="', 'IXX="', "attribute 'IXX' of <inertia> of link"),
        (
            "</joint>",
            '<safety_controller soft_lower_limit="-0.5" soft_upper_limit="2"/></joint>',
            "soft limits within .* not kept: j1",
        ),
    ],
)
def test_unread_urdf_parts_that_change_motions_give_a_warning(
    old: str, new: str, warning: str, tmp_path: Path
) -> None:
    text = one_joint().replace(old, new)
    if "inertials" in new:
        text = text.replace("</inertial>", "</inertials>")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        # The robot may be refused, as it has no limit or no inertia.
        with contextlib.suppress(RobotLoadError):
            load_robot(write(tmp_path, text))
    found = [str(item.message) for item in caught]
    assert any(re.search(warning, message) for message in found), found


def test_urdf_parts_for_other_programs_give_no_warning(tmp_path: Path) -> None:
    inside = (
        '<safety_controller soft_lower_limit="-1" soft_upper_limit="2" k_velocity="9"/>'
        '<calibration rising="0"/><limits_of_others/>'
    )
    text = chain(inside, inside).replace(
        "</robot>",
        '<transmission name="t"><joint name="j1"/><actuator name="m">'
        "<mechanicalReduction>50</mechanicalReduction></actuator></transmission>"
        "<gazebo><plugin/></gazebo><ros2_control/></robot>",
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert load_robot(write(tmp_path, text)).n == 2


def test_message_about_an_empty_file_says_that_it_is_empty(
    planar3r: Robot, tmp_path: Path
) -> None:
    path = tmp_path / "scene.yaml"
    path.touch()
    with pytest.raises(ScenarioError, match=r"scene\.yaml: is empty, expected a table"):
        tm.load_moveit_scene(path, planar3r)


def test_scaling_that_leaves_no_limit_names_the_factor_and_the_file(
    planar3r: Robot, tmp_path: Path
) -> None:
    limits = tm.MotionLimits(acceleration=4.0)
    robot = replace(planar3r, motion_limits=limits)
    for kind in ("velocity", "acceleration"):
        key = f"max_{kind}_scaling_factor"
        paths = write_moveit(tmp_path, request=REQUEST | {key: 1e-320})
        with pytest.raises(
            ScenarioError, match=f"request.yaml: {key}: {kind}"
        ) as error:
            tm.load_moveit(robot, *paths)
        assert error.value.key == key
