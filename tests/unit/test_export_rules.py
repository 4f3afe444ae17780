"""Rules of the joint trajectory controller for messages, and MCAP bags."""

from __future__ import annotations

import copy
import itertools
import json
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from motion_samples import END, START, speed_up_and_brake

from tominpmp.exceptions import MissingDependency, ProblemError, ScenarioError
from tominpmp.files.export import export, load_motion, read_motion
from tominpmp.files.ros import TOPIC, TYPE, controller_refusals
from tominpmp.motion.trajectory import Trajectory
from tominpmp.robot.robot import Robot

NAMES = ["joint1", "joint2", "joint3"]

# The definitions of ROS: rosbags knows the messages, but not those of actions.
GOAL_TYPES = {
    "control_msgs/msg/JointTolerance": """
        string name
        float64 position
        float64 velocity
        float64 acceleration
    """,
    "control_msgs/msg/JointComponentTolerance": """
        string joint_name
        uint16 component
        float64 position
        float64 velocity
        float64 acceleration
    """,
    "control_msgs/msg/FollowJointTrajectory_Goal": """
        trajectory_msgs/JointTrajectory trajectory
        trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
        control_msgs/JointTolerance[] path_tolerance
        control_msgs/JointComponentTolerance[] component_path_tolerance
        control_msgs/JointTolerance[] goal_tolerance
        control_msgs/JointComponentTolerance[] component_goal_tolerance
        builtin_interfaces/Duration goal_time_tolerance
    """,
}


@pytest.fixture
def motion(planar3r: Robot) -> Trajectory:
    return speed_up_and_brake(planar3r, START, END, 0.95, 12)


def valid_message(motion: Trajectory, folder: Path, **options: Any) -> dict[str, Any]:
    path = export(motion, folder / "message.json", **options)
    message: dict[str, Any] = read_motion(path)[1]
    return message


@pytest.mark.parametrize("ending", ["yaml", "json", "mcap"])
@pytest.mark.parametrize("dt", [None, 0.001, 0.004, 0.3])
def test_exported_message_is_accepted_by_the_controller(
    motion: Trajectory, ending: str, dt: float | None, tmp_path: Path
) -> None:
    path = export(motion, tmp_path / f"m.{ending}", dt=dt)
    assert controller_refusals(read_motion(path)[1], NAMES) == ()


@pytest.mark.parametrize("message", ["FollowJointTrajectory", "RobotTrajectory"])
def test_exported_action_goal_is_accepted_by_the_controller(
    motion: Trajectory, message: str, tmp_path: Path
) -> None:
    path = export(motion, tmp_path / "m.yaml", message=message)
    assert controller_refusals(read_motion(path)[1], NAMES) == ()


def test_effort_is_refused_without_an_effort_interface(
    motion: Trajectory, tmp_path: Path
) -> None:
    message = valid_message(motion, tmp_path, with_effort=True)
    (found,) = controller_refusals(message, NAMES)
    assert (found.field, found.point) == ("effort", 0)
    assert str(found).startswith("points[0].effort: is refused by controllers that do")
    assert controller_refusals(message, NAMES, effort_interface=True) == ()


def test_violations_after_a_refused_effort_are_named(
    motion: Trajectory, tmp_path: Path
) -> None:
    """Regression: the numbers of later points were not checked."""
    message = valid_message(motion, tmp_path, with_effort=True)
    message["points"][3]["positions"][1] = None
    named = [(item.field, item.point) for item in controller_refusals(message, NAMES)]
    assert named == [("effort", 0), ("positions", 3)]


def test_moving_end_is_refused_unless_allowed(
    motion: Trajectory, tmp_path: Path
) -> None:
    message = valid_message(motion, tmp_path)
    message["points"][-1]["velocities"][1] = 2e-7
    (found,) = controller_refusals(message)
    assert (found.field, found.point, found.joint) == ("velocities", 12, "joint2")
    assert "2e-07 at the end, expected 0" in str(found)
    assert controller_refusals(message, moving_end=True) == ()
    message["points"][-1]["velocities"][1] = 1e-7  # rounding of single precision
    assert controller_refusals(message) == ()


Change = Callable[[dict[str, Any]], object]


def at(point: int, field: str, value: object) -> Change:
    return lambda message: message["points"][point].update({field: value})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m.update(joint_names=[]), "joint_names: are [], expected names"),
        (lambda m: m.update(points=[]), "points: there are no points"),
        (
            lambda m: m.update(joint_names=["joint1", "joint2", "joint1"]),
            "joint_names, joint joint1: is named twice",
        ),
        (
            lambda m: m.update(joint_names=["joint1", "joint2", "elbow"]),
            "joint elbow: is not a joint of the controller",
        ),
        (
            lambda m: m["header"]["stamp"].update(sec=5),
            "header.stamp: is not zero",
        ),
        (at(3, "positions", [0.0, 1.0]), "points[3].positions: holds 2 numbers for 3"),
        (at(3, "positions", []), "points[3].positions: holds 0 numbers for 3 joints"),
        (at(4, "velocities", [0.0]), "points[4].velocities: holds 1 numbers for 3"),
        (at(4, "velocities", []), "points[4].velocities: is empty, that of the first"),
        (at(4, "accelerations", [0.0] * 3), "points[4].accelerations: has them, the"),
        (at(4, "velocities", "fast"), "points[4].velocities: is not a list of numbers"),
        (
            at(2, "positions", [0.0, float("nan"), 0.0]),
            "points[2].positions, joint joint2: is nan, expected a finite number",
        ),
        (
            at(2, "positions", [0.0, 0.0, True]),
            "points[2].positions, joint joint3: is True, expected a finite number",
        ),
        (
            at(2, "velocities", [10**400, 0.0, 0.0]),
            "points[2].velocities, joint joint1: is ",
        ),
        (
            at(5, "time_from_start", {"sec": 0, "nanosec": 0}),
            "points[5].time_from_start: is 0.000000000 s, not after the 0.316666667 s",
        ),
        (
            at(0, "time_from_start", {"sec": -1, "nanosec": 0}),
            "points[0].time_from_start: lies before the start",
        ),
        (
            at(5, "time_from_start", {"sec": 0, "nanosec": 10**9}),
            "points[5].time_from_start: is not a time",
        ),
        (at(5, "time_from_start", 0.5), "points[5].time_from_start: is not a time"),
        (
            at(5, "time_from_start", {"secs": 0, "nsecs": 1}),
            "points[5].time_from_start: is not a time",
        ),
        (
            at(5, "time_from_start", {"sec": 2**31, "nanosec": 0}),
            "points[5].time_from_start: is not a time",
        ),
    ],
)
def test_invalid_message_is_refused_with_its_field(
    change: Change, words: str, motion: Trajectory, tmp_path: Path
) -> None:
    message = valid_message(motion, tmp_path)
    broken = copy.deepcopy(message)
    change(broken)
    assert controller_refusals(message, NAMES) == ()
    found = controller_refusals(broken, NAMES)
    assert any(words in str(item) for item in found), list(map(str, found))


def test_missing_joint_is_refused_unless_partial_goals_are_allowed(
    motion: Trajectory, tmp_path: Path
) -> None:
    message = valid_message(motion, tmp_path)
    (found,) = controller_refusals(message, [*NAMES, "gripper"])
    assert found.joint == "gripper"
    assert controller_refusals(message, [*NAMES, "gripper"], partial=True) == ()


def test_accelerations_without_velocities_are_refused() -> None:
    points = [
        {
            "positions": [0.0],
            "accelerations": [0.0],
            "time_from_start": {"sec": k, "nanosec": 0},
        }
        for k in range(2)
    ]
    (found,) = controller_refusals({"joint_names": ["a"], "points": points})
    assert str(found) == "points[0].accelerations: is not followed without velocities"


def test_tolerance_of_an_unknown_joint_is_refused(
    motion: Trajectory, tmp_path: Path
) -> None:
    goal = valid_message(motion, tmp_path, message="FollowJointTrajectory")
    goal["path_tolerance"] = [{"name": "joint1", "position": 0.1}]
    assert controller_refusals(goal) == ()
    goal["goal_tolerance"] = [{"name": "elbow", "position": 0.1}]
    (found,) = controller_refusals({"goal": goal})
    assert found.field == "goal_tolerance"
    assert "'elbow'" in str(found)
    goal["goal_tolerance"] = []
    goal["goal_time_tolerance"] = {"sec": -5, "nanosec": 0}
    (found,) = controller_refusals(goal)
    assert found.field == "goal_time_tolerance"


@pytest.mark.parametrize("message", [None, 5, "m.yaml", [], [{}]])
def test_controller_refusals_reject_an_argument_without_fields(message: object) -> None:
    with pytest.raises(ProblemError, match="expected a table of fields"):
        controller_refusals(message)


@pytest.mark.parametrize("names", [5, "joint1", [None], {"joint1": 1}])
def test_controller_refusals_reject_an_invalid_list_of_names(
    names: Any, motion: Trajectory, tmp_path: Path
) -> None:
    with pytest.raises(ProblemError, match="expected names of joints"):
        controller_refusals(valid_message(motion, tmp_path), names)


def test_values_of_any_type_are_refused_without_an_error(
    motion: Trajectory, tmp_path: Path
) -> None:
    """Arrays are accepted; values of other types are refused, and raise no error."""
    message = valid_message(motion, tmp_path)
    for point in message["points"]:
        for key in ("positions", "velocities"):
            point[key] = np.array(point[key])
    assert controller_refusals(message, NAMES) == ()
    values: list[Any] = [5, "x", None, [], [5], [None], {"a": 1}, [{}], [[1.0]], True]
    for key in ("header", "joint_names", "points"):
        for value in values:
            found = controller_refusals(message | {key: value}, NAMES)
            assert found or key == "header", (key, value)
    for key in ("positions", "velocities", "time_from_start"):
        for place, value in itertools.product((2, -1), values):
            broken = copy.deepcopy(message)
            broken["points"][place][key] = value
            assert controller_refusals(broken, NAMES), (key, value)


# The definitions of ROS


def typestore() -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in GOAL_TYPES.items():
        lines = "\n".join(line.strip() for line in text.splitlines())
        store.register(get_types_from_msg(lines, name))
    return store


def filled(store: Any, name: str, data: dict[str, Any]) -> Any:
    """A message of plain values, made like ROS's tools make it: unknown keys fail."""
    fields = dict(store.fielddefs[name][1])
    assert set(data) <= set(fields), f"{name} has no {set(data) - set(fields)}"
    parts = {key: part(store, kind, data.get(key)) for key, kind in fields.items()}
    return store.types[name](**parts)


def part(store: Any, kind: Any, value: Any) -> Any:
    from rosbags.typesys.store import Nodetype

    node, detail = kind
    if node == Nodetype.NAME:
        return filled(store, detail, value or {})
    if node == Nodetype.BASE:
        return value if value is not None else ("" if detail[0] == "string" else 0)
    inner = detail[0]
    items = value or []
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        return np.array(items, dtype=inner[1][0])
    return [part(store, inner, item) for item in items]


@pytest.mark.parametrize("ending", ["yaml", "json"])
@pytest.mark.parametrize(
    ("message", "name"),
    [
        ("JointTrajectory", TYPE),
        ("FollowJointTrajectory", "control_msgs/msg/FollowJointTrajectory_Goal"),
    ],
)
def test_message_files_match_the_definitions_of_ros(
    motion: Trajectory, ending: str, message: str, name: str, tmp_path: Path
) -> None:
    path = export(motion, tmp_path / f"m.{ending}", message=message, with_effort=True)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    store = typestore()
    typed = filled(store, name, data)
    content = store.serialize_cdr(typed, name)
    back = store.deserialize_cdr(content, name)
    trajectory = getattr(back, "trajectory", back)
    assert trajectory.joint_names == NAMES
    for k, point in enumerate(trajectory.points):
        np.testing.assert_array_equal(point.positions, load_motion(path).q[k])
        assert point.effort.size == 3


def test_bag_has_one_message_on_the_topic_of_the_controller(
    motion: Trajectory, tmp_path: Path
) -> None:
    from rosbags.rosbag2 import Reader

    path = export(motion, tmp_path / "m.mcap", with_effort=True)
    with Reader(path) as reader:
        (connection,) = reader.connections
        assert (connection.topic, connection.msgtype) == (TOPIC, TYPE)
        assert reader.message_count == 1
    json_file = export(motion, tmp_path / "m.json", with_effort=True)
    assert read_motion(path)[1] == json.loads(json_file.read_text())


def test_damaged_bag_is_an_error_with_its_path(
    motion: Trajectory, tmp_path: Path
) -> None:
    path = export(motion, tmp_path / "m.mcap")
    whole = path.read_bytes()
    for content in (b"", b"nonsense", whole[: len(whole) // 2], whole[::-1]):
        path.write_bytes(content)
        with pytest.raises(ScenarioError, match=r"m\.mcap is not an MCAP") as caught:
            load_motion(path)
        assert "/tominpmp-" not in str(caught.value)  # the path of the file, not a copy


def test_bag_without_a_joint_trajectory_is_an_error(tmp_path: Path) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = typestore()
    name = "std_msgs/msg/String"
    folder = tmp_path / "bag"
    with Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/chatter", name, typestore=store)
        text = store.types[name](data="hello")
        writer.write(connection, 0, store.serialize_cdr(text, name))
    with pytest.raises(ScenarioError, match="holds 0 messages"):
        load_motion(folder / "bag.mcap")


@pytest.mark.parametrize("codec", ["zstd", "lz4"])
def test_bag_that_expands_to_too_many_bytes_is_an_error(
    codec: str,
    monkeypatch: pytest.MonkeyPatch,
    motion: Trajectory,
    tmp_path: Path,
) -> None:
    """The size that a chunk states need not be its true size."""
    content = b"\0" * 2**24
    packed = pack(codec, content)
    assert len(packed) < 2**17
    path = tmp_path / "m.mcap"
    path.write_bytes(bag_of(chunk(packed, 100, codec)))
    with pytest.raises(ScenarioError, match="is not an MCAP bag") as caught:
        load_motion(path)
    assert "unpacks" not in str(caught.value)  # this size is allowed
    monkeypatch.setattr("tominpmp.files.ros.MAX_UNPACKED", 2**20)
    with pytest.raises(ScenarioError, match="unpacks to more than 1048576 bytes"):
        load_motion(path)
    path.write_bytes(bag_of(chunk(b"", 2**50, "")))
    with pytest.raises(ScenarioError, match="unpacks to more than 1048576 bytes"):
        load_motion(path)
    # The bag of an export is read.
    assert load_motion(export(motion, path)).t.size == 13


def pack(codec: str, content: bytes) -> bytes:
    if codec == "lz4":
        import lz4.frame

        return bytes(lz4.frame.compress(content))
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return bytes(zstd.compress(content))


def chunk(packed: bytes, stated: int, codec: str) -> bytes:
    name = codec.encode()
    head = struct.pack("<QQQII", 0, 0, stated, 0, len(name)) + name
    body = head + struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", 6, len(body)) + body


def bag_of(*records: bytes) -> bytes:
    mark = b"\x89MCAP0\r\n"
    return mark + b"".join(records) + mark


def test_compressed_bag_is_read(motion: Trajectory, tmp_path: Path) -> None:
    from rosbags.rosbag2 import (
        CompressionFormat,
        CompressionMode,
        Reader,
        StoragePlugin,
        Writer,
    )

    store = typestore()
    with Reader(export(motion, tmp_path / "m.mcap")) as reader:
        ((_, _, content),) = reader.messages()
    folder = tmp_path / "packed"
    writer = Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(TOPIC, TYPE, typestore=store)
        writer.write(connection, 0, content)
    samples = load_motion(folder / "packed.mcap")
    np.testing.assert_array_equal(samples.q, load_motion(tmp_path / "m.mcap").q)


def test_missing_rosbags_package_is_named_in_the_error(
    motion: Trajectory, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(MissingDependency, match=r"tominpmp\[ros\]"):
        export(motion, tmp_path / "m.mcap")
    assert list(tmp_path.iterdir()) == []
