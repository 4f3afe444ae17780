"""Motions as messages of ROS 2, in YAML, JSON and bags, and the rules of controllers.

The YAML is the format that ``ros2 topic pub`` and ``ros2 action send_goal`` take and
``ros2 topic echo`` prints; the JSON has the same fields. ROS counts time in whole
nanoseconds, so the motion is evaluated at these times: each point is exact at its time,
to the last bit. Efforts are omitted unless requested, as most controllers refuse them,
and so are accelerations that jump: a controller interpolates accelerations with a
polynomial of degree 5, which overshoots at a jump, and uses a cubic without them, which
is the motion itself.

Content of a file that does not enter the motion is reported: an unknown key is an
error; tolerances of a goal and the like cause a warning.

Bags are MCAP files with one message ``JointTrajectory``. ``ros2 bag play`` publishes it
on the topic to which a joint trajectory controller subscribes. The file is complete by
itself; it needs no folder around it.

The rules of that controller are taken from its documentation and its log messages, from
Humble on. Drivers that take the same message (Universal Robots, Franka, MoveIt) have
the same rules.
"""

from __future__ import annotations

import json
import re
import struct
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import numpy as np
import yaml

from tominpmp.arrays import Array, IntArray
from tominpmp.checks import INT64_END, wrong
from tominpmp.checks import names as joints_named
from tominpmp.description.fields import Field
from tominpmp.description.yaml_reader import MAX_VALUES
from tominpmp.exceptions import (
    ProblemError,
    ScenarioError,
    brief,
    optional,
    shortened,
    warn_caller,
)
from tominpmp.files.tables import filled_samples, known_quantities
from tominpmp.motion.measures import accelerations_continue
from tominpmp.motion.samples import BILLION, Samples
from tominpmp.motion.trajectory import Trajectory

# Fields of a point by the quantities of samples.
POINT_FIELDS = {
    "q": "positions",
    "v": "velocities",
    "a": "accelerations",
    "u": "effort",
}
# Message types, with the keys under which they contain a JointTrajectory.
MESSAGES: dict[str, tuple[str, ...]] = {
    "JointTrajectory": (),
    "FollowJointTrajectory": ("trajectory",),
    "RobotTrajectory": ("joint_trajectory",),
}
# Form of names in YAML: on one line, and quoted, as some readers take 1e5 for a number.
QUOTED: Any = {"default_flow_style": True, "default_style": '"', "width": 2**30}
# Default message type.
MESSAGE = "JointTrajectory"
# Nodes closer than this to the previous one are left out [ns]: over less time, the last
# digits of the positions imply more acceleration than the shift of a jump.
MIN_STEP = 100
# Final velocities up to this are rounding and written as zero [rad/s or m/s]:
# controllers refuse motions that do not end at rest.
AT_REST = 1e-6
# Keys under which an outer message contains the trajectory, from the outside in.
OUTER_KEYS = ("goal", "trajectory", "joint_trajectory")
# Further keys of outer messages, which do not affect the motion.
IGNORED_KEYS = (
    "header",
    "goal_id",
    "model_id",
    "trajectory_start",
    "group_name",
    "planning_time",
    "error_code",
    "controller_names",
)
# Keys of trajectories that move joints of several degrees of freedom.
MULTI_DOF_KEYS = ("multi_dof_trajectory", "multi_dof_joint_trajectory")


def message_samples(
    trajectory: Trajectory, dt: float | None, with_effort: bool
) -> Samples:
    """Samples for the points of a message, at whole nanoseconds; NaN if omitted.

    Raises:
        ProblemError: If dt is not a positive number, or less than 100 ns.
    """
    if isinstance(dt, int | float) and 0.0 < dt * BILLION < MIN_STEP:
        raise wrong(dt, "dt", f"{MIN_STEP} ns at least for a ROS message")
    times = trajectory.t if dt is None else trajectory.sample(dt).t
    ticks = _times_of_points(times, trajectory.duration)
    q, v, a, u = (part.copy() for part in trajectory(ticks / BILLION))
    # The last tick is up to a nanosecond late, or half a nanosecond early by rounding.
    late = ticks[-1] / BILLION - trajectory.duration
    end = np.where(np.abs(trajectory.v[-1]) <= AT_REST, 0.0, trajectory.v[-1])
    q[-1], v[-1] = trajectory.q[-1] + late * end, end
    if not accelerations_continue(trajectory):
        a[:] = np.nan
    if not with_effort:
        u[:] = np.nan
    return Samples(trajectory.joint_names, ticks / BILLION, q, v, a, u, "controller")


def _times_of_points(times: Array, duration: float) -> IntArray:
    """Times of a motion [s] as whole nanoseconds, spaced by MIN_STEP at least.

    The last one is not before the end of the motion [s].
    """
    ticks = np.rint(times * BILLION).astype(np.int64)
    if ticks.size == 1:
        return ticks
    last = max(int(np.ceil(duration * BILLION - 1e-3)), MIN_STEP)
    spread = [0]
    for tick in ticks[1:-1].tolist():
        if tick - spread[-1] >= MIN_STEP and last - tick >= MIN_STEP:
            spread.append(tick)
    return np.array([*spread, last], dtype=np.int64)


def _message_data(samples: Samples) -> dict[str, Any]:
    """A JointTrajectory as plain values; its points come last."""
    data: dict[str, Any] = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(samples.joint_names),
        "points": [],
    }
    quantities = known_quantities(samples)
    for k, tick in enumerate(np.rint(samples.t * BILLION).tolist()):
        sec, nanosec = divmod(int(tick), BILLION)
        # An empty array means unknown values.
        point: dict[str, Any] = {
            name: getattr(samples, key)[k].tolist() if key in quantities else []
            for key, name in POINT_FIELDS.items()
        }
        time = {"sec": sec, "nanosec": nanosec}
        data["points"].append(point | {"time_from_start": time})
    return data


def _json(value: Any) -> str:
    """JSON with numbers that YAML 1.1, the version of ROS, also parses: 1.0e-05."""
    return re.sub(r"(?<![\d.])(\d+)e(?=[-+])", r"\1.0e", json.dumps(value))


def write_json(samples: Samples, file: BinaryIO, message: str = MESSAGE) -> None:
    """Write samples as a JSON message, one line per point."""
    data, keys = _message_data(samples), MESSAGES[message]
    lines = ",\n".join(map(_json, data.pop("points")))
    begin = "".join(f'{{"{key}": ' for key in keys) + json.dumps(data).removesuffix("}")
    end = "}" * (1 + len(keys))
    file.write(f'{begin}, "points": [\n{lines}\n]{end}\n'.encode())


def write_yaml(samples: Samples, file: BinaryIO, message: str = MESSAGE) -> None:
    """Write samples as a YAML message, one line per quantity of a point."""
    # JSON, which is YAML, except for its escapes in texts: PyYAML would take ten times
    # the time and the memory for the numbers.
    data = _message_data(samples)
    names = yaml.safe_dump(data["joint_names"], **QUOTED).strip()
    lines = [f"header: {_json(data['header'])}", f"joint_names: {names}", "points:"]
    for point in data["points"]:
        first, *others = (f"{name}: {_json(part)}" for name, part in point.items())
        lines += [f"- {first}", *(f"  {part}" for part in others)]
    for key in reversed(MESSAGES[message]):
        lines = [f"{key}:", *(f"  {line}" for line in lines)]
    file.write("\n".join([*lines, ""]).encode())


def parse_json(content: bytes, path: Path) -> Any:
    """Parse JSON.

    Raises:
        ScenarioError: If the content is not valid JSON, or repeats a key.
    """
    # Every value comes with a delimiter; millions of small values would fill the
    # memory.
    if sum(map(content.count, (b"[", b"{", b",", b":"))) > MAX_VALUES:
        raise ScenarioError(f"{path} holds more than {MAX_VALUES} values", path)
    try:
        return json.loads(content, object_pairs_hook=_table)
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{path} is not JSON: {error}", path) from error


def _table(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """A table of JSON, whose keys must differ."""
    table: dict[str, Any] = {}
    for key, value in pairs:
        if key in table:
            raise ValueError(f"the key {brief(key)} occurs twice")
        table[key] = value
    return table


def _find_trajectory(message: Field, *, mention: bool = True) -> Field:
    """JointTrajectory in a message: itself, or inside a goal or a RobotTrajectory.

    Args:
        message: The message.
        mention: Whether to warn of ignored keys next to it.

    Raises:
        ScenarioError: If the message moves joints of several degrees of freedom, or has
            more than one trajectory.
    """
    for wrapper in OUTER_KEYS:
        if message.get("points").value is not None or not message.get(wrapper).given:
            continue
        _check_siblings(message, wrapper, mention)
        message = message.get(wrapper)
        if isinstance(message.value, list):
            if len(message.value) != 1:
                message.fail(f"holds {len(message.value)} trajectories, expected one")
            message = next(iter(message.items()))
    return message


def _check_siblings(message: Field, wrapper: str, mention: bool) -> None:
    """Refuse other motions next to a trajectory, and warn of ignored keys."""
    for name, item in message.table().items():
        if name in MULTI_DOF_KEYS:
            if item.get("points").given or item.get("joint_names").given:
                item.fail("moves joints of several degrees of freedom: not supported")
        elif mention and name not in (wrapper, *IGNORED_KEYS) and item.is_filled_in:
            warn_caller(
                f"{message.path}: {item.key} is ignored: it is not part of the motion"
            )


def read_message(message: Field) -> Samples:
    """Read a JointTrajectory, also one inside a RobotTrajectory or an action goal.

    Velocities, accelerations and efforts are optional, for all points alike. Times may
    have the form of ROS 2, of ROS 1 (secs, nsecs), or be a single number [s].

    Returns:
        The samples, with a controller's interpolation; quantities that the message
        omits are NaN.

    Raises:
        ScenarioError: If it is not such a message; names the key.
    """
    message = _find_trajectory(message)
    names = tuple(item.text() for item in message.need("joint_names").items())
    points = list(message.need("points").items())
    message.only("header", "joint_names", "points")
    for point in points:
        point.only(*POINT_FIELDS.values(), "time_from_start")
    parts: dict[str, Array] = {}
    for key, name in POINT_FIELDS.items():
        fields = [point.get(name) for point in points]
        if key == "q" or any(item.given for item in fields):
            rows = [item.numbers(len(names)) for item in fields]
            parts[key] = np.array(rows).reshape(len(points), len(names))
    times = [_seconds(point.need("time_from_start")) for point in points]
    return filled_samples(names, np.array(times), parts, interpolation="controller")


def _seconds(value: Field) -> float:
    """Convert a Duration to seconds."""
    if not isinstance(value.value, dict):
        return value.number()
    old = "secs" in value.value or "nsecs" in value.value
    units = {"secs": BILLION, "nsecs": 1} if old else {"sec": BILLION, "nanosec": 1}
    value.only(*units)
    total = 0
    for name, item in value.table().items():
        if item.given:
            if type(item.value) is not int or abs(item.value) >= INT64_END:
                item.fail(f"is {brief(item.value)}, expected a whole number of 64 bits")
            total += item.value * units[name]
    return total / BILLION


TYPE = "trajectory_msgs/msg/JointTrajectory"
TOPIC = "/joint_trajectory_controller/joint_trajectory"
# Version of the metadata of bags, which Humble and later releases read.
VERSION = 8
# Limit of the unpacked size of all chunks of a bag [bytes].
MAX_UNPACKED = 2**28
# Layout of MCAP files: a magic number at both ends; records with a type and a size;
# chunks that begin with times, their size and the name of the compression.
MAGIC = b"\x89MCAP0\r\n"
RECORD, CHUNK, CHUNK_HEAD = 9, 6, 32


def _rosbags() -> Any:
    """The package rosbags, and its types for the messages of ROS 2."""
    with optional("rosbags", "ros", "reading and writing bags (.mcap)"):
        from rosbags import rosbag2
        from rosbags.typesys import Stores, get_typestore
    return rosbag2, get_typestore(Stores.ROS2_HUMBLE)


def write_bag(samples: Samples, file: BinaryIO, message: str = MESSAGE) -> None:
    """Write samples as a bag.

    Raises:
        ProblemError: If a topic of a controller does not take messages of this type.
        MissingDependency: If rosbags is not installed.
    """
    if message != MESSAGE:
        expected = f"{MESSAGE} in bags (.mcap), as topics carry it, or .yaml or .json"
        raise wrong(message, "message", expected)
    rosbag2, types = _rosbags()
    plugin = rosbag2.StoragePlugin.MCAP
    with tempfile.TemporaryDirectory(prefix="tominpmp-") as folder:
        path = Path(folder) / "motion"
        with rosbag2.Writer(path, version=VERSION, storage_plugin=plugin) as writer:
            connection = writer.add_connection(TOPIC, TYPE, typestore=types)
            content = types.serialize_cdr(_typed(samples, types.types), TYPE)
            writer.write(connection, 0, content)
        file.write((path / "motion.mcap").read_bytes())


def _typed(samples: Samples, types: dict[str, Any]) -> Any:
    """A message as an object of rosbags, whose constructors check the fields."""
    names = ("Time", "Duration")
    time, duration = (types[f"builtin_interfaces/msg/{name}"] for name in names)
    point = types["trajectory_msgs/msg/JointTrajectoryPoint"]
    data = _message_data(samples)
    points = [
        point(*map(np.array, rows), duration(**since))
        for *rows, since in (item.values() for item in data["points"])
    ]
    header = types["std_msgs/msg/Header"](time(0, 0), "")
    return types[TYPE](header, data["joint_names"], points)


def parse_bag(content: bytes, path: Path) -> dict[str, Any]:
    """Read the only JointTrajectory of a bag, as plain values.

    Raises:
        ScenarioError: If it is not a bag, or the number of these messages is not one.
        MissingDependency: If rosbags is not installed.
    """
    rosbag2, types = _rosbags()
    with tempfile.TemporaryDirectory(prefix="tominpmp-") as folder:
        copy = Path(folder) / "motion.mcap"
        copy.write_bytes(content)
        try:
            _check_size(content)
            with rosbag2.Reader(copy) as reader:
                found = [item for item in reader.connections if item.msgtype == TYPE]
                # Given no connections, the reader would return all messages.
                rows = [item[2] for item in reader.messages(found)] if found else []
            held = [types.deserialize_cdr(row, TYPE) for row in rows[:2]]
        except Exception as error:  # a damaged bag may raise anything
            why = " ".join(str(error).replace(str(copy), str(path)).split())[:300]
            raise ScenarioError(f"{path} is not an MCAP bag: {why}", path) from error
    if len(held) != 1:
        fault = f"holds {len(rows)} messages {TYPE}, expected one"
        Field(None, path, "points").fail(fault)
    return asdict(held[0], dict_factory=_plain)


def _check_size(content: bytes) -> None:
    """Check that the unpacked chunks of a bag fit into memory.

    A small chunk may unpack to any number of zeros, and the reader unpacks whole
    chunks.

    Raises:
        ValueError: If they are too large, or a record is truncated.
    """
    left, at = MAX_UNPACKED, len(MAGIC)
    while at < len(content) - len(MAGIC):
        kind, size = struct.unpack_from("<BQ", content, at)
        at += RECORD
        if size > len(content) - at:
            raise ValueError("a record goes beyond the end of the file")
        if kind == CHUNK:
            _, _, stated, _, name = struct.unpack_from("<QQQII", content, at)
            begin = at + CHUNK_HEAD + name
            codec = content[at + CHUNK_HEAD : begin].decode()
            data = content[begin + 8 : at + size]
            if codec:
                stated = len(_decompressor(codec).decompress(data, max_length=left + 1))
            left -= stated
        if left < 0:
            raise ValueError(f"it unpacks to more than {MAX_UNPACKED} bytes")
        at += size


def _decompressor(codec: str) -> Any:
    """Incremental decompressor of a chunk, from the packages that rosbags needs."""
    if codec == "lz4":
        return import_module("lz4.frame").LZ4FrameDecompressor()
    if codec != "zstd":
        raise ValueError(f"its compression {codec[:20]!r} is not known")
    home = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
    return import_module(home).ZstdDecompressor()


def _plain(items: list[tuple[str, Any]]) -> dict[str, Any]:
    """Fields of a message of rosbags as YAML would represent them."""
    # The name of the message type appears among the fields.
    named = ((name, value) for name, value in items if name != "__msgtype__")
    return {k: x.tolist() if isinstance(x, np.ndarray) else x for k, x in named}


# Final velocity that counts as rest [rad/s or m/s]: rounding of single precision.
REST = float(np.finfo(np.float32).eps)
# Limit of the seconds of a Duration, which have 32 bits.
MAX_SECONDS = 2**31
TOLERANCES = (
    "path_tolerance",
    "goal_tolerance",
    "component_path_tolerance",
    "component_goal_tolerance",
)


#: Values of the fields of a point in POINT_FIELDS; empty lists for missing fields.
Rows: TypeAlias = Mapping[str, Any]


@dataclass(frozen=True)
class Refusal:
    """A violated rule of the joint trajectory controller.

    Attributes:
        reason: The fault, in a clause.
        field: Field of the message or point.
        point: Index of the point, from 0; None if the whole message is at fault.
        joint: The joint, if the fault concerns a single joint.
    """

    reason: str
    field: str
    point: int | None = None
    joint: str | None = None

    def __str__(self) -> str:
        """Name the place and the fault."""
        where = "" if self.point is None else f"points[{self.point}]."
        where += self.field
        if self.joint is not None:
            where += f", joint {shortened(self.joint)}"
        return f"{where}: {self.reason}"


def controller_refusals(
    message: object,
    joint_names: Sequence[str] | None = None,
    *,
    effort_interface: bool = False,
    moving_end: bool = False,
    partial: bool = False,
) -> tuple[Refusal, ...]:
    """Check a message against the rules of the joint trajectory controller.

    Args:
        message: A JointTrajectory, or a goal of FollowJointTrajectory or a
            RobotTrajectory that contains one, as plain values read from YAML or JSON.
        joint_names: Joints of the controller; None takes the joints of the message.
        effort_interface: Whether the controller commands efforts; otherwise it refuses
            them, as all controllers before ROS 2 Jazzy do.
        moving_end: Whether its ``allow_nonzero_velocity_at_trajectory_end`` is set.
        partial: Whether its ``allow_partial_joints_goal`` is set.

    Returns:
        The violated rules, with the field, point and joint at fault; empty for a
        message that the controller accepts and follows.

    Raises:
        ProblemError: If the message is not a table of fields, or a name is not a text.
        ScenarioError: If it contains no trajectory, or moves more than joints.
    """
    if not isinstance(message, Mapping):
        raise wrong(message, "message", "a table of fields")
    if joint_names is not None:
        joints_named(joint_names)
    outer = dict(message)
    field = Field(outer, Path("the message"))
    trajectory = _find_trajectory(field, mention=False).value
    if not isinstance(trajectory, Mapping):
        raise ProblemError("the message holds no JointTrajectory", "message")
    names, points = trajectory.get("joint_names"), trajectory.get("points")
    named = isinstance(names, list) and all(isinstance(name, str) for name in names)
    if not named or not names:
        return (Refusal(f"are {brief(names)}, expected names", "joint_names"),)
    if not isinstance(points, list) or not points:
        return (Refusal("there are no points", "points"),)
    points = [point if isinstance(point, Mapping) else {} for point in points]
    rows = [{k: _values(point, k) for k in POINT_FIELDS.values()} for point in points]
    return (
        *_joints(names, joint_names, partial),
        *_goal(outer, names),
        *_stamp(trajectory.get("header")),
        *_times(points),
        *_numbers(rows, names, effort_interface),
        *_uniform(rows),
        *(() if moving_end else _end(rows[-1]["velocities"], names, len(rows) - 1)),
    )


def _joints(
    names: list[str], known: Sequence[str] | None, partial: bool
) -> Iterator[Refusal]:
    """Rule: the names are the joints of the controller, each once, and all of them."""
    for index, name in enumerate(names):
        if not name:
            yield Refusal("is empty", "joint_names")
        if name in names[:index]:
            yield Refusal("is named twice", "joint_names", joint=name)
        if known is not None and name not in known:
            reason = "is not a joint of the controller"
            yield Refusal(reason, "joint_names", joint=name)
    for name in () if known is None or partial else known:
        if name not in names:
            reason = "is missing: the controller expects all of its joints"
            yield Refusal(reason, "joint_names", joint=name)


def _times(points: Sequence[Mapping[str, Any]]) -> Iterator[Refusal]:
    """Rule: times are whole nanoseconds, increasing, and not before the start."""
    before = -1
    for index, point in enumerate(points):
        now = _ticks(point.get("time_from_start"))
        if now is None:
            reason = "is not a time: expected sec and nanosec, whole numbers"
        elif now < 0:
            reason = "lies before the start"
        elif now <= before:
            last = f"{before / BILLION:.9f} s of the point before"
            reason = f"is {now / BILLION:.9f} s, not after the {last}"
        else:
            before = now
            continue
        yield Refusal(reason, "time_from_start", index)


def _numbers(
    points: Sequence[Rows], names: list[str], effort_interface: bool
) -> Iterator[Refusal]:
    """Rule: arrays contain one finite number for each joint, or are empty."""
    for index, point in enumerate(points):
        for field, row in point.items():
            if not isinstance(row, list | tuple):
                yield Refusal("is not a list of numbers", field, index)
            elif len(row) != len(names) and (row or field == "positions"):
                reason = f"holds {len(row)} numbers for {len(names)} joints"
                yield Refusal(reason, field, index)
            else:
                for name, value in zip(names, row, strict=False):
                    if not _is_finite(value):
                        reason = f"is {brief(value)}, expected a finite number"
                        yield Refusal(reason, field, index, name)
        if point["effort"] and not effort_interface:
            reason = "is refused by controllers that do not command efforts"
            yield Refusal(reason, "effort", index)
            effort_interface = True  # one refusal stands for all points


def _uniform(points: Sequence[Rows]) -> Iterator[Refusal]:
    """Rule: all points set the same fields, else a controller interpolates linearly."""
    first = points[0]
    for index, point in enumerate(points):
        for field, row in point.items():
            if bool(row) != bool(first[field]):
                has = "has them, the first point has not"
                lacks = "is empty, that of the first point is not"
                yield Refusal(has if row else lacks, field, index)
                return
    if first["accelerations"] and not first["velocities"]:
        yield Refusal("is not followed without velocities", "accelerations", 0)


def _end(row: Any, names: list[str], last: int) -> Iterator[Refusal]:
    """Rule: the motion ends at rest: the velocities of its last point are zero."""
    # What is not a list breaks another rule.
    listed = row if isinstance(row, list | tuple) else ()
    for name, value in zip(names, listed, strict=False):
        if _is_finite(value) and abs(value) > REST:
            reason = f"is {value:.3g} at the end, expected 0"
            yield Refusal(reason, "velocities", last, name)


def _values(point: Mapping[str, Any], field: str) -> Any:
    """Numbers of a field of a point; empty without the field."""
    row = point.get(field)
    if isinstance(row, np.ndarray):
        row = row.tolist()
    return [] if row is None else row


def _is_finite(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and abs(value) <= sys.float_info.max


def _ticks(time: Any) -> int | None:
    """Time since the start [ns]; None if it is not a valid Duration."""
    if not isinstance(time, Mapping) or not set(time) <= {"sec", "nanosec"}:
        return None
    sec, nanosec = time.get("sec", 0), time.get("nanosec", 0)
    whole = all(type(part) is int for part in (sec, nanosec))
    if not whole or not (-MAX_SECONDS <= sec < MAX_SECONDS and 0 <= nanosec < BILLION):
        return None
    return int(sec) * BILLION + int(nanosec)


def _stamp(header: Any) -> Iterator[Refusal]:
    """Rule: the start time is zero, as a motion in a file begins when it is sent."""
    stamp = header.get("stamp") if isinstance(header, Mapping) else None
    if isinstance(stamp, Mapping) and any(stamp.values()):
        reason = "is not zero: the motion would have to be sent before that time"
        yield Refusal(reason, "header.stamp")


def _goal(outer: dict[str, Any], names: list[str]) -> Iterator[Refusal]:
    """Rule: tolerances of a goal belong to its joints."""
    inner = outer.get("goal")
    goal = inner if isinstance(inner, Mapping) else outer
    for field in TOLERANCES:
        items = goal.get(field) or []
        for item in items if isinstance(items, list) else [items]:
            table = item if isinstance(item, Mapping) else {}
            name = table.get("name", table.get("joint_name"))
            if name not in names:
                reason = f"is for {brief(name)}, which is not a joint of the message"
                yield Refusal(reason, field)
    wait = goal.get("goal_time_tolerance")
    seconds = wait.get("sec") if isinstance(wait, Mapping) else None
    # -1 s means an unlimited time.
    if isinstance(seconds, int | float) and seconds < -1:
        yield Refusal("is negative", "goal_time_tolerance")
