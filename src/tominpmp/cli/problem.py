"""The problem of a command: from its options, a scenario, or files of MoveIt."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.cli.options import (
    PlayOptions,
    ProblemArguments,
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
from tominpmp.files.limits import (
    load_joint_limits,
    load_limited_robot,
    load_motion_limits,
)
from tominpmp.files.moveit import load_moveit, load_moveit_scene, request_locks
from tominpmp.files.robot_table import OVERRIDES
from tominpmp.files.scenario import load_scenario
from tominpmp.goals import Goal, JointGoal, PoseGoal, PositionGoal
from tominpmp.kinematics import prismatic_joints
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import EFFORTS, Options
from tominpmp.problem import Problem
from tominpmp.problem.state_checks import IN_RADIANS
from tominpmp.robot import Robot, read_source
from tominpmp.scene import Scene

# What the command line may say beside a file that holds the whole problem.
KEPT = ("margin", "self_collision", "motion_limits", "constraint")
# Few joints turn further, one way [rad].
LARGE_ANGLE = 2.0 * np.pi + 1e-3
GOALS = ("goal", "goal_position", "goal_pose")


def load_problem(
    problem_args: ProblemArguments, options: Mapping[str, Any] | None = None
) -> tuple[Problem, Options]:
    """Load or make the problem that was asked for, and the options to plan it with.

    Args:
        problem_args: The problem.
        options: Options of the planner that were given; they go before those of a
            scenario.

    Raises:
        TominpmpError: If anything given is wrong or contradicts something else.
    """
    given, args = dict(options or {}), problem_args.options
    if given.get("effort", EFFORTS[0]) not in EFFORTS:
        raise OptionsError(
            f"--planning-effort is {given['effort']!r}, expected "
            f"{', '.join(EFFORTS)}; torque limits are --effort",
            "--planning-effort",
        )
    chosen = Options(**given)  # a wrong one is told of before a robot is loaded
    beside = {
        name: getattr(args, name)
        for name in ("margin", "self_collision")
        if getattr(args, name) is not None
    }
    asked_for = tuple(constraint(text) for text in args.constraint or ())
    if is_scenario(problem_args.robot):
        _refuse("a scenario file", args, KEPT)
        scenario = load_scenario(problem_args.robot)
        problem, chosen = scenario.problem, replace(scenario.options, **given)
    elif args.request is not None:
        if args.scene is None:
            raise ProblemError("--request needs a --scene that it belongs to", "scene")
        own = (f.name for f in fields(RobotOptions) if f.name != "group")
        _refuse("--request", args, ("scene", "request", *KEPT, *own))
        source = read_source(problem_args.robot, args.package_dir or (), args.srdf)
        arm = load_changed_robot(
            problem_args.robot, args, request_locks(source, args.request)
        )
        problem, beside = load_moveit(arm, args.scene, args.request, **beside), {}
    else:
        beside["constraints"] = asked_for
        return _typed_problem(problem_args, beside), chosen
    limits = _limits(problem_args, problem.robot)
    if limits is not None:
        own_limits = problem.motion_limits
        beside["motion_limits"] = limits.over(own_limits, problem.robot.joint_names)
    if asked_for:
        beside["constraints"] = (*problem.constraints, *asked_for)
    return replace(problem, **beside) if beside else problem, chosen


def check_given(problem_args: ProblemArguments) -> None:
    """Check that there is a problem: in a file, or in options.

    Raises:
        ProblemError: If there is a robot alone.
    """
    args, robot = problem_args.options, problem_args.robot
    if not is_scenario(robot) and args.request is None and args.start is None:
        raise ProblemError(
            f"{robot!r} is no scenario file (.toml): expected one, or a robot with "
            "--scene and --request, or with --start and a goal",
            "scenario",
        )


def _limits(problem_args: ProblemArguments, robot: Robot) -> MotionLimits | None:
    """The motion limits of the command line over those of its file."""
    path, limits = problem_args.options.motion_limits, None
    if path is not None:
        limits = load_motion_limits(path, robot)
    if not problem_args.limits:
        return limits
    typed: dict[str, Any] = {
        name: joint_values(text, _flag(name)) if isinstance(text, str) else text
        for name, text in problem_args.limits.items()
    }
    return MotionLimits(**typed).over(limits, robot.joint_names)


def load_changed_robot(
    robot: str, args: RobotOptions, resting: Mapping[str, float] | None = None
) -> Robot:
    """Load a robot with what is said to be different, and with resting joints locked.

    Raises:
        TominpmpError: If anything in it is wrong.
    """
    if args.effort in EFFORTS:
        raise OptionsError(
            f"--effort is {args.effort!r}, expected torque limits (N m or N); how far "
            f"to search is --planning-effort {args.effort}",
            "--effort",
        )
    locked = joint_pairs(args.lock or (), "--lock")
    changes: dict[str, Any] = {
        name: joint_values(getattr(args, name), _flag(name))
        for name in OVERRIDES
        if getattr(args, name) is not None
    }
    if args.gravity is not None:
        changes["gravity"] = vector(args.gravity, "--gravity")
    file = args.joint_limits
    return load_limited_robot(
        None if file is None else load_joint_limits(file),
        robot,
        changes,
        package_dirs=args.package_dir or (),
        srdf=args.srdf,
        group=args.group,
        limits=args.limits,
        locked_joints={**(resting or {}), **locked},
    )


def load_scene(args: PlayOptions) -> tuple[Robot, Scene]:
    """Load a robot and the obstacles around it, from a scenario or the command line.

    Raises:
        TominpmpError: If anything given is wrong or contradicts something else.
    """
    if is_scenario(args.robot):
        _refuse("a scenario file", args, ("robot", "output"))
        problem = load_scenario(args.robot).problem
        return problem.robot, problem.scene
    arm = load_changed_robot(args.robot, args)
    return arm, _obstacles(args, arm)


def _obstacles(args: SceneOptions, robot: Robot) -> Scene:
    found = [obstacle(text) for text in args.obstacle or ()]
    if args.scene is not None:
        found += load_moveit_scene(args.scene, robot)
    return Scene(found)


def _typed_problem(
    problem_args: ProblemArguments, beside: Mapping[str, Any]
) -> Problem:
    """The problem of a command line that names no file with one."""
    args = problem_args.options
    robot = load_changed_robot(problem_args.robot, args)
    if args.start is None:
        raise ProblemError(
            "there is no start: give --start, or a --scene and a --request", "start"
        )
    given = [_flag(name) for name in GOALS if getattr(args, name) is not None]
    if not given:
        flags = " or ".join(map(_flag, GOALS))
        raise ProblemError(f"there is no goal: give {flags}", "goal")
    if len(given) > 1:
        raise ProblemError(
            f"{' and '.join(given)} are given, expected one of them", "goal"
        )
    scene = _obstacles(args, robot)
    q_start = positions(args.start, "--start", robot, degrees=args.degrees)
    v_start = _velocities(args, "start_velocity", robot)
    goal, limits = _goal(args, robot, q_start), _limits(problem_args, robot)
    try:
        return Problem(
            robot, q_start, goal, scene, v_start=v_start, motion_limits=limits, **beside
        )
    except ProblemError as error:
        # What is told of radians is told in the words of the command line.
        told, hint = str(error), _degrees_hint(args, robot, q_start, goal)
        if "position limits" not in told:
            raise
        told = told.removesuffix(IN_RADIANS)
        raise ProblemError(f"{told}; {hint}" if hint else told, error.field) from error


def _degrees_hint(args: ProblemOptions, robot: Robot, q: Array, goal: Goal) -> str:
    """What to say of angles that nobody gives in radians."""
    ends = [q] if goal.configuration is None else [q, goal.configuration]
    turning = ~prismatic_joints(robot)
    most = max(float(np.max(np.abs(end[turning]), initial=0.0)) for end in ends)
    if args.degrees or most <= LARGE_ANGLE:
        return ""
    return f"{most:g} looks like degrees: add --degrees, or give radians"


def _goal(args: ProblemOptions, robot: Robot, q_start: Array) -> Goal:
    text = args.goal_velocity
    if args.goal is not None:
        q = positions(args.goal, "--goal", robot, base=q_start, degrees=args.degrees)
        return JointGoal(q, _velocities(args, "goal_velocity", robot))
    v = None if text is None else np.array(vector(text, "--goal-velocity"))
    if args.goal_position is not None:
        frame, *point = args.goal_position
        return PositionGoal(frame, np.array(point), v)
    assert args.goal_pose is not None  # noqa: S101
    frame, *numbers = args.goal_pose
    return PoseGoal(frame, _placement(numbers), v)


def _velocities(args: ProblemOptions, name: str, robot: Robot) -> Array | None:
    """The joint velocities of an option; None where it is not given."""
    text = getattr(args, name)
    if text is None:
        return None
    return velocities(text, _flag(name), robot, degrees=args.degrees)


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


def _refuse(what: str, args: RobotOptions, keep: Collection[str] = ()) -> None:
    """Refuse options that say again, or otherwise, what a file says."""
    for field in fields(args):
        if field.name not in keep and getattr(args, field.name) != field.default:
            raise OptionsError(
                f"{_flag(field.name)} contradicts {what}, which holds the whole "
                "problem",
                field.name,
            )


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"
