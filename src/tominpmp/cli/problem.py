"""The problem of a command: from its options, a scenario, or files of MoveIt."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.cli.options import (
    Asked,
    PlayOptions,
    ProblemOptions,
    RobotOptions,
    SceneOptions,
    is_scenario,
)
from tominpmp.cli.text_values import (
    constraint,
    joint_pairs,
    joint_values,
    obstacle,
    positions,
    vector,
    velocities,
)
from tominpmp.exceptions import OptionsError, ProblemError
from tominpmp.goals import Goal, JointGoal, PoseGoal, PositionGoal
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import Options
from tominpmp.problem import Problem
from tominpmp.robot import Robot, read_source
from tominpmp.scenario.joint_limits import load_joint_limits, load_limited_robot
from tominpmp.scenario.motion_limits import load_motion_limits
from tominpmp.scenario.moveit import load_moveit, load_moveit_scene, request_locks
from tominpmp.scenario.robot_table import OVERRIDES
from tominpmp.scenario.scenario import load_scenario
from tominpmp.scene import Scene

# What the command line may say beside a file that holds the whole problem.
KEPT = ("margin", "self_collision", "motion_limits", "constraint")
GOALS = ("goal", "goal_position", "goal_pose")


def load_problem(
    asked: Asked, options: Mapping[str, Any] | None = None
) -> tuple[Problem, Options]:
    """Load or make the problem that was asked for, and the options to plan it with.

    Args:
        asked: The problem.
        options: Options of the planner that were given; they go before those of a
            scenario.

    Raises:
        TominpmpError: If anything given is wrong or contradicts something else.
    """
    given, said = dict(options or {}), asked.options
    chosen = Options(**given)  # a wrong one is told of before a robot is loaded
    beside = {
        name: getattr(said, name)
        for name in ("margin", "self_collision")
        if getattr(said, name) is not None
    }
    asked_for = tuple(constraint(text) for text in said.constraint or ())
    if is_scenario(asked.robot):
        _refuse("a scenario file", said, KEPT)
        scenario = load_scenario(asked.robot)
        problem, chosen = scenario.problem, replace(scenario.options, **given)
    elif said.request is not None:
        if said.scene is None:
            raise ProblemError("--request needs a --scene that it belongs to", "scene")
        own = (f.name for f in fields(RobotOptions) if f.name != "group")
        _refuse("--request", said, ("scene", "request", *KEPT, *own))
        source = read_source(asked.robot, said.package_dir or (), said.srdf)
        arm = load_changed_robot(asked.robot, said, request_locks(source, said.request))
        problem, beside = load_moveit(arm, said.scene, said.request, **beside), {}
    else:
        beside["constraints"] = asked_for
        return _typed_problem(asked, beside), chosen
    limits = _limits(asked, problem.robot)
    if limits is not None:
        own_limits = problem.motion_limits
        beside["motion_limits"] = limits.over(own_limits, problem.robot.joint_names)
    if asked_for:
        beside["constraints"] = (*problem.constraints, *asked_for)
    return replace(problem, **beside) if beside else problem, chosen


def _limits(asked: Asked, robot: Robot) -> MotionLimits | None:
    """The motion limits of the command line over those of its file."""
    path, limits = asked.options.motion_limits, None
    if path is not None:
        limits = load_motion_limits(path, robot)
    if not asked.limits:
        return limits
    typed: dict[str, Any] = {
        name: joint_values(text, _flag(name)) if isinstance(text, str) else text
        for name, text in asked.limits.items()
    }
    return MotionLimits(**typed).over(limits, robot.joint_names)


def load_changed_robot(
    robot: str, said: RobotOptions, resting: Mapping[str, float] | None = None
) -> Robot:
    """Load a robot with what is said to be different, and with resting joints locked.

    Raises:
        TominpmpError: If anything in it is wrong.
    """
    locked = joint_pairs(said.lock or (), "--lock")
    changes: dict[str, Any] = {
        name: joint_values(getattr(said, name), _flag(name))
        for name in OVERRIDES
        if getattr(said, name) is not None
    }
    if said.gravity is not None:
        changes["gravity"] = vector(said.gravity, "--gravity")
    file = said.joint_limits
    return load_limited_robot(
        None if file is None else load_joint_limits(file),
        robot,
        changes,
        package_dirs=said.package_dir or (),
        srdf=said.srdf,
        group=said.group,
        limits=said.limits,
        locked_joints={**(resting or {}), **locked},
    )


def load_scene(said: PlayOptions) -> tuple[Robot, Scene]:
    """Load a robot and the obstacles around it, from a scenario or the command line.

    Raises:
        TominpmpError: If anything given is wrong or contradicts something else.
    """
    if is_scenario(said.robot):
        _refuse("a scenario file", said, ("robot", "output"))
        problem = load_scenario(said.robot).problem
        return problem.robot, problem.scene
    arm = load_changed_robot(said.robot, said)
    return arm, _obstacles(said, arm)


def _obstacles(said: SceneOptions, robot: Robot) -> Scene:
    found = [obstacle(text) for text in said.obstacle or ()]
    if said.scene is not None:
        found += load_moveit_scene(said.scene, robot)
    return Scene(found)


def _typed_problem(asked: Asked, beside: Mapping[str, Any]) -> Problem:
    """The problem of a command line that names no file with one."""
    said = asked.options
    robot = load_changed_robot(asked.robot, said)
    if said.start is None:
        raise ProblemError(
            "there is no start: give --start, or a --scene and a --request", "start"
        )
    flags = [_flag(name) for name in GOALS]
    values = [getattr(said, name) for name in GOALS]
    given = [f for f, value in zip(flags, values, strict=True) if value is not None]
    if not given:
        raise ProblemError(f"there is no goal: give {' or '.join(flags)}", "goal")
    if len(given) > 1:
        raise ProblemError(
            f"{' and '.join(given)} are given, expected one of them", "goal"
        )
    scene = _obstacles(said, robot)
    q_start = positions(said.start, "--start", robot, degrees=said.degrees)
    v_start = None
    if said.start_velocity is not None:
        v_start = velocities(
            said.start_velocity, "--start-velocity", robot, degrees=said.degrees
        )
    return Problem(
        robot,
        q_start,
        _goal(said, robot, q_start),
        scene,
        v_start=v_start,
        motion_limits=_limits(asked, robot),
        **beside,
    )


def _goal(said: ProblemOptions, robot: Robot, q_start: Array) -> Goal:
    name, text = "--goal-velocity", said.goal_velocity
    if said.goal is not None:
        q = positions(said.goal, "--goal", robot, base=q_start, degrees=said.degrees)
        if text is None:
            return JointGoal(q)
        return JointGoal(q, velocities(text, name, robot, degrees=said.degrees))
    v = None if text is None else np.array(vector(text, name))
    if said.goal_position is not None:
        frame, *point = said.goal_position
        return PositionGoal(frame, np.array(point), v)
    assert said.goal_pose is not None  # noqa: S101
    frame, *numbers = said.goal_pose
    return PoseGoal(frame, _placement(numbers), v)


def _placement(numbers: Sequence[float]) -> pin.SE3:
    """Placement from a point and a quaternion of any length but zero."""
    point, quaternion = np.array(numbers[:3]), np.array(numbers[3:])
    length = float(np.linalg.norm(quaternion))
    if not np.all(np.isfinite(numbers)) or length < 1e-9:
        raise ProblemError(
            f"--goal-pose is {' '.join(f'{x:g}' for x in numbers)}, expected finite "
            "numbers X Y Z QX QY QZ QW, the quaternion not zero",
            "goal",
        )
    return pin.SE3(pin.Quaternion(quaternion / length).matrix(), point)


def _refuse(what: str, said: RobotOptions, keep: Collection[str] = ()) -> None:
    """Refuse options that say again, or otherwise, what a file says."""
    for field in fields(said):
        if field.name not in keep and getattr(said, field.name) != field.default:
            raise OptionsError(
                f"{_flag(field.name)} contradicts {what}, which holds the whole "
                "problem",
                field.name,
            )


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"
