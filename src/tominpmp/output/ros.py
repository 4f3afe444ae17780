"""Motions as messages of ROS 2: ``trajectory_msgs/msg/JointTrajectory``.

The YAML is what ``ros2 topic pub`` takes and ``ros2 topic echo`` prints, the JSON has
the same fields. ROS counts time in whole nanoseconds: times are rounded to them, and
pushed apart where two would become one, as controllers refuse equal times.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.description.fields import Field
from tominpmp.description.yaml_reader import parse_yaml
from tominpmp.exceptions import ScenarioError, brief
from tominpmp.trajectory import Samples

BILLION = 10**9
# What a point calls the quantities of samples.
POINT_FIELDS = {
    "q": "positions",
    "v": "velocities",
    "a": "accelerations",
    "u": "effort",
}


def nanoseconds(times: Array) -> IntArray:
    """Round times to whole nanoseconds that still increase.

    Args:
        times: Increasing times [s], shape (m,).

    Returns:
        Shape (m,) [ns].
    """
    steps = np.arange(times.size)
    # Increasing by one at least is not decreasing once a ramp is taken off.
    rounded = np.rint(times * BILLION).astype(np.int64) - steps
    return np.asarray(np.maximum.accumulate(rounded) + steps, dtype=np.int64)


def _points(samples: Samples) -> Iterator[dict[str, Any]]:
    for k, total in enumerate(nanoseconds(samples.t).tolist()):
        sec, nanosec = divmod(total, BILLION)
        point: dict[str, Any] = {}
        for key, name in POINT_FIELDS.items():
            row = getattr(samples, key)[k]
            # Empty is how the message says that it does not know.
            point[name] = [] if np.all(np.isnan(row)) else row.tolist()
        yield point | {"time_from_start": {"sec": sec, "nanosec": nanosec}}


def write_json(samples: Samples, file: BinaryIO) -> None:
    """Write samples as a JSON message, a line a point."""
    header = json.dumps({"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""})
    names = json.dumps(list(samples.joint_names))
    file.write(f'{{"header": {header},\n"joint_names": {names},\n"points": ['.encode())
    for index, point in enumerate(_points(samples)):
        file.write(b",\n" if index else b"\n")
        file.write(json.dumps(point, allow_nan=False).encode())
    file.write(b"\n]}\n")


def write_yaml(samples: Samples, file: BinaryIO) -> None:
    """Write samples as a YAML message."""
    text = io.TextIOWrapper(file, encoding="utf-8", newline="\n")
    text.write("header:\n  stamp: {sec: 0, nanosec: 0}\n  frame_id: ''\n")
    text.write(f"joint_names: {json.dumps(list(samples.joint_names))}\npoints:\n")
    for point in _points(samples):
        time = point.pop("time_from_start")
        mark = "-"
        for name, values in point.items():
            text.write(f"{mark} {name}: [{', '.join(map(_number, values))}]\n")
            mark = " "
        text.write(
            f"  time_from_start: {{sec: {time['sec']}, nanosec: {time['nanosec']}}}\n"
        )
    text.flush()
    text.detach()  # the file is closed by whoever opened it


def _number(value: float) -> str:
    """Write a number so that YAML 1.1 knows it for one: 1.0e-05, not 1e-05."""
    mantissa, mark, exponent = repr(value).partition("e")
    if mark and "." not in mantissa:
        mantissa += ".0"
    return mantissa + mark + exponent


def read_yaml(content: bytes, path: Path) -> Samples:
    """Read a YAML message; see :func:`read_message`."""
    return read_message(Field(parse_yaml(content, path), path))


def read_json(content: bytes, path: Path) -> Samples:
    """Read a JSON message; see :func:`read_message`."""
    try:
        message = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{path} is no JSON: {error}", path) from error
    return read_message(Field(message, path))


def read_message(message: Field) -> Samples:
    """Read a JointTrajectory, also one inside a RobotTrajectory or an action goal.

    Velocities, accelerations and effort may be left out, of all points alike. Times are
    read as ROS 2, ROS 1 (secs, nsecs) or a single number [s] have them.

    Args:
        message: The message.

    Returns:
        The samples; what the message leaves out is NaN.

    Raises:
        ScenarioError: If it is none, with the key.
    """
    for wrapper in ("goal", "trajectory", "joint_trajectory"):
        if message.get("points").value is None and message.get(wrapper).given:
            message = message.get(wrapper)
            if isinstance(message.value, list) and len(message.value) == 1:
                message = next(iter(message.items()))
    names = tuple(item.text() for item in message.need("joint_names").items())
    points = list(message.need("points").items())
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
    return Samples(names, times.reshape(len(points)), **parts)


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
            item.fail(f"is {brief(item.value)}, expected a whole number")
        item.number()  # refuses what does not fit into a float
        total += item.value * unit
    return total / BILLION
