"""The problem of a command: from its options, a scenario, or files of MoveIt."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import MISSING, fields, replace
from types import MappingProxyType
from typing import Any, cast

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, field_type
from tominpmp.cli.options import (
    PlayOptions,
    ProblemArguments,
    ProblemOptions,
    RobotOptions,
    SceneOptions,
    is_scenario,
)
from tominpmp.constraints import PathConstraint
from tominpmp.description.joint_table import OVERRIDES
from tominpmp.exceptions import JointNotFound, OptionsError, ProblemError, SceneError
from tominpmp.files.limits import (
    load_joint_limits,
    load_limited_robot,
    load_motion_limits,
)
from tominpmp.files.moveit import load_moveit, load_moveit_scene, request_locks
from tominpmp.files.records import classes
from tominpmp.files.scenario import load_scenario
from tominpmp.goals import Goal, JointGoal, PoseGoal, PositionGoal
from tominpmp.kinematics import prismatic_joints
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import EFFORTS, Options
from tominpmp.problem import Problem
from tominpmp.problem.state_checks import IN_RADIANS
from tominpmp.robot import Robot, read_source
from tominpmp.scene import HeightField, Obstacle, OcTree, Scene

CONSTRAINT_FORM = "KIND:KEY=VALUE:..., for example tool_speed:frame=tip:limit=0.5"
OBSTACLE_FORM = "KIND:NAME:KEY=VALUE:..., for example sphere:ball:r=0.1:at=0.5,0,0.3"


def words(text: str) -> list[str]:
    """Split at commas and spaces; brackets around the whole are dropped."""
    return re.split(r"\s*,\s*|\s+", text.strip().strip("[]()").strip())


def number(word: str) -> float | None:
    """Read a number; None if it is none."""
    try:
        return float(word)
    except ValueError:
        return None


def vector(text: str, name: str) -> list[float]:
    """Read numbers.

    Raises:
        OptionsError: If a word is no number.
    """
    found = [(word, number(word)) for word in words(text)]
    for word, value in found:
        if value is None:
            raise OptionsError(f"{name}: {word!r} is not a number", name)
    return [value for _, value in found if value is not None]


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


def joint_values(text: str, name: str) -> float | list[float] | dict[str, float]:
    """Read one number for all joints, one for each, or some by joint name.

    Raises:
        OptionsError: If a word is no number or a joint is named twice.
    """
    if "=" in text:
        return joint_pairs(words(text), name)
    numbers = vector(text, name)
    return numbers[0] if len(numbers) == 1 else numbers


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
        name: The option, for messages.
        robot: The robot.
        base: Positions of joints of which nothing is said, shape (n,).
        degrees: Whether numbers for joints that turn are in degrees.

    Returns:
        Shape (n,) [rad or m].

    Raises:
        OptionsError: If a pair cannot be read.
        JointNotFound: If a joint is unknown.
        ProblemError: If there are too few or too many numbers, the word is not a group
            state, or nothing is said about a joint.
    """
    items = words(text)
    if number(items[0]) is not None:
        known = _by_joint(vector(text, name), name, robot, degrees)
        return np.array([known[joint] for joint in robot.joint_names])
    states = {} if robot.srdf is None else robot.srdf.group_states
    state, items = (text.strip(), []) if text.strip() in states else (None, items)
    if items and "=" not in items[0]:
        state = items.pop(0)
    if state is not None and state not in states:
        has = ", ".join(states) or "none"
        raise ProblemError(
            f"{name}: {state!r} is neither a number nor a group state of "
            f"{robot.name!r} (group states: {has})",
            name,
        )
    known = {} if base is None else dict(zip(robot.joint_names, base, strict=True))
    known |= {} if state is None else states[state]
    known |= _by_joint(joint_pairs(items, name), name, robot, degrees)
    lacking = [joint for joint in robot.joint_names if joint not in known]
    if lacking:
        raise ProblemError(
            f"{name} says nothing about {', '.join(lacking)}: name them, or begin with "
            "a group state",
            name,
        )
    return np.array([known[joint] for joint in robot.joint_names])


def velocities(text: str, name: str, robot: Robot, *, degrees: bool = False) -> Array:
    """Read joint velocities: numbers in joint order, or pairs; other joints rest.

    Raises:
        OptionsError: If a number or pair cannot be read.
        JointNotFound: If a joint is unknown.
        ProblemError: If there are too few or too many numbers.
    """
    values = joint_pairs(words(text), name) if "=" in text else vector(text, name)
    known = _by_joint(values, name, robot, degrees)
    return np.array([known.get(joint, 0.0) for joint in robot.joint_names])


def _by_joint(
    values: Sequence[float] | Mapping[str, float],
    name: str,
    robot: Robot,
    degrees: bool,
) -> dict[str, float]:
    """Values by joint name in SI units, of one for each joint or of some by name."""
    if not isinstance(values, Mapping):
        if len(values) != robot.n:
            raise ProblemError(
                f"{name} has {len(values)} number{'' if len(values) == 1 else 's'}, "
                f"expected {robot.n}, one for each of: {', '.join(robot.joint_names)}",
                name,
            )
        values = dict(zip(robot.joint_names, values, strict=True))
    for joint in values:
        if joint not in robot.joint_names:
            raise JointNotFound(joint, robot.joint_names)
    turn = {j.name for j in robot.description.joints if j.kind != "prismatic"}
    return {
        joint: np.pi / 180 * value if degrees and joint in turn else value
        for joint, value in values.items()
    }


# Short words for fields; the others are typed as they are.
SHORT = {"radius": "r", "position": "at", "rotation": "quat"}
FULL = {**{short: key for key, short in SHORT.items()}, "l": "length"}
# How many numbers some of them have.
COUNTS = {"radius": 1, "length": 1, "size": 3, "position": 3, "rotation": 4}
# Motions and tables of numbers are for files.
UNTYPED = ("motion", "vertices", "triangles")


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
        if kind in kinds and (not name or "=" in name):
            raise OptionsError(f"it has no name (expected {OBSTACLE_FORM})")
        made = _record(kind, items, kinds, OBSTACLE_FORM, {"name": name}, ["position"])
    except OptionsError as error:
        raise SceneError(f"--obstacle {text!r}: {error}", name or None) from error
    return cast("Obstacle", made)


def constraint(text: str) -> PathConstraint:
    """Read a constraint: ``KIND:KEY=VALUE:...``, with its fields as keys.

    Raises:
        ProblemError: If anything in it is wrong.
    """
    kind, *items = text.split(":")
    kinds = classes(PathConstraint, "")
    try:
        return cast("PathConstraint", _record(kind, items, kinds, CONSTRAINT_FORM))
    except (OptionsError, ProblemError) as error:
        raise ProblemError(f"--constraint {text!r}: {error}", "constraints") from error


def _record(
    kind: str,
    items: Sequence[str],
    kinds: Mapping[str, type[Any]],
    form: str,
    values: Mapping[str, Any] = MappingProxyType({}),
    needed: Sequence[str] = (),
) -> Any:
    """Make a record from ``KEY=VALUE`` with its fields as keys, or raise OptionsError.

    Fields that are needed must be given although they have a default; ``form`` says in
    messages what was expected.
    """
    if kind not in kinds:
        raise OptionsError(
            f"there is no kind {kind!r}; there are: {', '.join(kinds)} "
            f"(expected {form})"
        )
    values, hidden = dict(values), (*values, *UNTYPED)
    known = {item.name: item for item in fields(kinds[kind]) if item.name not in hidden}
    # Those of all obstacles come last.
    known |= {key: known.pop(key) for key in ("position", "rotation") if key in known}
    for item in items:
        word, _, value = item.partition("=")
        key = FULL.get(word, word)
        if key not in known:
            keys = ", ".join(SHORT.get(key, key) for key in known)
            raise OptionsError(f"{item!r}: the keys of a {kind} are {keys}")
        if key in values:
            raise OptionsError(f"{SHORT.get(key, key)} is given twice")
        declared = field_type(kinds[kind], key)
        plain = getattr(declared, "__origin__", declared) in (str, "str")
        values[key] = value if plain else _entry(value, key)
    bare = [k for k, f in known.items() if f.default is f.default_factory is MISSING]
    lacking = [SHORT.get(k, k) for k in (*bare, *needed) if k not in values]
    if lacking:
        raise OptionsError(f"it lacks {' and '.join(lacking)}")
    return kinds[kind](**values)


def _entry(value: str, key: str) -> Any:
    """Read a number, a list of them, or, where numbers need not be, a word."""
    found = [number(word) for word in words(value)]
    count = COUNTS.get(key)
    if None in found and count is None:
        return value
    if None in found or count not in (None, len(found)):
        expected = "a number" if count == 1 else f"{count} numbers"
        raise OptionsError(f"{SHORT.get(key, key)} is {value!r}, expected {expected}")
    return found[0] if len(found) == 1 else found


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
    chosen = Options(**given)  # a wrong one is refused before a robot is loaded
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
        # Radians are spoken of in the words of the command line.
        said, hint = str(error), _degrees_hint(args, robot, q_start, goal)
        if "position limits" not in said:
            raise
        said = said.removesuffix(IN_RADIANS)
        raise ProblemError(f"{said}; {hint}" if hint else said, error.field) from error


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
