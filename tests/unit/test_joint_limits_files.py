"""Readers of joint_limits.yaml use each entry, or name it in a warning.

Regression: ``--joint-limits`` of the command line dropped accelerations and jerks: a
file with ``max_acceleration: 5`` gave 514 rad/s^2.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tominpmp.cli.options import ProblemOptions, RobotOptions
from tominpmp.cli.problem import load_changed_robot, load_problem
from tominpmp.exceptions import ScenarioError, TominpmpWarning
from tominpmp.files.scenario import load_scenario, save_scenario
from tominpmp.goals.joints import JointGoal
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import load_robot

START, GOAL = "0.5 1.7 -1.7", "2 -1 0.5"


def by_command_line(folder: Path) -> Problem:
    options = ProblemOptions(
        joint_limits=folder / "limits.yaml", start=START, goal=GOAL
    )
    return load_problem("planar3r", options)[0]


def by_scenario(folder: Path) -> Problem:
    path = folder / "scenario.toml"
    path.write_text(
        '[robot]\nname = "planar3r"\njoint_limits = "limits.yaml"\n'
        f"[start]\nq = [{START.replace(' ', ', ')}]\n"
        f'[goal]\ntype = "joint"\nq = [{GOAL.replace(" ", ", ")}]\n'
    )
    return load_scenario(path).problem


READERS = [by_command_line, by_scenario]


def read(reader: Callable[[Path], Problem], folder: Path, text: str) -> Problem:
    (folder / "limits.yaml").write_text(text)
    return reader(folder)


def limit(problem: Problem, name: str) -> float:
    """A limit of the second joint."""
    if name in ("acceleration", "jerk"):
        assert problem.motion_limits is not None
        joints = problem.robot.joint_names
        return float(problem.motion_limits.by_joint(name, joints)[1])
    return float(getattr(problem.robot.limits, name)[1])


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("line", "name", "value"),
    [
        ("max_velocity: 2.5", "velocity", 2.5),
        ("has_velocity_limits: true, max_velocity: 2.5", "velocity", 2.5),
        ("has_velocity_limits: false, max_velocity: 2.5", "velocity", 100.0),
        ("has_acceleration_limits: true, max_acceleration: 5", "acceleration", 5.0),
        ("max_deceleration: -4", "acceleration", 4.0),
        ("has_jerk_limits: true, max_jerk: 700", "jerk", 700.0),
        ("has_effort_limits: true, max_effort: 6.5", "effort_upper", 6.5),
        ("has_effort_limits: true, max_effort: 6.5", "effort_lower", -6.5),
        (
            "has_position_limits: true, min_position: -2, max_position: 2",
            "position_lower",
            -2.0,
        ),
        (
            "has_position_limits: true, min_position: -2, max_position: 2",
            "position_upper",
            2.0,
        ),
        ("angle_wraparound: false, max_velocity: 2.5", "velocity", 2.5),
    ],
)
def test_documented_keys_are_used(
    reader: Callable[[Path], Problem],
    line: str,
    name: str,
    value: float,
    tmp_path: Path,
) -> None:
    problem = read(reader, tmp_path, f"joint_limits: {{joint2: {{{line}}}}}")
    assert limit(problem, name) == value


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{joint2: {max_velocty: 1}}", r"joint_limits\.joint2\.max_velocty"),
        ("{joint2: {angle_wraparound: true}}", r"joint2\.angle_wraparound"),
        ("{joint2: {soft_lower_limit: -1}}", r"joint2\.soft_lower_limit"),
        (
            "{joint2: {max_acceleration: 5, max_deceleration: -4}}",
            r"the larger of .*joint2\.max_\(ac\|de\)celeration",
        ),
        ("{elbow: {max_velocity: 1}}", "has no joints 'elbow'"),
        ("{elbow: {max_acceleration: 1}}", "has no joints 'elbow'"),
        ("{}\ncartesian_limits: {max_trans_vel: 1}", "not used: cartesian_limits"),
        (f'{{}}\n"\\e[31m{200 * "x"}": 1', r"not used: \\x1b\[31mx{60,70}\.\.\.$"),
        (
            "{}\ndefault_velocity_scaling_factor: 0.1",
            r"not scaled by default_velocity_scaling_factor \(0\.1\)",
        ),
        (
            "{}\ndefault_acceleration_scaling_factor: 0.1",
            r"not scaled by default_acceleration_scaling_factor \(0\.1\)",
        ),
    ],
)
def test_unused_entries_are_named_in_a_warning(
    reader: Callable[[Path], Problem], text: str, words: str, tmp_path: Path
) -> None:
    with pytest.warns(TominpmpWarning, match=words):
        read(reader, tmp_path, f"joint_limits: {text}")


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    "line",
    [
        "max_acceleration: -5",
        "max_jerk: 0",
        "max_deceleration: 0",
        "max_acceleration: fast",
        "has_acceleration_limits: 1, max_acceleration: 5",
        "has_acceleration_limits: true",
        "has_deceleration_limits: true",
    ],
)
def test_wrong_values_are_refused(
    reader: Callable[[Path], Problem], line: str, tmp_path: Path
) -> None:
    with pytest.raises(ScenarioError, match=r"joint_limits\.joint2\."):
        read(reader, tmp_path, f"joint_limits: {{joint2: {{{line}}}}}")


def test_both_readers_give_the_same_problem(tmp_path: Path) -> None:
    text = "joint_limits: {joint1: {max_acceleration: 5, max_jerk: 90, max_effort: 9}}"
    one, other = (read(reader, tmp_path, text) for reader in READERS)
    assert one == other
    saved = save_scenario(tmp_path / "saved.toml", one)
    assert load_scenario(saved).problem == one


def test_file_may_have_limits_of_locked_joints(tmp_path: Path) -> None:
    """As in the files of an arm with a hand."""
    path = tmp_path / "limits.yaml"
    numbers = "max_velocity: 0.1, max_acceleration: 1"
    fingers = ", ".join(f"panda_finger_joint{i}: {{{numbers}}}" for i in (1, 2))
    path.write_text(f"joint_limits: {{{fingers}, panda_joint1: {{{numbers}}}}}")
    changes = RobotOptions(joint_limits=path, lock=["panda_finger_joint1=0.02"])
    robot = load_changed_robot("panda", changes)
    assert robot.limits.velocity[0] == 0.1
    assert robot.motion_limits is not None
    assert robot.motion_limits.by_joint("acceleration", robot.joint_names)[0] == 1.0
    with pytest.warns(TominpmpWarning, match="follow others are not used: panda"):
        free = load_changed_robot("panda", RobotOptions(joint_limits=path))
    assert free.limits.velocity[-1] == 0.1


def test_motion_limits_file_overrides_the_joint_limits_file(tmp_path: Path) -> None:
    """Joint limits hold where the file of motion limits has no entry."""
    (tmp_path / "limits.yaml").write_text(
        "joint_limits: {joint1: {max_acceleration: 5, max_jerk: 90}}"
    )
    more = tmp_path / "more.yaml"
    more.write_text("joints: {joint1: {acceleration: 3}, joint2: {acceleration: 4}}")
    options = ProblemOptions(
        joint_limits=tmp_path / "limits.yaml",
        start=START,
        goal=GOAL,
        motion_limits=more,
    )
    problem = load_problem("planar3r", options)[0]
    assert problem.motion_limits is not None
    names = problem.robot.joint_names
    np.testing.assert_array_equal(
        problem.motion_limits.by_joint("acceleration", names), [3, 4, np.inf]
    )
    np.testing.assert_array_equal(
        problem.motion_limits.by_joint("jerk", names), [90, np.inf, np.inf]
    )


def test_motion_limits_of_a_robot_hold_unless_the_problem_has_others(
    tmp_path: Path,
) -> None:
    from dataclasses import replace

    from tominpmp import MotionLimits, combine_robots

    own = MotionLimits(acceleration={"joint1": 5.0}, jerk=90.0)
    robot = replace(load_robot("planar3r"), motion_limits=own)
    start, goal = [0.5, 1.7, -1.7], JointGoal([2.0, -1.0, 0.5])

    def limits(**values: Any) -> list[list[float]]:
        given = MotionLimits(**values) if values else None
        problem = Problem(robot, start, goal, motion_limits=given)
        assert replace(problem, margin=0.01).motion_limits == problem.motion_limits
        path = save_scenario(tmp_path / "saved.toml", problem)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            assert load_scenario(path).problem.motion_limits == problem.motion_limits
        found = problem.motion_limits or MotionLimits()
        units = ("acceleration", "jerk", "effort_rate")
        return [found.by_joint(u, robot.joint_names).tolist() for u in units]

    none = [np.inf] * 3
    mine, slow = [5.0, np.inf, np.inf], [90.0] * 3
    assert limits() == [mine, slow, none]
    assert limits(acceleration=7.0) == [[7.0] * 3, slow, none]
    assert limits(acceleration={"joint2": 7.0}) == [[5.0, 7.0, np.inf], slow, none]
    assert limits(acceleration={"joint1": np.inf}) == [none, slow, none]
    assert limits(jerk=np.inf, effort_rate=3.0) == [mine, none, [3.0] * 3]
    part = robot.with_locked({"joint2": 0.0})
    assert part.motion_limits is not None
    assert part.motion_limits.by_joint("jerk", part.joint_names).tolist() == [90, 90]
    pair = combine_robots(
        [("a", robot, (0, 0, 0)), ("b", load_robot("planar3r"), (9, 0, 0))]
    )
    assert pair.motion_limits == MotionLimits(
        acceleration={"a/joint1": 5.0}, jerk={f"a/joint{i}": 90.0 for i in (1, 2, 3)}
    )
