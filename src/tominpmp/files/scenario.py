"""Scenario files (TOML): a problem and the options to plan it with.

::

    margin = 0.01                       # distance to keep from obstacles [m]
    self_collision = true               # the default; false allows contact of links

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

    [[constraints]]                     # further constraints at all times
    type = "tool_speed"
    frame = "panda_hand_tcp"
    limit = 0.5

    [options]
    intervals = 60

A motion of several segments has a list of ``[[segments]]`` in place of the goal, with
the goals that it passes in their order.

::

    may_touch = [["panda_hand", "lid"]]     # on all segments

    [[segments]]
    goal = {type = "joint", q = {panda_joint1 = 1.2}}

    [[segments]]
    stop = true                             # the arm is at rest at its end
    dwell = 0.1                             # and stays at rest for this time [s]
    arrival = [1.0, 2.5]                    # earliest and latest time of arrival [s]
    may_touch = [["box", "table"]]
    motion_limits = {acceleration = 5.0}
    goal = {type = "position", frame = "panda_hand_tcp", position = [0.5, 0.0, 0.1]}
    payload = {mass = 1.0, frame = "panda_hand"}

    [[segments.constraints]]
    type = "tool_speed"
    frame = "panda_hand_tcp"
    limit = 0.5

    [[segments.scene.obstacles]]            # replace the obstacles of the problem
    type = "box"
    name = "table"
    size = [1.0, 1.0, 0.1]

Joints that the goal of a segment does not name keep their positions at the end of the
previous segment, if its goal determines them; ``scene = {}`` is a segment without
obstacles.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.arrays import Array, Record, changed_fields
from tominpmp.checks import instance
from tominpmp.constraints.path import PathConstraint
from tominpmp.datasheets import find_datasheet
from tominpmp.description.fields import Field, parse_toml
from tominpmp.description.files import find_robot, find_srdf
from tominpmp.description.joint_table import OVERRIDES, JointTable, Linkage
from tominpmp.description.paths import checked_path, read_bytes, write_bytes
from tominpmp.description.srdf import srdf_file
from tominpmp.description.urdf import urdf_file
from tominpmp.exceptions import (
    ProblemError,
    RobotLoadError,
    ScenarioError,
    TominpmpError,
    brief,
    quiet,
    unknown,
)
from tominpmp.files.limits import load_limited_robot, load_motion_limits, read_curve
from tominpmp.files.records import (
    blaming,
    classes,
    file_name,
    from_table,
    make,
    to_table,
    toml_text,
)
from tominpmp.goals.base import Goal
from tominpmp.goals.joints import JointGoal, joint_vector
from tominpmp.motion_limits import MotionLimits, classes_of_limits
from tominpmp.options import Options
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment
from tominpmp.robot.payload import Payload
from tominpmp.robot.robot import DEFAULT_GRAVITY, Robot
from tominpmp.scene.obstacles import Obstacle
from tominpmp.scene.scene import Scene


def read_motion_limits(table: Field, robot: Robot) -> MotionLimits | None:
    """Read motion limits.

    Args:
        table: Their table, with the fields of
            :class:`~tominpmp.motion_limits.MotionLimits` as keys; optional. ``file``
            names a YAML file over which the other keys take precedence, see
            :mod:`~tominpmp.files.limits`.
        robot: The robot.

    Returns:
        The limits; None without a table. A table without limits is a different value,
        and is restored as such.

    Raises:
        ScenarioError: If the table is wrong.
    """
    if table.value is None:
        return None
    items = table.table()
    file = items.pop("file", None)
    # The first class with all the fields, which may be a caller's own.
    known = {k: [item.name for item in fields(k)] for k in classes_of_limits()}
    fitting = (k for k, names in known.items() if items.keys() <= set(names))
    kind = next(fitting, MotionLimits)
    table.only("file", *known[kind])
    values: dict[str, Any] = {}
    if file is not None and file.value is not None:
        with blaming(file):
            below = load_motion_limits(file.path.parent / file.text(), robot)
        values = changed_fields(below)
    for name, item in items.items():
        value = item.value
        if isinstance(value, dict):
            read = read_curve if name == "effort_curves" else attrgetter("value")
            own = {joint: read(limit) for joint, limit in item.table().items()}
            value = {**(values.get(name) or {}), **own}
        values[name] = value
    with blaming(table):
        limits = kind(**values)
        limits.check(robot.joint_names)
    return limits


def _read_scene(table: Field) -> Scene:
    """Read a scene from its table, whose key ``obstacles`` is a list of tables.

    Raises:
        ScenarioError: If the table is wrong.
    """
    table.only("obstacles")
    items = table.get("obstacles")
    with blaming(items):
        return Scene(_read_each(items, Obstacle, "obstacle"))


def _read_each(items: Field, base: type[Any], noun: str) -> tuple[Any, ...]:
    """Read a list of records of one kind.

    Args:
        items: Their tables.
        base: Base class of the kind.
        noun: Noun for the kind in messages.

    Raises:
        ScenarioError: If a table is wrong.
    """
    kinds = classes(base)
    return tuple(from_table(item, kinds, noun) for item in items.items())


def _read_goal(table: Field, robot: Robot, before: Array | None) -> Goal:
    """Read a goal.

    Args:
        table: Its table: ``type`` and the fields of its class. The table of a
            configuration may have positions by joint name, or a ``state``.
        robot: The robot.
        before: Positions of the joints that are not named, shape (n,) [rad or m]; None
            if they are unknown.

    Raises:
        ScenarioError: If the table is wrong.
    """
    if table.get("type").value != "joint":
        goal: Goal = from_table(table, classes(Goal), "goal")
        with blaming(table):
            return goal.resolved(robot, before)
    table.only("type", "q", "v", "state", "wrap")
    q, v = positions(table, robot, before), rates(table.get("v"), robot)
    wrap = table.get("wrap")
    with blaming(wrap if wrap.given else table):
        return JointGoal(q, v, wrap=wrap.value if wrap.given else True)


def positions(table: Field, robot: Robot, base: Array | None) -> Array:
    """Read positions of all joints: numbers, a group state, by joint name, or both.

    Args:
        table: The table with the key ``q``, ``state``, or both.
        robot: The robot.
        base: Positions of the joints that are not named, shape (n,); None if all joints
            must be named.

    Raises:
        ScenarioError: If the table is wrong.
    """
    state, q = table.get("state"), table.get("q")
    if not state.given and not q.given:
        rows = f"q (numbers for {', '.join(robot.joint_names)})"
        table.fail(f"has no joint positions, expected {rows} or state (a group state)")
    if isinstance(q.value, str) and not state.given:
        state, q = q, replace(q, value=None)
    known = {} if base is None else dict(zip(robot.joint_names, base, strict=True))
    if state.given:
        if not isinstance(q.value, dict | None):
            q.fail("expected joints by name beside a state")
        name, states = state.text(), robot.group_states
        if name not in states:
            state.fail(unknown("group state", name, list(states), "the robot has"))
        known |= {k: v for k, v in states[name].items() if k in robot.joint_names}
    return row(replace(q, value={}) if q.value is None else q, robot, known)


def rates(value: Field, robot: Robot) -> Array | None:
    """Read velocities or accelerations of all joints: in joint order, or by name.

    Args:
        value: The values; those of joints that are not named are zero.
        robot: The robot.

    Returns:
        Shape (n,); None without values.

    Raises:
        ScenarioError: If there are too many or too few, or a joint is unknown.
    """
    zeros = dict.fromkeys(robot.joint_names, 0.0)
    return None if value.value is None else row(value, robot, zeros, "velocity")


def row(
    value: Field, robot: Robot, known: Mapping[str, float], quantity: str = "position"
) -> Array:
    """Read numbers in joint order, or by name over known values; shape (n,).

    Args:
        value: The values.
        robot: The robot.
        known: Values of the joints that are not named.
        quantity: Quantity of the values, as of
            :func:`~tominpmp.goals.joints.joint_vector`.

    Raises:
        ScenarioError: If there are too many or too few, or a joint is unknown.
    """
    given = value.value
    if isinstance(given, dict):
        given = {**known, **given}
    with blaming(value):
        return joint_vector(robot, given, value.key, quantity)


def _read_segments(table: Field, robot: Robot, q_start: Array) -> tuple[Segment, ...]:
    """Read the segments of a problem.

    Args:
        table: The list of their tables, with the fields of
            :class:`~tominpmp.problem.segments.Segment` as keys; optional.
        robot: The robot.
        q_start: Start of the first segment, shape (n,) [rad or m].

    Raises:
        ScenarioError: If a table is wrong.
    """
    segments: list[Segment] = []
    before: Array | None = q_start
    for item in table.items():
        segment: Segment = read_phase(Segment, item, robot, before)
        before = segment.goal.configuration
        segments.append(segment)
    return tuple(segments)


def read_phase(
    kind: type[Any], table: Field, robot: Robot, before: Array | None
) -> Any:
    """Read a segment of a motion, or a station of a tour.

    Args:
        kind: Its class, which has a goal, and whose fields are the keys of the table.
        table: Its table.
        robot: The robot.
        before: Positions of the joints that its goal does not name, see
            :func:`_read_goal`.

    Raises:
        ScenarioError: If the table is wrong.
    """
    known = {item.name: item.default for item in fields(kind)}
    table.only(*known)
    for name in (key for key, default in known.items() if default is MISSING):
        table.need(name)
    conditions = read_conditions(table, robot)
    goal = _read_goal(table.get("goal"), robot, before)
    try:
        return kind(goal=goal, **conditions)
    except ProblemError as error:
        # The key names the station.
        said = str(error).removeprefix(f"station {brief(conditions.get('name'))}: ")
        _key_of(table, error.field, known).fail(said)


def _key_of(table: Field, field: str | None, keys: Collection[str]) -> Field:
    """Value of a table that an error concerns, by the field that the error names.

    Args:
        table: Table of a scenario or a segment.
        field: The field, for example "segment.constraints[0].during".
        keys: Keys of the table.

    Returns:
        The innermost value on the path that the file has; the table if it has no value
        on the path.
    """
    item = table
    for step in re.findall(r"\w+", field or ""):
        if isinstance(item.value, list) and step.isdigit():
            item = list(item.items())[int(step)]
        elif item is table and step in keys:
            item = table.get(step)
        elif isinstance(item.value, dict) and step in item.value:
            item = item.get(step)
    return item


# Keys of scenarios, segments and stations whose values their classes check, and readers
# of further keys.
PLAIN = ("may_touch", "dwell", "arrival", "name", "after", "then")
READERS: dict[str, Callable[[Field], Any]] = {
    **dict.fromkeys(PLAIN, attrgetter("value")),
    "scene": _read_scene,
    "margin": Field.number,
    "self_collision": Field.flag,
    "constraints": lambda items: _read_each(items, PathConstraint, "constraint"),
    "payload": lambda item: make(Payload, item, classes(Obstacle)),
    "stop": Field.flag,
}


def read_conditions(table: Field, robot: Robot) -> dict[str, Any]:
    """Read the conditions of a scenario, a tour, a segment or a station.

    Returns:
        The given values, as arguments by name.

    Raises:
        ScenarioError: If a value is wrong.
    """
    items = table.table().items()
    values = {name: READERS[name](item) for name, item in items if name in READERS}
    limits = read_motion_limits(table.get("motion_limits"), robot)
    return values if limits is None else values | {"motion_limits": limits}


# Largest difference of placements and inertias of a robot after writing and reading.
ROUNDING = 1e-9


def difference_of(robot: Robot, other: Robot) -> str:
    """First field in which two robots differ beyond rounding; empty if they agree."""
    values, others = _compared_values(robot), _compared_values(other)
    return next((name for name in values if not _agree(values[name], others[name])), "")


def _agree(first: Any, second: Any) -> bool:
    if not isinstance(first, np.ndarray):
        return bool(first == second)
    same_shape = first.shape == second.shape
    return same_shape and np.allclose(first, second, rtol=ROUNDING, atol=ROUNDING)


def _compared_values(robot: Robot) -> Mapping[str, object]:
    """Fields of a robot to compare, apart from its source; arrays may be rounded."""
    model, srdf = robot.model, robot.srdf
    items = robot.collision_model.geometryObjects
    joints = [str(model.names[item.parentJoint]) for item in items]
    kinds = [type(item.geometry).__name__ for item in items]
    places = [*(frame.placement for frame in model.frames), *model.jointPlacements]
    numbers = ("damping", "armature", "friction", "gravity")
    return {
        "joints, or another order of them": robot.joint_names,
        "locked joints": dict(robot.locked_joints),
        "limits": robot.limits,
        "motion limits": robot.motion_limits,
        "frames": [frame.name for frame in model.frames],
        "shapes": sorted(zip(joints, kinds, strict=True)),
        "pairs of links": () if srdf is None else sorted(srdf.disabled_pairs),
        "group states": dict(robot.group_states),
        **{name: getattr(robot, name).tolist() for name in numbers},
        "placements": np.array([place.homogeneous for place in places]),
        "inertias": np.array([body.toDynamicParameters() for body in model.inertias]),
    }


ROBOT_KEYS = (
    *("name", "path", "srdf", "package_dirs", "group", "limits", "joint_limits"),
    *("motion_limits", "gravity", "locked_joints", "kinematic", "xacro_args"),
    *("payloads", *OVERRIDES),
)


def read_robot(table: Field) -> Robot:
    """Load the robot of a scenario.

    Args:
        table: Its table: ``name`` or ``path``; ``srdf``, ``package_dirs``, ``group``,
            ``limits``, ``locked_joints``, ``gravity``, ``kinematic``, ``xacro_args``
            and the overrides as for :func:`load_robot`; ``joint_limits``, a file of
            MoveIt; ``motion_limits``, which take precedence over it (see
            :func:`read_motion_limits`); ``payloads``, a list of tables with the fields
            of :class:`~tominpmp.robot.payload.Payload`. Paths are relative to the
            scenario file.

    Raises:
        ScenarioError: If the table is wrong or the robot cannot be loaded.
    """
    table.only(*ROBOT_KEYS)
    if table.get("name").given == table.get("path").given:
        table.fail("expected either the name or the path of a robot")
    folder = table.path.parent

    def file(key: str) -> Path | None:
        item = table.get(key)
        return folder / _path(item) if item.given else None

    plain = ("group", "limits", "gravity", "locked_joints", "xacro_args", *OVERRIDES)
    values = {key: table.get(key).value for key in plain}
    try:
        robot = load_limited_robot(
            file("joint_limits"),
            file("path") or table.get("name").text(),
            package_dirs=[folder / _path(k) for k in table.get("package_dirs").items()],
            srdf=file("srdf"),
            kinematic=table.get("kinematic").given and table.get("kinematic").flag(),
            **{key: value for key, value in values.items() if value is not None},
        )
        limits = read_motion_limits(table.get("motion_limits"), robot)
        if limits is not None:
            limits = limits.over(robot.motion_limits, robot.joint_names)
            robot = replace(robot, motion_limits=limits)
    except TominpmpError as error:
        named = getattr(error, "option", None) or getattr(error, "field", None)
        option = named or str(error).partition(":")[0]
        if isinstance(error, ScenarioError):  # of this file, or of that of MoveIt
            option = "joint_limits"
        with blaming(table.get(option) if option in ROBOT_KEYS else table):
            raise
    for item in table.get("payloads").items():
        with blaming(item):
            robot = robot.with_payload(READERS["payload"](item))
    return robot


def _path(item: Field) -> Path:
    """Path in a table, absolute or relative to the folder of its file."""
    with blaming(item):
        return checked_path(item.text())


def robot_table(
    robot: Robot, scenario: Path, files: dict[str, bytes] | None = None
) -> dict[str, Any]:
    """Make the table from which a robot can be loaded again.

    Args:
        robot: The robot.
        scenario: File of the scenario; paths inside its folder are written relative to
            it.
        files: Collects the contents of the files that a robot without files of its own
            needs beside the scenario, by name; None refuses such a robot.

    Returns:
        The table for :func:`read_robot`.

    Raises:
        TypeError: If the robot has a value that cannot be written.
    """
    if robot.parts:
        raise TypeError(
            f"it was combined from several: {', '.join(robot.parts)}; expected one "
            "that was loaded"
        )
    folder, stem = scenario.parent, f"{scenario.stem}_robot"
    loads = [payload.name for payload in robot.payloads]

    def file(ending: str, path: Path, said: str) -> str:
        """Name of a file, which is collected for the scenario if it does not exist."""
        if path.is_file():
            return file_name(path, folder)
        if files is None:
            raise TypeError(
                f"{said} {path}, expected one that was loaded from a file: "
                "tominpmp.save_scenario() writes one beside the scenario"
            )
        name = f"{stem}.{ending}"
        if ending == "urdf":
            text, meshes = urdf_file(robot.description, loads, stem)
            files.update(meshes | {name: text})
        elif robot.srdf is not None:
            files[name] = srdf_file(robot.srdf, robot.name, loads)
        return name

    path, table = robot.urdf_path, dict[str, Any]()
    known, default = None, find_srdf(path)
    with suppress(RobotLoadError):
        known = find_robot(robot.name)
    if known is not None and known.urdf == path and path.is_file():
        table["name"], default = robot.name, known.srdf
        if find_datasheet(*robot.description.known_as(robot.name)) is not None:
            # All limits are written below, including those of the data sheet.
            table["limits"] = "urdf"
    else:
        table["path"] = file("urdf", path, "it was loaded from")
    # Group states of an MJCF file are read from that file again.
    own = path if path.is_file() else None
    if robot.srdf is not None and robot.srdf.path not in (default, own):
        table["srdf"] = file("srdf", robot.srdf.path, "its SRDF file is")
    usual = robot.description.gravity or DEFAULT_GRAVITY
    gravity = [] if np.array_equal(robot.gravity, usual) else robot.gravity.tolist()
    followers = {joint.name for joint in robot.description.joints if joint.mimic}
    locked = {k: v for k, v in robot.locked_joints.items() if k not in followers}
    further = {
        "xacro_args": dict(robot.description.xacro_args),
        "package_dirs": [file_name(d, folder) for d in robot.package_dirs],
        "gravity": gravity,
        "locked_joints": locked,
        "kinematic": robot.kinematic,
        "payloads": to_table(robot.payloads, folder),
    }
    table |= {key: value for key, value in further.items() if value}
    if robot.motion_limits is not None:
        table["motion_limits"] = to_table(robot.motion_limits, folder)
    return table | _overrides(robot, locked)


def _check_given_back(
    robot: Robot, table: Mapping[str, Any], path: Path, files: dict[str, bytes]
) -> None:
    """Check that a robot that is written and loaded again is the same.

    A robot whose files will be next to the scenario may differ by rounding, and in its
    source.

    Args:
        robot: The robot.
        table: The table that :func:`robot_table` made of it.
        path: File of the scenario.
        files: Contents of the files to be written next to it, by name.

    Raises:
        ScenarioError: If it cannot be loaded again.
        TypeError: If it would be a different robot, or cannot be written.
    """
    # The warnings were shown when the robot was loaded.
    with tempfile.TemporaryDirectory() as name, quiet(Warning):
        # Paths of the table are relative to its folder, which is temporary here.
        copy = Path(name) / path.name if files else path
        table = robot_table(robot, copy, {}) if files else table
        _write_files(copy.parent, files)
        restored = read_robot(Field(table, copy, "robot"))
        difference = difference_of(restored, robot)
    if difference or not (files or restored == robot):
        raise TypeError(
            f"it was loaded from {robot.urdf_path}, and files of it would have other "
            f"{difference or 'descriptions'}; expected one that differs from its file "
            "by arguments of load_robot alone"
        )


def _overrides(robot: Robot, locked: Mapping[str, float]) -> dict[str, Any]:
    """Values per joint that differ from those of the description."""
    # URDF files have one effort limit and no armature; models of Pinocchio have both.
    joints = tuple(joint.in_file for joint in robot.description.tree)
    linkage = Linkage.resolve(replace(robot.description, tree=joints), locked)
    plain = JointTable.from_linkage(linkage)
    plain = plain.without_dynamics() if robot.kinematic else plain
    table: dict[str, Any] = {}
    for key in OVERRIDES:
        present, described = robot._table()[key], plain[key]
        changed = {
            name: present[i].tolist()
            for i, name in enumerate(robot.joint_names)
            if not np.array_equal(present[i], described[i])
        }
        if changed:
            table[key] = changed
    return table


MAX_BYTES = 16 * 2**20
# Keys of a scenario in the order in which they are written. A batch finds its results
# by the text of the scenario: in another order it loses the results of older versions.
SECTIONS = (
    *("may_touch", "margin", "self_collision", "robot", "start", "goal", "scene"),
    *("motion_limits", "constraints", "segments", "options"),
)


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
        ScenarioError: If the file, or the problem in it, is wrong; names the key.
    """
    return read_scenario(read_toml(path))


def read_scenario(
    document: Field,
    changes: Callable[[Robot, Mapping[str, Any]], dict[str, Any]] = lambda *_: {},
) -> Scenario:
    """Read the content of a scenario file; its problem may have other conditions.

    Args:
        document: The whole file.
        changes: Makes arguments of the problem that take precedence over those of the
            file, from the robot and from these.

    Raises:
        ScenarioError: As :func:`load_scenario`.
        TominpmpError: If an argument that takes precedence is wrong.
    """
    if (stations := document.get("stations")).given:
        stations.fail("belong to a tour, see tominpmp tour --help")
    document.only(*SECTIONS)
    robot = read_robot(document.need("robot"))
    options = read_options(document.get("options"))
    start = document.need("start")
    start.only("q", "v", "a", "state")
    q_start = positions(start, robot, None)
    v_start, a_start = (rates(start.get(key), robot) for key in "va")
    target = document.get("goal")
    if target.value is None and not document.get("segments").given:
        target.fail("is missing, and there are no segments; expected one or the other")
    goal = None if target.value is None else _read_goal(target, robot, q_start)
    segments = _read_segments(document.get("segments"), robot, q_start)
    conditions = read_conditions(document, robot)
    changed = changes(robot, conditions)
    try:
        problem = Problem(
            robot,
            q_start,
            goal,  # type: ignore[arg-type]
            v_start=v_start,
            a_start=a_start,
            segments=segments,
            **conditions | changed,
        )
    except TominpmpError as error:
        field = getattr(error, "field", None) or ""
        if re.split(r"\W", field)[0] in changed:
            raise
        # The key names the segment, or the start.
        said = re.sub(r"^(segment \d+ of \d+: )?([qva]_start: )?", "", str(error))
        _blamed(document, field).fail(said)
    return Scenario(problem, options)


def _blamed(document: Field, field: str) -> Field:
    """Value of a scenario at fault, by a field of its problem: "segments[1].goal"."""
    if re.match(r"(segments\[0\]\.)?[qva]_start", field):
        return document.get("start")  # also the start of the first segment
    item = _key_of(document, field, SECTIONS)
    return document.get("goal") if item is document else item


def save_scenario(
    path: str | Path, problem: Problem, options: Options | None = None
) -> Path:
    """Write a problem as a scenario file.

    Loading the file gives an equal problem and equal options, except for the callback,
    which no file can represent. The description of a robot that was given as a text or
    as a model of another library is written next to it: ``cell.toml`` refers to
    ``cell_robot.urdf``, and to ``cell_robot.srdf`` and meshes if there are any. Such a
    robot is not equal after loading: it has another source, and differs by rounding.

    Args:
        path: File to write; an existing one is replaced, with the files of its robot
            beside it. The command line knows scenarios by the ending ``.toml``.
        problem: The problem.
        options: The options; None for the defaults.

    Returns:
        The path.

    Raises:
        ScenarioError: If a file cannot represent a value of the problem, or cannot be
            written; if a file of the robot would replace one to which no former
            scenario at the path refers.
    """
    path = checked_path(path, "path", ScenarioError)
    files: dict[str, bytes] = {}
    content = scenario_text(path, problem, options, files=files).encode()
    former = read_bytes(path, MAX_BYTES) if path.is_file() else b""
    for name in (key for key in files if f'"{key}"'.encode() not in former):
        file, new = path.parent / name, files[name]
        if file.exists() and read_bytes(file, max(len(new), MAX_BYTES)) != new:
            Field(None, file).fail(
                f"would be replaced by the robot of {path}, but belongs to something "
                "else; expected another name of the scenario"
            )
    _write_files(path.parent, files)
    return write_bytes(path, content)


def _write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    for name, content in files.items():
        write_bytes(folder / name, content)


def scenario_text(
    path: Path,
    problem: Problem,
    options: Options | None = None,
    *,
    check: bool = True,
    files: dict[str, bytes] | None = None,
) -> str:
    """A problem as the text of a scenario file.

    Args:
        path: Path of the file: paths in it are relative to its folder.
        problem: The problem.
        options: The options; None for the defaults.
        check: Whether to read the robot back, and check that it is the same.
        files: Collects the contents of files to be written next to it, by name; None
            refuses robots that need such files.

    Raises:
        ScenarioError: If a file cannot represent a value of the problem.
    """
    instance(problem, Problem, "problem")
    start = {key: getattr(problem, f"{key}_start") for key in "qva"}
    start = {key: x for key, x in start.items() if key == "q" or np.any(x)}
    parts = {"robot": problem.robot, "start": start, **changed_fields(problem)}
    if problem.segments:
        del parts["goal"]  # it is that of the last segment
    if problem.motion_limits == problem.robot.motion_limits:
        parts.pop("motion_limits", None)

    def written(key: str, part: Any) -> Any:
        if key == "segments":
            return [written(f"{key}[{i}]", item) for i, item in enumerate(part)]
        try:
            if not isinstance(part, Robot):
                return to_table(part, path.parent)
            table = robot_table(part, path, files)
            if check:
                _check_given_back(part, table, path, files or {})
        except TypeError as error:
            Field(None, path, key).fail(f"cannot be saved: {error}")
        return table

    document = {k: written(k, parts[k]) for k in SECTIONS if k in parts}
    changed = written("options", replace(Options.of(options), callback=None))
    if changed:
        document["options"] = changed
    text = toml_text(document)
    try:
        text.encode()
    except UnicodeEncodeError as error:
        Field(None, path).fail(f"a name cannot be saved: {error}")
    return text


def read_toml(path: str | Path) -> Field:
    """Read a TOML file.

    Raises:
        ScenarioError: If the file is missing or not TOML.
    """
    path = checked_path(path, "path", ScenarioError)
    return parse_toml(read_bytes(path, MAX_BYTES), path)


def read_options(table: Field) -> Options:
    """Read options; the defaults if the table is missing.

    Raises:
        ScenarioError: If an option is wrong.
    """
    return Options() if table.value is None else make(Options, table, {})
