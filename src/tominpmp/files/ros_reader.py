"""Motions from messages of ROS: a JointTrajectory, or what holds one.

Whatever a file says that does not become part of the motion is told of: a key that no
message has is an error, tolerances of a goal and the like a warning.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.description.fields import Field
from tominpmp.description.yaml_reader import MAX_VALUES
from tominpmp.exceptions import ScenarioError, warn_caller
from tominpmp.files.ros import POINT_FIELDS
from tominpmp.motion.samples import BILLION, Samples

MESSAGE_KEYS = ("header", "joint_names", "points")
POINT_KEYS = (*POINT_FIELDS.values(), "time_from_start")
# Under what a message is found in another one, from outside in.
WRAPPERS = ("goal", "trajectory", "joint_trajectory")
# What else those others hold that says nothing about the motion.
ASIDES = (
    "header",
    "goal_id",
    "model_id",
    "trajectory_start",
    "group_name",
    "planning_time",
    "error_code",
    "controller_names",
)
# What moves more than joints.
MULTIPLE = ("multi_dof_trajectory", "multi_dof_joint_trajectory")


def parse_json(content: bytes, path: Path) -> Any:
    """Parse JSON.

    Raises:
        ScenarioError: If it is none.
    """
    # No value without a sign that opens or ends it; small ones would fill the memory.
    if sum(map(content.count, (b"[", b"{", b",", b":"))) > MAX_VALUES:
        raise ScenarioError(f"{path} holds more than {MAX_VALUES} values", path)
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{path} is no JSON: {error}", path) from error


def find_trajectory(message: Field, *, mention: bool = True) -> Field:
    """The JointTrajectory in a message: itself, or in a goal or a RobotTrajectory.

    Args:
        message: The message.
        mention: Whether to warn of what stands beside it.

    Raises:
        ScenarioError: If the message has something that moves more than joints, or more
            than one trajectory.
    """
    for wrapper in WRAPPERS:
        if message.get("points").value is not None or not message.get(wrapper).given:
            continue
        _look_beside(message, wrapper, mention)
        message = message.get(wrapper)
        if isinstance(message.value, list):
            if len(message.value) != 1:
                message.fail(f"holds {len(message.value)} trajectories, expected one")
            message = next(iter(message.items()))
    return message


def _look_beside(message: Field, wrapper: str, mention: bool) -> None:
    """Refuse what else moves beside a trajectory, and tell of other things."""
    for name, item in message.table().items():
        if name in MULTIPLE:
            if item.get("points").given or item.get("joint_names").given:
                item.fail("moves joints of several degrees of freedom: not supported")
        elif name == wrapper or name in ASIDES or _says_nothing(item.value):
            continue
        elif mention:
            warn_caller(
                f"{message.path}: {item.key} is not looked at: it is no part of the "
                "motion"
            )


def _says_nothing(value: Any) -> bool:
    """Whether a value is empty, or zero as in messages that were not filled in."""
    if isinstance(value, dict):
        return all(map(_says_nothing, value.values()))
    return value in (None, "", 0) or value == []


def read_message(message: Field) -> Samples:
    """Read a JointTrajectory, also one inside a RobotTrajectory or an action goal.

    Velocities, accelerations and effort may be left out, of all points alike. Times are
    read as ROS 2, ROS 1 (secs, nsecs) or a single number [s] have them.

    Returns:
        The samples, to be joined as a controller does; what the message leaves out is
        NaN.

    Raises:
        ScenarioError: If it is none, with the key.
    """
    message = find_trajectory(message)
    names = tuple(item.text() for item in message.need("joint_names").items())
    points = list(message.need("points").items())
    message.only(*MESSAGE_KEYS)
    for point in points:
        point.only(*POINT_KEYS)
    parts: dict[str, Array] = {}
    for key, name in POINT_FIELDS.items():
        found = [point.get(name) for point in points]
        given = [item.given for item in found]
        if key == "q" or any(given):
            rows = [item.numbers(len(names)) for item in found]
            parts[key] = np.array(rows).reshape(len(points), len(names))
        else:
            parts[key] = np.full((len(points), len(names)), np.nan)
    times = np.array([_time(point.need("time_from_start")) for point in points])
    return Samples(
        names, times.reshape(len(points)), **parts, interpolation="controller"
    )


def _time(value: Field) -> float:
    """Seconds of a Duration."""
    if not isinstance(value.value, dict):
        return value.number()
    old = "secs" in value.value or "nsecs" in value.value
    sec, nanosec = ("secs", "nsecs") if old else ("sec", "nanosec")
    value.only(sec, nanosec)
    total = 0
    for name, unit in ((sec, BILLION), (nanosec, 1)):
        item = value.get(name)
        if not item.given:
            continue
        if not isinstance(item.value, int) or isinstance(item.value, bool):
            item.fail(f"is {item.value!r}, expected a whole number")
        item.number()  # refuses what does not fit into a float
        total += item.value * unit
    return total / BILLION
