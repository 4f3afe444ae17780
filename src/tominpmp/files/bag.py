"""Motions as bags of ROS 2: an MCAP file with one message ``JointTrajectory``.

Played with ``ros2 bag play``, the message goes to the topic that a joint trajectory
controller listens to. The file stands for itself; no folder around it is needed.
"""

from __future__ import annotations

import struct
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tominpmp.exceptions import ProblemError, ScenarioError, optional
from tominpmp.files.ros import MESSAGE, POINT_FIELDS, message_data
from tominpmp.motion.samples import Samples

TYPE = "trajectory_msgs/msg/JointTrajectory"
TOPIC = "/joint_trajectory_controller/joint_trajectory"
# Version 8 of the metadata is what Humble and its successors read.
VERSION = 8
# Bytes that the chunks of a bag may unpack to.
MAX_UNPACKED = 2**28
# How MCAP files are laid out: a mark at both ends; records of a kind and a size; chunks
# that begin with times, their size and the name of the packing.
MAGIC = b"\x89MCAP0\r\n"
RECORD, CHUNK, CHUNK_HEAD = 9, 6, 32


def _rosbags() -> Any:
    """The package, and its types of the messages of ROS 2."""
    with optional("rosbags", "ros", "reading and writing bags (.mcap)"):
        from rosbags import rosbag2
        from rosbags.typesys import Stores, get_typestore
    return rosbag2, get_typestore(Stores.ROS2_HUMBLE)


def write_bag(samples: Samples, file: BinaryIO, message: str = MESSAGE) -> None:
    """Write samples as a bag.

    Raises:
        ProblemError: If the message is none that goes over a topic to a controller.
        MissingDependency: If rosbags is not installed.
    """
    if message != MESSAGE:
        raise ProblemError(
            f"bags (.mcap) hold a JointTrajectory, which a topic carries, not "
            f"{message}: write that as .yaml or .json",
            "message",
        )
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
    """A message as rosbags has it, whose constructors check the fields."""
    duration = types["builtin_interfaces/msg/Duration"]
    point = types["trajectory_msgs/msg/JointTrajectoryPoint"]
    data = message_data(samples)
    points = [
        point(
            **{
                name: duration(**value) if isinstance(value, dict) else np.array(value)
                for name, value in item.items()
            }
        )
        for item in data["points"]
    ]
    time = types["builtin_interfaces/msg/Time"](**data["header"]["stamp"])
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="")
    return types[TYPE](header, data["joint_names"], points)


def parse_bag(content: bytes, path: Path) -> dict[str, Any]:
    """The only JointTrajectory of a bag, as plain values.

    Raises:
        ScenarioError: If it is no bag, or does not hold one such message.
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
                # Without a connection the reader would give all messages.
                rows = [item[2] for item in reader.messages(found)] if found else []
            held = [types.deserialize_cdr(row, TYPE) for row in rows[:2]]
        except Exception as error:  # a damaged bag may raise anything
            why = " ".join(str(error).split())[:300]
            raise ScenarioError(f"{path} is no MCAP bag: {why}", path) from error
    if len(held) != 1:
        raise ScenarioError(
            f"{path} holds {len(rows)} messages {TYPE}, expected one",
            path,
            "points",
        )
    return _plain(held[0])


def _check_size(content: bytes) -> None:
    """Check that the chunks of a bag unpack to no more than memory can hold.

    A small chunk may hold any number of zeros, and the reader unpacks it as a whole.

    Raises:
        ValueError: If they do not, or end before they should.
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
            packing = content[at + CHUNK_HEAD : begin].decode()
            packed = content[begin + 8 : at + size]
            if packing:
                stated = len(_unpacker(packing).decompress(packed, max_length=left + 1))
            left -= stated
        if left < 0:
            raise ValueError(f"it unpacks to more than {MAX_UNPACKED} bytes")
        at += size


def _unpacker(packing: str) -> Any:
    """What unpacks a chunk piece by piece, from the packages that rosbags needs."""
    if packing == "lz4":
        return import_module("lz4.frame").LZ4FrameDecompressor()
    if packing != "zstd":
        raise ValueError(f"its compression {packing[:20]!r} is not known")
    home = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
    return import_module(home).ZstdDecompressor()


def _plain(message: Any) -> dict[str, Any]:
    """A message of rosbags as YAML would have it."""
    points = [
        {name: getattr(point, name).tolist() for name in POINT_FIELDS.values()}
        | {"time_from_start": _time(point.time_from_start)}
        for point in message.points
    ]
    header = message.header
    return {
        "header": {"stamp": _time(header.stamp), "frame_id": header.frame_id},
        "joint_names": list(message.joint_names),
        "points": points,
    }


def _time(value: Any) -> dict[str, int]:
    """A time or a duration of rosbags as YAML would have it."""
    return {"sec": value.sec, "nanosec": value.nanosec}
