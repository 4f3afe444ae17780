"""The problem of a command: from its options, a scenario, or files of MoveIt.

What is typed becomes the tables that a scenario file has, and is read as these are.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NoReturn, cast

import numpy as np

from tominpmp.arrays import Array, field_type
from tominpmp.cli.options import (
    PlayOptions,
    ProblemArguments,
    ProblemOptions,
    RobotOptions,
    SceneOptions,
    is_scenario,
)
from tominpmp.constraints.path import PathConstraint
from tominpmp.description.fields import Field
from tominpmp.description.joint_table import OVERRIDES
from tominpmp.exceptions import OptionsError, ProblemError, SceneError, TominpmpError
from tominpmp.files import scenario
from tominpmp.files.moveit import load_moveit, load_moveit_scene, request_locks
from tominpmp.files.records import classes, from_table
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.kinematics import prismatic_joints
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import EFFORTS, Options
from tominpmp.problem.problem import Problem
from tominpmp.problem.state_checks import IN_RADIANS, LARGE_ANGLE
from tominpmp.robot.robot import Robot, read_source
from tominpmp.scene.grids import HeightField, OcTree
from tominpmp.scene.obstacles import Obstacle
from tominpmp.scene.scene import Scene

CONSTRAINT_FORM = "KIND:KEY=VALUE:..., for example tool_speed:frame=tip:limit=0.5"
OBSTACLE_FORM = "KIND:NAME:KEY=VALUE:..., for example sphere:ball:r=0.1:at=0.5,0,0.3"
# Short words for fields of obstacles.
FULL = {"r": "radius", "at": "position", "quat": "rotation", "l": "length"}


@dataclass(frozen=True)
class Typed(Field):
    """A value that was typed; the key is its option, and paths are those typed."""

    path: Path = Path("command line")

    def fail(self, message: str) -> NoReturn:
        """Raise the error about the option.

        Raises:
            OptionsError: Always.
        """
        raise OptionsError(f"{self.key}: {message}" if self.key else message, self.key)

    def blame(self, error: TominpmpError) -> NoReturn:
        """Raise an error of the library as it is: it names what was typed."""
        raise error

    def get(self, name: str) -> Field:
        """Value of a key of a table; positions have no key but that of the option."""
        found = super().get(name)
        return replace(found, key=self.key) if name in ("q", "state") else found


def words(text: str) -> list[str]:
    """Split at commas and spaces; brackets around the whole are dropped."""
    return re.split(r"\s*,\s*|\s+", text.strip().strip("[]()").strip())


def number(word: str) -> float | None:
    """Read a number; None if it is none."""
    try:
        return float(word)
    except ValueError:
        return None


def vector(items: Sequence[str], name: str) -> list[float]:
    """Read numbers.

    Raises:
        OptionsError: If a word is no number.
    """
    found = list[float]()
    for word in items:
        value = number(word)
        if value is None:
            raise OptionsError(f"{name}: {word!r} is not a number", name)
        found.append(value)
    return found


def joint_pairs(items: Sequence[str], name: str) -> dict[str, float]:
    """Read ``JOINT=VALUE`` of several joints.

    Raises:
        OptionsError: If one is not of that form, or a joint is named twice.
    """
    result: dict[str, float] = {}
    for item in items:
        joint, _, word = item.partition("=")
        value = number(word)
        if not joint or value is None:
            raise OptionsError(
                f"{name}: got {item!r}, expected JOINT=VALUE with a number", name
            )
        if joint in result:
            raise OptionsError(f"{name}: joint {joint!r} is named twice", name)
        result[joint] = value
    return result


def joint_numbers(items: Sequence[str], name: str) -> list[float] | dict[str, float]:
    """Read numbers, one for each joint, or ``JOINT=VALUE`` of some.

    Raises:
        OptionsError: If a word is no number or a joint is named twice.
    """
    named = any("=" in item for item in items)
    return joint_pairs(items, name) if named else vector(items, name)


def joint_values(text: str, name: str) -> float | list[float] | dict[str, float]:
    """Read one number for all joints, one for each, or some by joint name.

    Raises:
        OptionsError: If a word is no number or a joint is named twice.
    """
    values = joint_numbers(words(text), name)
    return values[0] if isinstance(values, list) and len(values) == 1 else values


def _in_si(
    values: list[float] | dict[str, float], robot: Robot, degrees: bool
) -> list[float] | dict[str, float]:
    """Values of joints in SI units, where those of joints that turn are in degrees."""
    turning = {j.name for j in robot.description.joints if j.kind != "prismatic"}

    def converted(name: str, value: float) -> float:
        return np.pi / 180 * value if degrees and name in turning else value

    if isinstance(values, dict):
        return {name: converted(name, value) for name, value in values.items()}
    if len(values) != robot.n:
        return values
    return [converted(*pair) for pair in zip(robot.joint_names, values, strict=True)]


def positions(
    text: str,
    name: str,
    robot: Robot,
    *,
    base: Array | None = None,
    degrees: bool = False,
) -> Array:
    """Read joint positions.

    Numbers in joint order; or the name of a group state; or ``JOINT=VALUE`` pairs,
    which may follow the name of a group state.

    Args:
        text: The text.
        name: The option.
        robot: The robot.
        base: Positions of joints of which nothing is said, shape (n,).
        degrees: Whether numbers for joints that turn are in degrees.

    Returns:
        Shape (n,) [rad or m].

    Raises:
        OptionsError: If they are wrong, or there is no such group state.
    """
    states = {} if robot.srdf is None else robot.srdf.group_states
    items, table = words(text), dict[str, Any]()
    if text.strip() in states:
        items, table["state"] = [], text.strip()
    elif number(items[0]) is None and "=" not in items[0]:
        table["state"] = items.pop(0)
    if items:
        table["q"] = _in_si(joint_numbers(items, name), robot, degrees)
    return scenario.positions(Typed(table, key=name), robot, base)


def obstacle(text: str) -> Obstacle:
    """Read an obstacle: ``KIND:NAME:KEY=VALUE:...``, with its fields as keys.

    Raises:
        SceneError: If anything in it is wrong.
    """
    found = classes(Obstacle).items()
    kinds = {k: v for k, v in found if not issubclass(v, HeightField | OcTree)}
    kind, _, rest = text.partition(":")
    name, *items = rest.split(":")
    try:
        named = f"name={name}", *items
        table = _typed_record(f"--obstacle {text!r}", kind, named, kinds)
        if kind in kinds and (not name or "=" in name):
            table.fail("it has no name")
        if kind in kinds and "position" not in table.value:
            table.fail("it lacks at")
        return cast("Obstacle", from_table(table, kinds, "kind"))
    except TominpmpError as error:
        raise SceneError(f"{error}; expected {OBSTACLE_FORM}", name or None) from error


def constraint(text: str) -> PathConstraint:
    """Read a constraint: ``KIND:KEY=VALUE:...``, with its fields as keys.

    Raises:
        ProblemError: If anything in it is wrong.
    """
    kind, *items = text.split(":")
    kinds = classes(PathConstraint)
    try:
        table = _typed_record(f"--constraint {text!r}", kind, items, kinds)
        return cast("PathConstraint", from_table(table, kinds, "kind"))
    except TominpmpError as error:
        said = f"{error}; expected {CONSTRAINT_FORM}"
        raise ProblemError(said, "constraints") from error


def _typed_record(
    option: str, kind: str, items: Sequence[str], kinds: Mapping[str, type[Any]]
) -> Typed:
    """What ``KEY=VALUE`` say of a record, as the table that a scenario has for it."""
    table = Typed({"type": kind}, key=option)
    for item in items:
        word, _, value = item.partition("=")
        key = FULL.get(word, word)
        if key in table.value:
            table.fail(f"{word} is given twice")
        declared = field_type(kinds.get(kind, object), key)
        plain = getattr(declared, "__origin__", declared) in (str, "str")
        numbers = [number(word) for word in words(value)]
        if not plain and None not in numbers:
            table.value[key] = numbers[0] if len(numbers) == 1 else numbers
        else:
            table.value[key] = value
    return table


# What the command line may say beside a file that holds the whole problem.
KEPT = ("margin", "self_collision", "motion_limits", "constraint")
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
    chosen = Options(**given)  # a wrong one is refused before a robot is loaded
    beside = {
        name: getattr(args, name)
        for name in ("margin", "self_collision")
        if getattr(args, name) is not None
    }
    asked_for = tuple(constraint(text) for text in args.constraint or ())
    if is_scenario(problem_args.robot):
        _refuse("a scenario file", args, KEPT)
        found = scenario.load_scenario(problem_args.robot)
        problem, chosen = found.problem, replace(found.options, **given)
    elif args.request is not None:
        if args.scene is None:
            raise ProblemError("--request needs a --scene that it belongs to", "scene")
        own = (f.name for f in fields(RobotOptions) if f.name != "group")
        _refuse("--request", args, ("scene", "request", *KEPT, *own))
        files = args.package_dir or (), args.srdf, None, _xacro_args(args)
        source = read_source(problem_args.robot, *files)
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


def _limits(problem_args: ProblemArguments, robot: Robot) -> MotionLimits | None:
    """The motion limits of the command line over those of its file."""
    path = problem_args.options.motion_limits
    table: dict[str, Any] = {} if path is None else {"file": str(path)}
    for name, text in problem_args.limits.items():
        table[name] = joint_values(text, _flag(name)) if isinstance(text, str) else text
    return scenario.read_motion_limits(Typed(table or None), robot)


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
    table: dict[str, Any] = {
        "name": robot,
        "package_dirs": [str(folder) for folder in args.package_dir or ()],
        "group": args.group,
        "limits": args.limits,
        "locked_joints": {**(resting or {}), **joint_pairs(args.lock or (), "--lock")},
        "kinematic": args.kinematic,
        "xacro_args": _xacro_args(args),
    }
    for name in ("srdf", "joint_limits", "gravity", *OVERRIDES):
        given = getattr(args, name)
        if isinstance(given, Path):
            table[name] = str(given)
        elif given is not None:
            table[name] = joint_values(given, _flag(name))
    return scenario.read_robot(Typed(table))


def _xacro_args(args: RobotOptions) -> dict[str, str]:
    """Arguments of a xacro file, written as for ROS.

    Raises:
        OptionsError: If one is not NAME:=VALUE.
    """
    words = [text.partition(":=") for text in args.xacro_arg or ()]
    for name, sign, _ in words:
        if not (name and sign):
            message = f"--xacro-arg: got {name!r}, expected NAME:=VALUE"
            raise OptionsError(message, "--xacro-arg")
    return {name: value for name, _, value in words}


def load_scene(args: PlayOptions) -> tuple[Robot, Scene]:
    """Load a robot and the obstacles around it, from a scenario or the command line.

    Raises:
        TominpmpError: If anything given is wrong or contradicts something else.
    """
    if is_scenario(args.robot):
        _refuse("a scenario file", args, ("robot", "output"))
        problem = scenario.load_scenario(args.robot).problem
        return problem.robot, problem.scene
    arm = load_changed_robot(args.robot, args)
    return arm, _obstacles(args, arm)


def _obstacles(args: SceneOptions, robot: Robot) -> Scene:
    found = [obstacle(text) for text in args.obstacle or ()]
    if args.scene is None:
        return Scene(found)
    read = load_moveit_scene(args.scene, robot)
    return Scene([*found, *read]) if found else read


def _typed_problem(
    problem_args: ProblemArguments, beside: Mapping[str, Any]
) -> Problem:
    """The problem of a command line that names no file with one."""
    args = problem_args.options
    if args.start is None:
        raise ProblemError(
            "there is no start: give --start, or a --scene and a --request; "
            f"{problem_args.robot!r} is no scenario file (.toml)",
            "start",
        )
    robot = load_changed_robot(problem_args.robot, args)
    given = [_flag(name) for name in GOALS if getattr(args, name) is not None]
    if len(given) != 1:
        said = f"{' and '.join(given)} are given" if given else "there is no goal"
        flags = " or ".join(map(_flag, GOALS))
        raise ProblemError(f"{said}: give {flags}", "goal")
    scene = _obstacles(args, robot)
    q_start = positions(args.start, "--start", robot, degrees=args.degrees)
    v_start = velocities(args, "start_velocity", robot)
    goal, limits = _goal(args, robot, q_start), _limits(problem_args, robot)
    try:
        return Problem(
            robot, q_start, goal, scene, v_start=v_start, motion_limits=limits, **beside
        )
    except ProblemError as error:
        # Radians are spoken of in the words of the command line.
        said = str(error).removesuffix(IN_RADIANS)
        if "position limits" in said:
            said += _degrees_hint(args, robot, q_start, goal)
        raise ProblemError(said, error.field) from error


def _degrees_hint(args: ProblemOptions, robot: Robot, q: Array, goal: Goal) -> str:
    """What to say of angles that nobody gives in radians."""
    ends = [q] if goal.configuration is None else [q, goal.configuration]
    turning = ~prismatic_joints(robot)
    most = max(float(np.max(np.abs(end[turning]), initial=0.0)) for end in ends)
    if args.degrees or most <= LARGE_ANGLE:
        return ""
    return f"; {most:g} looks like degrees: add --degrees, or give radians"


def _goal(args: ProblemOptions, robot: Robot, q_start: Array) -> Goal:
    text = args.goal_velocity
    if args.goal is not None:
        q = positions(args.goal, "--goal", robot, base=q_start, degrees=args.degrees)
        return JointGoal(q, velocities(args, "goal_velocity", robot), wrap=_wrap(args))
    if args.wrap is not None:
        raise OptionsError("--wrap is about the joints of a --goal", "--wrap")
    v = None if text is None else np.array(vector(words(text), "--goal-velocity"))
    frame, *numbers = args.goal_position or args.goal_pose or ("",)
    if args.goal_position is not None:
        return PositionGoal(frame, np.array(numbers), v)
    return PoseGoal(frame, (numbers[:3], numbers[3:]), v)


def _wrap(args: ProblemOptions) -> bool | list[str]:
    """Which joints of a goal are angles."""
    if args.wrap in (None, "none"):
        return args.wrap is None
    return [name.strip() for name in str(args.wrap).split(",")]


def velocities(args: ProblemOptions, name: str, robot: Robot) -> Array | None:
    """The joint velocities of an option; None where it is not given.

    Numbers in joint order, or pairs; other joints rest.

    Raises:
        OptionsError: If they are wrong.
    """
    text, flag = getattr(args, name), _flag(name)
    if text is None:
        return None
    values = _in_si(joint_numbers(words(text), flag), robot, args.degrees)
    return scenario.vector(Typed(values, key=flag), robot)


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
