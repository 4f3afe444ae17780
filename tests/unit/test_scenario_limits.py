"""Reading MoveIt's joint_limits.yaml: limits of each joint, scaling factors, wrong
files.
"""

from __future__ import annotations

import copy
import pickle
from pathlib import Path

import pytest

import tominpmp as tm
from tominpmp.exceptions import ScenarioError
from tominpmp.files.limits import load_joint_limits, load_motion_limits
from tominpmp.robot.robot import load_robot

FULL = """
default_velocity_scaling_factor: 0.1
default_acceleration_scaling_factor: 0.5
joint_limits:
  joint1:
    has_velocity_limits: true
    max_velocity: 2.5
    has_acceleration_limits: true
    max_acceleration: 3.75
    has_jerk_limits: true
    max_jerk: 7500
    has_position_limits: true
    min_position: 0.25
    max_position: 2
  joint2:
    has_velocity_limits: false
    max_velocity: 0
    has_acceleration_limits: false
    max_acceleration: 0
  joint3:
    max_velocity: 1
    has_effort_limits: true
    max_effort: 2.0
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "joint_limits.yaml"
    path.write_text(text)
    return path


def test_minimum_position_above_the_maximum_is_refused(tmp_path: Path) -> None:
    text = FULL.replace("min_position: 0.25", "min_position: 2.5")
    with pytest.raises(ScenarioError, match=r"min_position: is 2\.5, expected"):
        load_joint_limits(write(tmp_path, text))


def test_joint_limits_file_is_read_into_limits_of_each_joint(tmp_path: Path) -> None:
    limits = load_joint_limits(write(tmp_path, FULL))
    assert limits.velocity == {"joint1": 2.5, "joint3": 1.0}
    assert limits.acceleration == {"joint1": 3.75}
    assert limits.jerk == {"joint1": 7500.0}
    assert limits.effort == {"joint3": 2.0}
    assert limits.position_lower == {"joint1": 0.25}
    assert limits.position_upper == {"joint1": 2.0}
    assert limits.velocity_scaling == 0.1
    assert limits.acceleration_scaling == 0.5
    with pytest.raises(TypeError):
        limits.velocity["joint1"] = 1.0  # type: ignore[index]


@pytest.mark.parametrize(
    "text",
    [
        "joint_limits: {joint1: {max_velocity: 1e308}}",
        "jerk: 1e308",
        "joints: {joint1: {effort_curve: {stall: 1e308, no_load_speed: 3}}}",
    ],
)
def test_files_with_numbers_that_are_too_large_are_named(
    text: str, tmp_path: Path
) -> None:
    """Regression: the errors were those of a caller's arguments."""
    path = write(tmp_path, text)
    with pytest.raises(ScenarioError, match=f"{path.name}: .* is 1e.308, expected"):
        if text.startswith("joint_limits"):
            load_joint_limits(path)
        else:
            load_motion_limits(path, load_robot("planar3r"))


def test_joint_limits_can_be_copied_and_pickled(tmp_path: Path) -> None:
    """Regression: the read-only mappings of the limits could be neither copied nor
    pickled.
    """
    limits = load_joint_limits(write(tmp_path, FULL))
    for other in (copy.deepcopy(limits), pickle.loads(pickle.dumps(limits))):
        assert other == limits
        with pytest.raises(TypeError):
            other.velocity["joint1"] = 1.0  # type: ignore[index]


def test_overrides_change_the_limits_of_the_robot(tmp_path: Path) -> None:
    limits = load_joint_limits(write(tmp_path, FULL))
    plain = load_robot("planar3r")
    robot = load_robot("planar3r", **limits.overrides())
    assert robot == plain.with_changes(**limits.overrides())
    assert robot.limits.velocity.tolist() == [2.5, plain.limits.velocity[1], 1.0]
    assert robot.limits.position_lower[0] == 0.25
    assert robot.limits.position_upper[0] == 2.0
    assert robot.limits.effort_upper[2] == 2.0
    assert robot.limits.effort_lower[2] == -2.0
    scaled = limits.overrides(scaled=True)
    assert scaled["velocity"] == pytest.approx({"joint1": 0.25, "joint3": 0.1})


@pytest.mark.parametrize(
    "node", ["/**", "/move_group", "rviz: {ros__parameters: {a: 1}}\nmove_group"]
)
def test_ros2_parameter_files_are_unwrapped(node: str, tmp_path: Path) -> None:
    """``ros2 param dump`` and files of several nodes nest the limits in the names of
    nodes.
    """
    inner = "\n".join(f"      {line}" for line in FULL.splitlines())
    text = f"{node}:\n  ros__parameters:\n    robot_description_planning:{inner}\n"
    assert load_joint_limits(write(tmp_path, text)).velocity["joint1"] == 2.5


def test_limits_of_ros2_control_warn_about_unused_keys(tmp_path: Path) -> None:
    text = "controller_manager: {ros__parameters: {update_rate: 9, joint_limits: {%s}}}"
    path = write(tmp_path, text % "joint2: {max_velocity: 2}")
    with pytest.warns(tm.TominpmpWarning, match="not used: update_rate"):
        assert load_joint_limits(path).velocity == {"joint2": 2.0}


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        ("", "", "table"),
        ("limits: {}", "joint_limits", "is missing"),
        ("joint_limits: [1]", "joint_limits", "table"),
        ("joint_limits: {a: 1}", "joint_limits.a", "table"),
        (
            "joint_limits: {a: {has_velocity_limits: yes}}",
            "joint_limits.a.has_velocity_limits",
            "true or false",
        ),
        (
            "joint_limits: {a: {has_velocity_limits: true}}",
            "joint_limits.a.max_velocity",
            "is missing",
        ),
        (
            "joint_limits: {a: {max_velocity: -1}}",
            "joint_limits.a.max_velocity",
            "greater than zero",
        ),
        (
            "joint_limits: {a: {max_velocity: fast}}",
            "joint_limits.a.max_velocity",
            "number",
        ),
        (
            "joint_limits: {}\ndefault_velocity_scaling_factor: 2",
            "default_velocity_scaling_factor",
            "greater than 0, at most 1",
        ),
        (
            "a: {joint_limits: {}}\nb: {ros__parameters: {joint_limits: {}}}",
            "b.ros__parameters.joint_limits",
            "is in the table a, too",
        ),
    ],
)
def test_message_about_wrong_joint_limits_names_the_key(
    text: str, key: str, words: str, tmp_path: Path
) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ScenarioError, match=words) as caught:
        load_joint_limits(path)
    assert caught.value.path == path
    assert (caught.value.key or "") == key


def test_number_beyond_all_sizes_is_refused_with_its_key(tmp_path: Path) -> None:
    """Regression: the message named neither the key nor the largest number."""
    path = write(tmp_path, "joint_limits: {joint1: {max_velocity: 1e308}}")
    with pytest.raises(ScenarioError, match=r"is 1e\+308") as caught:
        load_joint_limits(path)
    assert caught.value.key == "joint_limits.joint1.max_velocity"
