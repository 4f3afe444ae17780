"""Scenario files (TOML): a problem and the options to plan it with.

::

    margin = 0.01                       # distance to keep from obstacles [m]
    self_collision = true               # the default; false lets links touch

    [robot]
    name = "panda"                      # or path = "arm.urdf"
    locked_joints = {panda_finger_joint1 = 0.04}

    [start]
    state = "default"                   # a group state; or q = [...]

    [goal]
    type = "joint"                      # or "position", "pose", ...
    q = {panda_joint1 = 1.2}            # the other joints end where they start

    [[scene.obstacles]]
    type = "box"
    name = "table"
    size = [1.0, 1.0, 0.1]
    position = [0.6, 0.0, -0.05]

    [[scene.obstacles]]
    type = "sphere"
    name = "ball"
    radius = 0.1
    position = [0.5, -0.5, 0.4]
    motion = {type = "constant_velocity", velocity = [0.0, 0.2, 0.0]}

    [motion_limits]                     # beyond those of the URDF
    acceleration = 10.0

    [[constraints]]                     # what else holds at all times
    type = "tool_speed"
    frame = "panda_hand_tcp"
    limit = 0.5

    [options]
    intervals = 60

A motion of several segments has a list of ``[[segments]]`` in place of the goal, see
:mod:`~tominpmp.files.scenario_tables`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.arrays import Array, Record
from tominpmp.checks import instance
from tominpmp.description.fields import Field
from tominpmp.description.paths import checked_path
from tominpmp.description.yaml_reader import read_bytes
from tominpmp.exceptions import ScenarioError, TominpmpError
from tominpmp.files.records import field_table, make, to_table
from tominpmp.files.robot_table import (
    Beside,
    check_given_back,
    read_robot,
    robot_table,
)
from tominpmp.files.scenario_tables import (
    beyond,
    blamed,
    followed,
    key_of,
    positions,
    read_conditions,
    read_goal,
    read_segments,
    vector,
)
from tominpmp.files.writing import toml_text, write_bytes
from tominpmp.goals import Goal
from tominpmp.options import Options
from tominpmp.problem import Problem
from tominpmp.robot import Robot

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib  # type: ignore[no-redef, import-not-found, unused-ignore]

MAX_BYTES = 16 * 2**20
# Reading a longer number takes a hundred times as much memory as the file.
MAX_DIGITS = 5000
SECTIONS = (
    "margin",
    "self_collision",
    "robot",
    "start",
    "goal",
    "scene",
    "motion_limits",
    "constraints",
    "segments",
    "may_touch",
    "options",
)
# What errors call the state in which the first segment begins: that of the problem.
STARTS = ("q_start", "v_start")


@dataclass(frozen=True, eq=False)
class Scenario(Record):
    """A problem and the options to plan it with.

    Attributes:
        problem: The problem.
        options: The options.
    """

    problem: Problem
    options: Options


def load_scenario(path: str | Path) -> Scenario:
    """Load a scenario file.

    Args:
        path: TOML file; paths in it are relative to its folder.

    Returns:
        The problem and the options.

    Raises:
        ScenarioError: If the file, or what it describes, is wrong, with the key.
    """
    path = checked_path(path, "path", ScenarioError)
    document = Field(read_toml(path), path)
    document.only(*SECTIONS)
    robot = read_robot(document.need("robot"))
    options = read_options(document.get("options"))
    start = document.need("start")
    start.only("q", "v", "state")
    q_start = positions(start, robot, None)
    v_start = start.get("v")
    goal = _read_goal(document, robot, q_start)
    segments = read_segments(document.get("segments"), robot, q_start)
    try:
        problem = Problem(
            robot,
            q_start,
            goal,  # type: ignore[arg-type]
            v_start=None if v_start.value is None else vector(v_start, robot),
            segments=segments,
            **read_conditions(document, robot),
        )
    except ScenarioError:
        raise
    except TominpmpError as error:
        field = getattr(error, "field", None)
        if field is not None:
            _named(document, field).fail(str(error))
        # That a frame or a joint is unknown does not say who named it.
        blamed(document, goal, segments, robot).fail(str(error))
    return Scenario(problem, options)


def _read_goal(document: Field, robot: Robot, q_start: Array) -> Goal | None:
    """The goal; None where there are segments."""
    goal, segments = document.get("goal"), document.get("segments")
    if not segments.given:
        if goal.value is None:
            goal.fail(
                "is missing, and there are no segments; expected one or the other"
            )
        return read_goal(goal, robot, q_start)
    if goal.value is not None:
        goal.fail(
            "stands beside segments, expected one or the other: the last segment's "
            "goal is that of the problem"
        )
    return None


def _named(document: Field, path: str) -> Field:
    """What of a scenario a path in a problem leads to, as "segments[1].goal.q"."""
    of_one = re.match(r"segments\[(\d+)\]\.(.*)", path)
    if of_one is not None:
        number, path = int(of_one[1]), of_one[2]
        if number > 0 or not path.startswith(STARTS):
            return key_of(list(document.get("segments").items())[number], path)
    name = re.split(r"[.\[]", path)[0]
    key = name if name in SECTIONS else "goal"
    found = document.get("start" if name in STARTS else key)
    return followed(found, path[len(name) :]) if name == "constraints" else found


def save_scenario(
    path: str | Path, problem: Problem, options: Options | None = None
) -> Path:
    """Write a problem as a scenario file.

    Loading the file gives an equal problem and equal options, but for the callback,
    which no file can hold. The description of a robot that was given as a text or as a
    model of another library is written beside it: ``cell.toml`` refers to
    ``cell_robot.urdf``, and to ``cell_robot.srdf`` and meshes where there are any.

    Args:
        path: File to write, ending in ``.toml``; replaced if it exists.
        problem: The problem.
        options: The options; None for the defaults.

    Returns:
        The path.

    Raises:
        ScenarioError: If the problem holds something that a file cannot, or the file
            cannot be written.
    """
    path = checked_path(path, "path", ScenarioError)
    beside = Beside(f"{path.stem}_robot")
    content = scenario_text(path, problem, options, beside=beside).encode()
    beside.write(path.parent)
    return write_bytes(path, content)


def scenario_text(
    path: Path,
    problem: Problem,
    options: Options | None = None,
    *,
    check: bool = True,
    beside: Beside | None = None,
) -> str:
    """A problem as the text of a scenario file.

    Args:
        path: Where the file is to be: paths in it are relative to its folder.
        problem: The problem.
        options: The options; None for the defaults.
        check: Whether to read the robot back, to see that it is the same.
        beside: Takes files that are to lie beside it; None refuses robots that need
            some.

    Raises:
        ScenarioError: If the problem holds something that a file cannot.
    """
    instance(problem, Problem, "problem")
    if options is not None:
        instance(options, Options, "options", "Options or None")
    given = Options() if options is None else options
    text = toml_text(_document(path, problem, given, check, beside))
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise ScenarioError(f"{path}: a name cannot be saved: {error}", path) from error
    return text


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        ScenarioError: If there is none.
    """
    content = read_bytes(path, MAX_BYTES)
    if re.search(rb"[0-9_]{%d}" % MAX_DIGITS, content):
        raise ScenarioError(f"{path} holds a number of {MAX_DIGITS} digits", path)
    try:
        return tomllib.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{path} is no TOML: {error}", path) from error


def read_options(table: Field) -> Options:
    """Read options; the defaults if they are left out.

    Raises:
        ScenarioError: If one is wrong.
    """
    if not table.given:
        return Options()
    if "callback" in table.table():
        table.get("callback").fail("a file cannot hold a function")
    return make(Options, table.table(), table, {})


def _document(
    path: Path,
    problem: Problem,
    options: Options,
    check: bool = True,
    beside: Beside | None = None,
) -> dict[str, Any]:
    """Turn problem and options into tables.

    Raises:
        ScenarioError: If they hold something that a file cannot.
    """
    own, limits = problem.robot.motion_limits, problem.motion_limits
    if limits == own:
        limits = None
    elif limits is not None:
        limits = beyond(limits, own, problem.robot)
    start = {"q": problem.q_start}
    if problem.v_start is not None and np.any(problem.v_start):
        start["v"] = problem.v_start
    parts: dict[str, Any] = {
        "may_touch": problem.may_touch or None,
        "margin": problem.margin or None,
        "self_collision": problem.self_collision,
        "robot": problem.robot,
        "start": start,
        "goal": None if problem.segments else problem.goal,
        "scene": problem.scene if len(problem.scene) else None,
        "motion_limits": limits,
        "constraints": problem.constraints or None,
    }

    def written(key: str, part: Any) -> Any:
        try:
            if isinstance(part, Options):
                return field_table(part, path.parent)
            if not isinstance(part, Robot):
                return to_table(part, path.parent)
            table = robot_table(part, path.parent, beside)
            if check:
                check_given_back(part, table, path, beside)
        except TypeError as error:
            reason = f"{path}: {key}: cannot be saved: {error}"
            raise ScenarioError(reason, path, key) from error
        return table

    document = {k: written(k, part) for k, part in parts.items() if part is not None}
    if problem.segments:
        each = enumerate(problem.segments)
        document["segments"] = [written(f"segments[{i}]", item) for i, item in each]
    table = written("options", replace(options, callback=None))
    return document | ({"options": table} if table else {})
