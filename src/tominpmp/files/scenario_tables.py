"""What the tables of a scenario hold beside the robot and the options.

Goals, scenes, constraints, limits, and the segments of a motion: the goals that it
passes one after the other.

::

    may_touch = [["panda_hand", "lid"]]     # on all segments

    [[segments]]
    goal = {type = "joint", q = {panda_joint1 = 1.2}}

    [[segments]]
    stop = true                             # the arm is at rest at its end
    dwell = 0.1                             # and stays there so long [s]
    arrival = [1.0, 2.5]                    # no earlier and no later [s]
    may_touch = [["box", "table"]]
    motion_limits = {acceleration = 5.0}
    goal = {type = "position", frame = "panda_hand_tcp", position = [0.5, 0.0, 0.1]}
    payload = {mass = 1.0, frame = "panda_hand"}

    [[segments.constraints]]
    type = "tool_speed"
    frame = "panda_hand_tcp"
    limit = 0.5

    [[segments.scene.obstacles]]            # instead of those of the problem
    type = "box"
    name = "table"
    size = [1.0, 1.0, 0.1]

Joints that the goal of a segment does not name are where the segment before ends, if
its goal says so; ``scene = {}`` is a segment without obstacles.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints import PathConstraint
from tominpmp.description.fields import Field
from tominpmp.exceptions import (
    JointNotFound,
    ProblemError,
    ScenarioError,
    TominpmpError,
)
from tominpmp.files.motion_limits import load_motion_limits
from tominpmp.files.records import classes, from_table, make
from tominpmp.goals import Goal, JointGoal
from tominpmp.motion_limits import UNITS, EffortCurve, MotionLimits
from tominpmp.problem.segments import Segment
from tominpmp.robot import Robot
from tominpmp.robot.payload import Payload
from tominpmp.scene import Obstacle, Scene


def read_motion_limits(table: Field, robot: Robot) -> MotionLimits | None:
    """Read the limits.

    Args:
        table: Their table, keys as the fields of
            :class:`~tominpmp.motion_limits.MotionLimits`; may be left out. ``file``
            names a YAML file that the other keys go before, see
            :mod:`~tominpmp.files.motion_limits`.
        robot: The robot.

    Returns:
        The limits; None if there are none.

    Raises:
        ScenarioError: If the table is wrong.
    """
    if not table.given:
        return None
    table.only("file", *(field.name for field in fields(MotionLimits)))
    values = _of_file(table.get("file"), robot)
    for name, item in table.table().items():
        if name != "file":
            values[name] = _limit(name, item, values.get(name, {}))
    try:
        limits = MotionLimits(**values)
        limits.check(robot.joint_names)
    except TominpmpError as error:
        table.fail(str(error))
    return limits


def _of_file(item: Field, robot: Robot) -> dict[str, Any]:
    """Limits of the YAML file that a table refers to, relative to its own file."""
    if item.value is None:
        return {}
    limits = load_motion_limits(item.path.parent / item.text(), robot)
    found: dict[str, Any] = {"effort_scale": limits.effort_scale}
    if limits.effort_curves:
        found["effort_curves"] = dict(limits.effort_curves)
    for name in UNITS:
        own = getattr(limits, name)
        if own is not None:
            found[name] = dict(own)
    return found


def _limit(name: str, item: Field, before: Mapping[str, Any]) -> Any:
    if name == "effort_curves":
        curves = {
            joint: make(EffortCurve, curve.table(), curve, {})
            for joint, curve in item.table().items()
        }
        return {**before, **curves}
    if isinstance(item.value, dict):
        own = {k: v.number(infinite=True) for k, v in item.table().items()}
        return {**before, **own}
    return item.value


def beyond(
    limits: MotionLimits, others: MotionLimits | None, robot: Robot
) -> MotionLimits:
    """The same limits, so that they are what they are over those of the robot."""
    if others is None:
        return limits
    names = robot.joint_names
    freed: dict[str, Any] = {}
    for name in UNITS:
        own, below = limits.by_joint(name, names), others.by_joint(name, names)
        if np.any(np.isinf(own) & np.isfinite(below)):
            freed[name] = dict(zip(names, own.tolist(), strict=True))
    return replace(limits, **freed)


def read_scene(table: Field) -> Scene:
    """Read a scene from its table, whose key ``obstacles`` is a list of tables.

    Raises:
        ScenarioError: If the table is wrong.
    """
    if not table.given:
        return Scene()
    table.only("obstacles")
    kinds = classes(Obstacle)
    items = table.get("obstacles").items()
    obstacles = [from_table(item, kinds, "obstacle") for item in items]
    try:
        return Scene(obstacles)
    except TominpmpError as error:
        table.get("obstacles").fail(str(error))


def _read_constraints(table: Field) -> tuple[PathConstraint, ...]:
    """Read a list of constraints; none if it is left out.

    Raises:
        ScenarioError: If one is wrong.
    """
    if not table.given:
        return ()
    kinds = classes(PathConstraint, "")
    return tuple(from_table(item, kinds, "constraint") for item in table.items())


def read_goal(table: Field, robot: Robot, before: Array | None) -> Goal:
    """Read a goal.

    Args:
        table: Its table: ``type`` and the fields of its class. That of a configuration
            may give the joints by name, or a ``state``.
        robot: The robot.
        before: Where the joints that are not named are, shape (n,) [rad or m]; None if
            that is not known.

    Raises:
        ScenarioError: If the table is wrong.
    """
    kinds = classes(Goal)
    if table.get("type").value != "joint":
        goal: Goal = from_table(table, kinds, "goal")
        return goal
    table.only("type", "q", "v", "state")
    q = positions(table, robot, before)
    v = table.get("v")
    try:
        return JointGoal(q, None if v.value is None else vector(v, robot))
    except TominpmpError as error:
        table.fail(str(error))


def positions(table: Field, robot: Robot, base: Array | None) -> Array:
    """Read positions of all joints: numbers, a group state, some by name, or both.

    Args:
        table: The table that has them as ``q``, ``state``, or both.
        robot: The robot.
        base: Positions of the joints that are not named, shape (n,); None if all have
            to be.

    Raises:
        ScenarioError: If the table is wrong.
    """
    state, q = table.get("state"), table.get("q")
    if not state.given and q.value is None:
        table.fail("says nothing of joint positions: expected q or state")
    if isinstance(q.value, str):
        state, q = q, Field(None, q.path, q.key)
    if state.given:
        if isinstance(q.value, list):
            q.fail("expected joints by name beside a state")
        base = _group_state(state, robot)
    if q.value is None:
        return np.array(base)
    return vector(q, robot, base)


def _group_state(state: Field, robot: Robot) -> Array:
    try:
        return robot.group_state(state.text())
    except ScenarioError:
        raise
    except TominpmpError as error:
        state.fail(str(error))


def vector(value: Field, robot: Robot, base: Array | None = None) -> Array:
    """Read values of all joints: numbers in joint order, or by name.

    Positions that are not named are those of the base, velocities are zero.

    Raises:
        ScenarioError: If there are too many or too few, or a joint is unknown.
    """
    if not isinstance(value.value, dict):
        numbers = value.numbers()
        if len(numbers) != robot.n:
            value.fail(
                f"holds {len(numbers)} numbers, expected {robot.n}, one for each of: "
                f"{', '.join(robot.joint_names)}"
            )
        return np.array(numbers)
    given = value.table()
    for name, item in given.items():
        if name not in robot.joint_names:
            item.fail(str(JointNotFound(name, robot.joint_names)))
    lacking = [name for name in robot.joint_names if name not in given]
    if lacking and base is None and value.key.endswith("q"):
        value.fail(f"says nothing about {', '.join(lacking)}")
    rest = np.zeros(robot.n) if base is None else base
    return np.array(
        [
            given[name].number() if name in given else rest[i]
            for i, name in enumerate(robot.joint_names)
        ]
    )


KEYS = tuple(field.name for field in fields(Segment))
# What errors call the state that the first begins in, which is that of the problem.
STARTS = ("q_start", "v_start")


def read_segments(table: Field, robot: Robot, q_start: Array) -> tuple[Segment, ...]:
    """Read the segments of a problem.

    Args:
        table: The list of their tables, keys as the fields of
            :class:`~tominpmp.problem.segments.Segment`; may be left out.
        robot: The robot.
        q_start: Where the first begins, shape (n,) [rad or m].

    Raises:
        ScenarioError: If a table is wrong.
    """
    found: list[Segment] = []
    before: Array | None = q_start
    for item in table.items():
        segment = _read_segment(item, robot, before)
        before = segment.goal.configuration
        found.append(segment)
    return tuple(found)


def _read_segment(table: Field, robot: Robot, before: Array | None) -> Segment:
    table.only(*KEYS)
    found = read_conditions(table, robot)
    if table.get("motion_limits").value == {}:
        # A table without limits is another value than no table, and comes back so.
        found["motion_limits"] = MotionLimits()
    try:
        return Segment(read_goal(table.need("goal"), robot, before), **found)
    except ProblemError as error:
        _key(table, error.field).fail(str(error))


def read_payload(table: Field) -> Payload | None:
    """Read a payload; None if it is left out.

    Raises:
        ScenarioError: If it is none.
    """
    if table.value is None:
        return None
    return make(Payload, table.table(), table, classes(Obstacle))


def read_pairs(
    table: Field, about: str = "of what may touch"
) -> tuple[tuple[str, str], ...]:
    """Read pairs of names; none if they are left out.

    Args:
        table: The list of them.
        about: What the names are, for messages.

    Raises:
        ScenarioError: If they are no such pairs.
    """
    found = []
    for item in table.items():
        names = [name.text() for name in item.items()]
        if len(names) != 2:
            item.fail(f"holds {len(names)} names, expected two, {about}")
        found.append((names[0], names[1]))
    return tuple(found)


def _key(table: Field, field: str | None) -> Field:
    """What of a segment an error is about, by the field that it names."""
    names = re.split(r"[.\[]", field or "")
    name = next((name for name in names if name in KEYS), None)
    if name is None or field is None:
        return table
    found = table.get(name)
    if name != "constraints":
        return found
    return followed(found, field[field.index(name) + len(name) :])


def followed(table: Field, path: str) -> Field:
    """What a path leads to, as "[0].during"; as far as the file has it."""
    for number, name in re.findall(r"\[(\d+)\]|\.(\w+)", path):
        if number and isinstance(table.value, list) and int(number) < len(table.value):
            table = list(table.items())[int(number)]
        elif name and isinstance(table.value, dict) and name in table.value:
            table = table.get(name)
        else:
            break
    return table


def blamed_segment(
    table: Field, segments: Sequence[Segment], robot: Robot, field: str | None
) -> Field | None:
    """What of the segments a problem could not be made with.

    Args:
        table: The list of their tables.
        segments: What was read from it.
        robot: The robot.
        field: What the error about the problem names, if it names anything.

    Returns:
        The table of a segment, or a key of it; None if it is none of them.
    """
    items = list(table.items())
    of_one = re.match(r"segments\[(\d+)\]\.(.*)", field or "")
    if of_one is not None:
        number, rest = int(of_one[1]), of_one[2]
        own = number > 0 or not rest.startswith(STARTS)
        return _key(items[number], rest) if own else None
    if field is not None:
        return None
    # That a frame or a joint is unknown does not say who named it.
    each = zip(items, segments, strict=True)
    found = (_unknown_name(item, segment, robot) for item, segment in each)
    return next((item for item in found if item is not None), None)


def _unknown_name(table: Field, segment: Segment, robot: Robot) -> Field | None:
    """The key of a segment that names what the robot has not."""
    try:
        robot = segment.robot(robot)
    except TominpmpError:
        return table.get("payload")
    given: list[tuple[Field, Any]] = [(table.get("goal"), segment.goal)]
    constraints = table.get("constraints").items()
    given += zip(constraints, segment.constraints, strict=True)
    for item, named in given:
        try:
            named.validate(robot)
        except TominpmpError:
            return item
    return None


# How the keys are read that whole scenarios and segments have.
READERS: dict[str, Callable[[Field], Any]] = {
    "scene": read_scene,
    "margin": Field.number,
    "self_collision": Field.flag,
    "constraints": _read_constraints,
    "payload": read_payload,
    "may_touch": read_pairs,
    "stop": Field.flag,
    "dwell": Field.number,
    "arrival": lambda item: item.value,
}


def read_conditions(table: Field, robot: Robot) -> dict[str, Any]:
    """Read what holds on the way of a scenario, a tour or a segment.

    Returns:
        The values that are given, as arguments by name.

    Raises:
        ScenarioError: If a value is wrong.
    """
    items = table.table().items()
    found = {name: READERS[name](item) for name, item in items if name in READERS}
    limits = read_motion_limits(table.get("motion_limits"), robot)
    return found | {"motion_limits": limits}
