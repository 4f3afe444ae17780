"""The segments of a scenario: the goals that a motion passes one after the other.

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
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from tominpmp.arrays import Array
from tominpmp.description.fields import Field
from tominpmp.exceptions import ProblemError, TominpmpError
from tominpmp.motion_limits import MotionLimits
from tominpmp.payload import Payload
from tominpmp.robot import Robot
from tominpmp.scenario.goal_table import read_goal
from tominpmp.scenario.limits_table import read_motion_limits
from tominpmp.scenario.records import classes, make
from tominpmp.scenario.scene_table import read_constraints, read_scene
from tominpmp.scene import Obstacle
from tominpmp.segments import Segment

KEYS = tuple(field.name for field in fields(Segment))
# What errors call the state that the first begins in, which is that of the problem.
STARTS = ("q_start", "v_start")


def read_segments(table: Field, robot: Robot, q_start: Array) -> tuple[Segment, ...]:
    """Read the segments of a problem.

    Args:
        table: The list of their tables, keys as the fields of
            :class:`~tominpmp.segments.Segment`; may be left out.
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
    dwell, stop, scene = table.get("dwell"), table.get("stop"), table.get("scene")
    try:
        return Segment(
            read_goal(table.need("goal"), robot, before),
            constraints=read_constraints(table.get("constraints")),
            motion_limits=_read_limits(table.get("motion_limits"), robot),
            payload=read_payload(table.get("payload")),
            scene=None if scene.value is None else read_scene(scene),
            may_touch=read_pairs(table.get("may_touch")),
            stop=False if stop.value is None else stop.flag(),
            dwell=0.0 if dwell.value is None else dwell.number(),
            arrival=table.get("arrival").value,
        )
    except ProblemError as error:
        _key(table, error.field).fail(str(error))


def _read_limits(table: Field, robot: Robot) -> MotionLimits | None:
    """The limits; none of them is something else than no table, and comes back so."""
    if table.value == {}:
        return MotionLimits()
    return read_motion_limits(table, robot)


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
