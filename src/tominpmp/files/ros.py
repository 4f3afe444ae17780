"""Motions as messages of ROS 2, as YAML and JSON.

The YAML is what ``ros2 topic pub`` and ``ros2 action send_goal`` take and ``ros2 topic
echo`` prints, the JSON has the same fields. ROS counts time in whole nanoseconds, so
that is where a motion is looked at: what a point says holds at its time, to the last
bit. Efforts are left out unless they are asked for, as most controllers refuse them,
and so are accelerations that jump: a controller runs a polynomial of degree 5 through
accelerations, which overshoots at a jump, and a cubic where there are none, which is
the motion itself.

Whatever a file says that does not become part of the motion is told of: a key that no
message has is an error, tolerances of a goal and the like a warning.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.checks import choice
from tominpmp.description.fields import Field
from tominpmp.description.yaml_reader import MAX_VALUES
from tominpmp.exceptions import ProblemError, ScenarioError, warn_caller
from tominpmp.motion.samples import BILLION, Samples
from tominpmp.motion.trajectory import Trajectory

# What a point calls the quantities of samples.
POINT_FIELDS = {
    "q": "positions",
    "v": "velocities",
    "a": "accelerations",
    "u": "effort",
}
# Messages, and the keys under which they hold a JointTrajectory.
MESSAGES: dict[str, tuple[str, ...]] = {
    "JointTrajectory": (),
    "FollowJointTrajectory": ("trajectory",),
    "RobotTrajectory": ("joint_trajectory",),
}
# The one that is written unless another one is asked for.
MESSAGE = "JointTrajectory"
# Nodes closer than this to the one before are left out [ns]: over less time the last
# digits of positions make more acceleration than the jump that is moved.
CLOSEST = 100
# Velocities at the end up to this [rad/s or m/s] are rounding and written as zero:
# controllers refuse motions that do not end at rest.
AT_REST = 1e-6
# Jumps of accelerations up to this, relative to the largest one, are rounding.
CONTINUOUS = 1e-6
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


def check_message(name: object) -> None:
    """Check the name of a message.

    Raises:
        ProblemError: If motions are not written as such.
    """
    choice(name, tuple(MESSAGES), "message")


def nanoseconds(times: Array) -> IntArray:
    """Round increasing times [s] to whole nanoseconds that still increase."""
    steps = np.arange(times.size)
    # Increasing by one at least is not decreasing once a ramp is taken off.
    rounded = np.rint(times * BILLION).astype(np.int64) - steps
    return np.asarray(np.maximum.accumulate(rounded) + steps, dtype=np.int64)


def message_samples(
    trajectory: Trajectory, dt: float | None, with_effort: bool
) -> Samples:
    """What the points of a message hold, at whole nanoseconds; what is left out is NaN.

    Raises:
        ProblemError: If dt is not a positive number, or less than 100 ns.
    """
    if isinstance(dt, int | float) and 0.0 < dt * BILLION < CLOSEST:
        raise ProblemError(
            f"dt is {dt} s, expected {CLOSEST} ns at least for a ROS message", "dt"
        )
    times = trajectory.t if dt is None else trajectory.sample(dt).t
    ticks = _spread(nanoseconds(times), trajectory.duration)
    q, v, a, u = (part.copy() for part in trajectory(ticks / BILLION))
    # The last tick may be half a rounding early.
    end = trajectory.v[-1]
    q[-1], v[-1] = trajectory.q[-1], np.where(np.abs(end) <= AT_REST, 0.0, end)
    if not accelerations_continue(trajectory):
        a[:] = np.nan
    if not with_effort:
        u[:] = np.nan
    names = trajectory.joint_names
    return Samples(names, ticks / BILLION, q, v, a, u, "controller")


def _spread(ticks: IntArray, duration: float) -> IntArray:
    """Ticks [ns] that are far enough apart; the last is not before the end."""
    if ticks.size == 1:
        return ticks
    last = max(int(np.ceil(duration * BILLION - 1e-3)), CLOSEST)
    kept = [0]
    for tick in ticks[1:-1].tolist():
        if tick - kept[-1] >= CLOSEST and last - tick >= CLOSEST:
            kept.append(tick)
    return np.array([*kept, last], dtype=np.int64)


def accelerations_continue(trajectory: Trajectory) -> bool:
    """Whether the accelerations of a motion do not jump at its nodes."""
    if trajectory.a is not None and trajectory.a.shape == trajectory.q.shape:
        return True
    t, nodes = trajectory.t, np.arange(1, trajectory.t.size - 1)
    if trajectory.a is not None:
        before, after = trajectory.a[nodes - 1], trajectory.a[nodes]
    else:
        # The acceleration of a cubic is linear: what it ends with follows from the
        # beginning and the middle.
        begin, middle = trajectory(t[nodes - 1]).a, 0.5 * (t[nodes - 1] + t[nodes])
        before = 2.0 * trajectory(middle).a - begin
        after = trajectory(t[nodes]).a
    largest = max(np.max(np.abs(before), initial=0.0), np.max(np.abs(after), initial=0))
    return bool(np.all(np.abs(after - before) <= CONTINUOUS * largest))


def _points(samples: Samples) -> Iterator[dict[str, Any]]:
    for k, total in enumerate(nanoseconds(samples.t).tolist()):
        sec, nanosec = divmod(total, BILLION)
        point: dict[str, Any] = {}
        for key, name in POINT_FIELDS.items():
            row = getattr(samples, key)[k]
            # Empty is how the message says that it does not know.
            point[name] = [] if np.all(np.isnan(row)) else row.tolist()
        yield point | {"time_from_start": {"sec": sec, "nanosec": nanosec}}


def message_data(samples: Samples) -> dict[str, Any]:
    """A JointTrajectory as plain values."""
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(samples.joint_names),
        "points": list(_points(samples)),
    }


def write_json(samples: Samples, file: BinaryIO, message: str = MESSAGE) -> None:
    """Write samples as a JSON message, a line a point."""
    header = json.dumps({"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""})
    names = json.dumps(list(samples.joint_names))
    keys = MESSAGES[message]
    for key in keys:
        file.write(f'{{"{key}": '.encode())
    file.write(f'{{"header": {header},\n"joint_names": {names},\n"points": ['.encode())
    for index, point in enumerate(_points(samples)):
        file.write(b",\n" if index else b"\n")
        parts = [f'"{name}": {_value(part)}' for name, part in point.items()]
        file.write(f"{{{', '.join(parts)}}}".encode())
    file.write(b"\n]}" + b"}" * len(keys) + b"\n")


def _value(part: Any) -> str:
    """A part of a point as JSON that YAML 1.1, which ROS reads, understands too."""
    if isinstance(part, list):
        return f"[{', '.join(map(_number, part))}]"
    return json.dumps(part)


def write_yaml(samples: Samples, file: BinaryIO, message: str = MESSAGE) -> None:
    """Write samples as a YAML message."""
    indent = ""
    for key in MESSAGES[message]:
        file.write(f"{indent}{key}:\n".encode())
        indent += "  "
    for line in _yaml_lines(samples):
        file.write(f"{indent}{line}\n".encode())


def _yaml_lines(samples: Samples) -> Iterator[str]:
    yield "header:"
    yield "  stamp: {sec: 0, nanosec: 0}"
    yield "  frame_id: ''"
    yield f"joint_names: [{', '.join(map(_quoted, samples.joint_names))}]"
    yield "points:"
    for point in _points(samples):
        mark = "-"
        for name, part in point.items():
            value = _value(part).replace('"', "")
            yield f"{mark} {name}: {value}"
            mark = " "


def _quoted(name: str) -> str:
    """A text in quotes as YAML has them, where JSON writes two halves of a letter."""
    return re.sub(
        "[^ -~]",
        lambda found: f"\\U{ord(found.group()):08x}",
        json.dumps(name, ensure_ascii=False),
    )


def _number(value: float) -> str:
    """Write a number so that YAML 1.1 knows it for one: 1.0e-05, not 1e-05."""
    mantissa, mark, exponent = repr(value).partition("e")
    if mark and "." not in mantissa:
        mantissa += ".0"
    return mantissa + mark + exponent


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
    times = np.array([_seconds(point.need("time_from_start")) for point in points])
    return Samples(
        names, times.reshape(len(points)), **parts, interpolation="controller"
    )


def _seconds(value: Field) -> float:
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
