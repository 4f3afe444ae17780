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
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import fields, replace
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints import PathConstraint
from tominpmp.description.fields import Field
from tominpmp.exceptions import (
    JointNotFound,
    ProblemError,
    TominpmpError,
)
from tominpmp.files.limits import load_motion_limits
from tominpmp.files.records import blaming, classes, from_table, make
from tominpmp.goals import Goal, JointGoal
from tominpmp.motion_limits import (
    EffortCurve,
    MotionLimits,
    classes_of_limits,
    kinds_of,
)
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
            :mod:`~tominpmp.files.limits`.
        robot: The robot.

    Returns:
        The limits; None if there are none.

    Raises:
        ScenarioError: If the table is wrong.
    """
    if not table.given:
        return None
    kind = _class_with(table.table().keys() - {"file"})
    table.only("file", *(field.name for field in fields(kind)))
    values = _of_file(table.get("file"), robot)
    for name, item in table.table().items():
        if name != "file":
            values[name] = _limit(name, item, values.get(name, {}))
    with blaming(table):
        limits = kind(**values)
        limits.check(robot.joint_names)
    return limits


def _class_with(names: Set[str]) -> type[MotionLimits]:
    """The first class of motion limits that has some fields; a caller's may be one."""
    every = classes_of_limits()
    fitting = (kind for kind in every if names <= {item.name for item in fields(kind)})
    return next(fitting, MotionLimits)


def _of_file(item: Field, robot: Robot) -> dict[str, Any]:
    """Limits of the YAML file that a table refers to, relative to its own file."""
    if item.value is None:
        return {}
    limits = load_motion_limits(item.path.parent / item.text(), robot)
    given = {name: getattr(limits, name) for name in kinds_of(limits)}
    found: dict[str, Any] = {k: dict(value) for k, value in given.items() if value}
    return found | {"effort_scale": limits.effort_scale}


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
    for name in kinds_of(others, numbers=True):
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
    with blaming(table.get("obstacles")):
        return Scene(obstacles)


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
    with blaming(table):
        return JointGoal(q, None if v.value is None else vector(v, robot))


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
        with blaming(state):
            base = robot.group_state(state.text())
    if q.value is None:
        return np.array(base)
    return vector(q, robot, base)


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
        key_of(table, error.field).fail(str(error))


def read_payload(table: Field) -> Payload:
    """Read a payload.

    Raises:
        ScenarioError: If it is none.
    """
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


def key_of(table: Field, field: str | None) -> Field:
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


def blamed(
    document: Field, goal: Goal | None, segments: Sequence[Segment], robot: Robot
) -> Field:
    """What of a scenario names a frame, a joint or a load that the robot has not."""
    items = document.get("segments").items()
    for item, segment in zip(items, segments, strict=True):
        try:
            loaded = segment.robot(robot)
        except TominpmpError:
            return item.get("payload")
        constraints = item.get("constraints").items()
        given: list[tuple[Field, Any]] = [(item.get("goal"), segment.goal)]
        given += zip(constraints, segment.constraints, strict=True)
        for table, named in given:
            try:
                named.validate(loaded)
            except TominpmpError:
                return table
    try:
        if goal is not None:
            goal.validate(robot)
    except TominpmpError:
        return document.get("goal")
    return document.get("constraints")


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
