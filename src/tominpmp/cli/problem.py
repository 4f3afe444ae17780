"""The problem of a command: from its options, a scenario, or files of MoveIt.

Typed values become the tables of a scenario file, and are read by the same functions.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NoReturn

import numpy as np

from tominpmp.arrays import Array, field_type
from tominpmp.cli.option_fields import number, typed_values
from tominpmp.cli.options import (
    PlayOptions,
    ProblemOptions,
    RobotOptions,
    SceneOptions,
    is_scenario,
)
from tominpmp.constraints.path import PathConstraint
from tominpmp.description.fields import Field
from tominpmp.description.joint_table import OVERRIDES
from tominpmp.exceptions import OptionsError, ProblemError, TominpmpError
from tominpmp.files import scenario
from tominpmp.files.limits import load_limited_robot
from tominpmp.files.moveit import load_moveit, load_moveit_scene, request_locks
from tominpmp.files.records import classes, from_table
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import EFFORTS, Options
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot, read_source
from tominpmp.scene.grids import HeightField, OcTree
from tominpmp.scene.obstacles import Obstacle
from tominpmp.scene.scene import Scene

CONSTRAINT_FORM = "KIND:KEY=VALUE:..., for example tool_speed:frame=tip:limit=0.5"
OBSTACLE_FORM = "KIND:NAME:KEY=VALUE:..., for example sphere:ball:r=0.1:at=0.5,0,0.3"
# Abbreviations of fields of obstacles.
ABBREVIATIONS = {"r": "radius", "at": "position", "quat": "rotation", "l": "length"}


@dataclass(frozen=True)
class Typed(Field):
    """A value that was typed; its key is the option, and paths are as typed.

    Attributes:
        form: The expected form, which ends messages; empty where they describe it.
    """

    path: Path = Path("command line")
    form: str = ""

    _owner: ClassVar[str] = r"constraint\.|obstacle .*: "

    def fail(self, message: str) -> NoReturn:
        """Raise an error about the option.

        Raises:
            OptionsError: Always.
        """
        said = f"{self.key}: {self._unnamed(message)}" if self.key else message
        said += f"; expected {self.form}" if self.form else ""
        raise OptionsError(said, self.key)

    def blame(self, error: TominpmpError) -> NoReturn:
        """Raise an error of the library unchanged: it names the typed value."""
        raise error

    def get(self, name: str) -> Field:
        """Value of a key of a table; positions and kinds keep the key of the option."""
        field, own = super().get(name), ("q", "state", "type")
        return replace(field, key=self.key) if name in own else field


def _words(text: str) -> list[str]:
    """Split at commas and spaces; brackets around the whole are dropped."""
    return re.split(r"\s*,\s*|\s+", text.strip().strip("[]()").strip())


def joint_values(
    items: Sequence[str], name: str, *, named: bool = False
) -> list[float] | dict[str, float]:
    """Read numbers, one for each joint, or ``JOINT=VALUE`` of some joints.

    Args:
        items: The words.
        name: The option.
        named: Whether the joints have to be named.

    Raises:
        OptionsError: If a word is not a number or a joint is named twice.
    """
    named = named or any("=" in item for item in items)
    joints, values = list[str](), list[float]()
    for item in items:
        joint, _, word = item.rpartition("=")
        value = number(word)
        if value is None or bool(joint) != named:
            expected = "JOINT=VALUE with a number" if named else "a number"
            raise OptionsError(f"{name}: got {item!r}, expected {expected}", name)
        if joint and joint in joints:
            raise OptionsError(f"{name}: joint {joint!r} is named twice", name)
        joints.append(joint)
        values.append(value)
    return dict(zip(joints, values, strict=True)) if named else values


def _in_si(
    args: ProblemOptions, name: str, items: Sequence[str], robot: Robot
) -> list[float] | dict[str, float]:
    """Values of joints in words of an option, from degrees for revolute joints."""
    values = joint_values(items, _flag(name))
    turning = [j.name for j in robot.description.joints if j.kind != "prismatic"]
    units = dict.fromkeys(turning if args.degrees else (), np.pi / 180)
    if isinstance(values, dict):
        return {joint: units.get(joint, 1.0) * x for joint, x in values.items()}
    if len(values) != robot.n:
        return values
    named = zip(robot.joint_names, values, strict=True)
    return [units.get(joint, 1.0) * x for joint, x in named]


def positions(
    args: ProblemOptions, name: str, robot: Robot, base: Array | None = None
) -> Array:
    """The joint positions of an option that was typed.

    The text has numbers in joint order; or the name of a group state; or
    ``JOINT=VALUE`` pairs, which may follow the name of a group state.

    Args:
        args: The options.
        name: Name of the option.
        robot: The robot.
        base: Positions of joints that the text does not name, shape (n,) [rad or m].

    Returns:
        Positions, shape (n,) [rad or m].

    Raises:
        OptionsError: If a word is not a number, or the group state is unknown.
        ProblemError: If a joint is unknown or has no position, or if there are too many
            or too few numbers.
    """
    text = getattr(args, name)
    items, table = _words(text), dict[str, Any]()
    if text.strip() in robot.group_states:
        items, table["state"] = [], text.strip()
    elif number(items[0]) is None and "=" not in items[0]:
        table["state"] = items.pop(0)
    if items:
        table["q"] = _in_si(args, name, items, robot)
    return scenario.positions(Typed(table, key=_flag(name)), robot, base)


def obstacle(text: str) -> Obstacle:
    """Read an obstacle: ``KIND:NAME:KEY=VALUE:...``, with its fields as keys.

    Raises:
        OptionsError: If the kind, the name or a field is wrong.
    """
    known = classes(Obstacle).items()
    kinds = {k: v for k, v in known if not issubclass(v, HeightField | OcTree)}
    kind, _, rest = text.partition(":")
    name, *items = rest.split(":")
    table = Typed({"type": kind}, key=f"--obstacle {text!r}", form=OBSTACLE_FORM)
    if kind in kinds and (not name or "=" in name):
        table.fail("it has no name")
    read: Obstacle = _read_items(table, (f"name={name}", *items), kinds)
    if "position" not in table.value:
        table.fail("it lacks at=X,Y,Z")
    return read


def constraint(text: str) -> PathConstraint:
    """Read a constraint: ``KIND:KEY=VALUE:...``, with its fields as keys.

    Raises:
        OptionsError: If the kind or a field is wrong.
    """
    kind, *items = text.split(":")
    table = Typed({"type": kind}, key=f"--constraint {text!r}", form=CONSTRAINT_FORM)
    read: PathConstraint = _read_items(table, items, classes(PathConstraint))
    return read


def _read_items(
    table: Typed, items: Sequence[str], kinds: Mapping[str, type[Any]]
) -> Any:
    """Read ``KEY=VALUE`` items of a record as its table in a scenario file."""
    kind = table.value["type"]
    for item in items:
        word, equals, value = item.partition("=")
        key = ABBREVIATIONS.get(word, word)
        if not equals or key in table.value:
            table.fail(f"{word} {'is given twice' if equals else 'lacks =VALUE'}")
        declared = field_type(kinds.get(kind, object), key)
        plain = getattr(declared, "__origin__", declared) in (str, "str")
        numbers = [number(word) for word in _words(value)]
        if declared == "tuple[str, ...]":
            table.value[key] = _words(value)
        elif not plain and None not in numbers:
            table.value[key] = numbers[0] if len(numbers) == 1 else numbers
        else:
            table.value[key] = value
    return from_table(table, kinds, "kind")


LIMITS = tuple(item.name for item in fields(MotionLimits))
# Options that are allowed together with a file that holds the whole problem.
ALLOWED = ("margin", "self_collision", "motion_limits", "constraint", *LIMITS)
GOALS = ("goal", "goal_position", "goal_pose")


def load_problem(
    robot: str, args: ProblemOptions, options: Mapping[str, Any] | None = None
) -> tuple[Problem, Options]:
    """Load or make the problem of a command, and the options of the planner.

    Args:
        robot: Name or path of the robot; or a scenario file.
        args: Changes of the robot, start, goal and obstacles.
        options: Options of the planner that were typed; they take precedence over the
            options of a scenario.

    Raises:
        TominpmpError: If an argument is wrong or contradicts another one.
    """
    typed = dict(options or {})
    chosen = Options(**typed)  # wrong options are refused before a robot is loaded
    changes = partial(_changes, args)
    if is_scenario(robot):
        _refuse("a scenario file", args, ALLOWED)
        loaded = scenario.read_scenario(scenario.read_toml(robot), changes)
        return loaded.problem, replace(loaded.options, **typed)
    if args.request is not None:
        if args.scene is None:
            raise ProblemError("--request needs a --scene that it belongs to", "scene")
        of_robot = (f.name for f in fields(RobotOptions) if f.name != "group")
        _refuse("--request", args, ("scene", "request", *ALLOWED, *of_robot))
        files = args.package_dir or (), args.srdf, None, _xacro_args(args)
        locks = request_locks(read_source(robot, *files), args.request)
        arm = load_changed_robot(robot, args, locks)
        return load_moveit(arm, args.scene, args.request, **changes(arm, {})), chosen
    return _typed_problem(robot, args), chosen


def _changes(
    args: ProblemOptions, robot: Robot, known: Mapping[str, Any]
) -> dict[str, Any]:
    """Arguments of a problem from the options, which complete those of a file.

    Limits that were typed override the file of --motion-limits.
    """
    path = args.motion_limits
    table: dict[str, Any] = {} if path is None else {"file": str(path)}
    table |= _values(typed_values(args), LIMITS)
    limits = scenario.read_motion_limits(Typed(table or None), robot)
    if limits is not None:
        limits = limits.over(known.get("motion_limits"), robot.joint_names)
    typed = tuple(constraint(text) for text in args.constraint or ())
    found = {
        "margin": args.margin,
        "self_collision": args.self_collision,
        "motion_limits": limits,
        "constraints": (*known.get("constraints", ()), *typed) if typed else None,
    }
    return {name: value for name, value in found.items() if value is not None}


def load_changed_robot(
    robot: str, args: RobotOptions, resting: Mapping[str, float] | None = None
) -> Robot:
    """Load a robot with the changes of the options, and with resting joints locked.

    Args:
        robot: Name or path of the robot, or a scenario file.
        args: The options.
        resting: Positions of joints to be locked in addition to --lock [rad or m].

    Raises:
        TominpmpError: If the robot, its files or an option are wrong.
    """
    if args.effort in EFFORTS:
        raise OptionsError(
            f"--effort is {args.effort!r}, expected torque limits (N m or N); how far "
            f"to search is --planning-effort {args.effort}",
            "--effort",
        )
    if is_scenario(robot):
        _refuse("a scenario file", args, ())
        return scenario.read_robot(scenario.read_toml(robot).need("robot"))
    locks = [word for text in args.lock or () for word in _words(text)]
    locked: Any = joint_values(locks, "--lock", named=True)
    return load_limited_robot(
        args.joint_limits,
        robot,
        package_dirs=args.package_dir or (),
        srdf=args.srdf,
        # With commas, a group is a list of links or joints.
        group=_words(args.group) if args.group and "," in args.group else args.group,
        limits=args.limits,
        locked_joints={**(resting or {}), **locked},
        kinematic=args.kinematic,
        xacro_args=_xacro_args(args),
        **_values(vars(args), ("gravity", *OVERRIDES)),
    )


def _values(typed: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Values of options, with texts as numbers.

    Raises:
        OptionsError: If a word is not a number or a joint is named twice.
    """

    def value(name: str, given: Any) -> Any:
        if not isinstance(given, str):
            return given
        numbers: Any = joint_values(_words(given), _flag(name))
        return numbers if isinstance(numbers, dict) or numbers[1:] else numbers[0]

    return {name: value(name, typed[name]) for name in names if name in typed}


def _xacro_args(args: RobotOptions) -> dict[str, str]:
    """Arguments of a xacro file, written as for ROS.

    Raises:
        OptionsError: If an argument is not NAME:=VALUE.
    """
    words = [text.partition(":=") for text in args.xacro_arg or ()]
    for name, sign, _ in words:
        if not (name and sign):
            message = f"--xacro-arg: got {name!r}, expected NAME:=VALUE"
            raise OptionsError(message, "--xacro-arg")
    return {name: value for name, _, value in words}


def load_scene(args: PlayOptions) -> tuple[Robot, Scene]:
    """Load a robot and its obstacles, from a scenario or the command line.

    Raises:
        TominpmpError: If an argument is wrong or contradicts another one.
    """
    if is_scenario(args.robot):
        _refuse("a scenario file", args, ("robot", "output"))
        problem = scenario.load_scenario(args.robot).problem
        return problem.robot, problem.scene
    arm = load_changed_robot(args.robot, args)
    return arm, _obstacles(args, arm)


def _obstacles(args: SceneOptions, robot: Robot) -> Scene:
    read = () if args.scene is None else load_moveit_scene(args.scene, robot)
    return Scene([*map(obstacle, args.obstacle or ()), *read])


def _typed_problem(name: str, args: ProblemOptions) -> Problem:
    """The problem of a command line without a scenario and a motion plan request."""
    if args.start is None:
        kind = "a folder, not" if name and Path(name).is_dir() else "not"
        raise ProblemError(
            "there is no start: give --start, or a --scene and a --request; "
            f"{name!r} is {kind} a scenario file (.toml)",
            "start",
        )
    robot = load_changed_robot(name, args)
    goals = [_flag(name) for name in GOALS if getattr(args, name) is not None]
    if len(goals) != 1:
        message = f"{' and '.join(goals)} are given" if goals else "there is no goal"
        flags = " or ".join(map(_flag, GOALS))
        raise ProblemError(f"{message}: give {flags}", "goal")
    scene = _obstacles(args, robot)
    q_start = positions(args, "start", robot)
    v, a = (rates(args, f"start_{k}", robot) for k in ("velocity", "acceleration"))
    start = q_start, _goal(args, robot, q_start), scene
    return Problem(robot, *start, v_start=v, a_start=a, **_changes(args, robot, {}))


def _goal(args: ProblemOptions, robot: Robot, q_start: Array) -> Goal:
    if args.goal is not None:
        q = positions(args, "goal", robot, q_start)
        # Joints whose positions are angles: the continuous ones, none, or more of them.
        wrap: bool | list[str] = args.wrap is None
        if args.wrap not in (None, "none"):
            wrap = _words(args.wrap)
        return JointGoal(q, rates(args, "goal_velocity", robot), wrap=wrap)
    if args.wrap is not None:
        raise OptionsError("--wrap is about the joints of a --goal", "--wrap")
    text = args.goal_velocity
    v: Any = None if text is None else joint_values(_words(text), "--goal-velocity")
    frame, *numbers = args.goal_position or args.goal_pose or ("",)
    if args.goal_position is not None:
        return PositionGoal(frame, numbers, v)
    return PoseGoal(frame, (numbers[:3], numbers[3:]), v)


def rates(args: ProblemOptions, name: str, robot: Robot) -> Array | None:
    """The joint velocities, or accelerations, of an option; None if not typed.

    The text has numbers in joint order, or ``JOINT=VALUE`` pairs; other joints have 0.

    Args:
        args: The options.
        name: Name of the option.
        robot: The robot.

    Returns:
        Shape (n,) [rad/s or m/s, rad/s^2 or m/s^2].

    Raises:
        OptionsError: If a word is not a number, or a joint is named twice.
        ProblemError: If a joint is unknown, or there are too many or too few numbers.
    """
    text = getattr(args, name)
    values = None if text is None else _in_si(args, name, _words(text), robot)
    return scenario.rates(Typed(values, key=_flag(name)), robot)


def _refuse(what: str, args: RobotOptions, keep: Collection[str]) -> None:
    """Refuse options that repeat or contradict a file."""
    for field in fields(args):
        if field.name not in keep and getattr(args, field.name) != field.default:
            flag = _flag(field.name)
            fault = f"{flag} contradicts {what}, which holds the whole problem"
            raise OptionsError(fault, field.name)


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"
