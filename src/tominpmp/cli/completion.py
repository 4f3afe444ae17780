"""What a shell completes: robots, and the names that a robot's files have.

A shell asks while one types, so that the files are only looked through for names:
what a robot is loaded for takes too long, and complains of what is not finished yet.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

from tominpmp.cli.usage import TYPED

# Endings of files that a robot or a problem is read from.
ENDINGS = (".urdf", ".toml")
# Joints that can be given a position.
MOVING = ("revolute", "continuous", "prismatic")
# Larger files are not looked through while one types [bytes].
MOST_BYTES = 4_000_000


def robots(incomplete: str) -> list[str]:
    """Names of robots, and files and folders, that begin so."""
    from tominpmp.description.files import robot_names

    return [*_beginning(robot_names(), incomplete), *_files(incomplete, ENDINGS)]


def _files(incomplete: str, endings: tuple[str, ...]) -> list[str]:
    """Files with such an ending, and folders, that begin so."""
    folder, _, _ = incomplete.rpartition("/")
    try:
        inside = sorted(
            Path(folder or ("/" if incomplete[:1] == "/" else ".")).iterdir()
        )
    except OSError:
        return []
    start = f"{folder}/" if "/" in incomplete else ""
    names = [
        f"{start}{path.name}/" if path.is_dir() else f"{start}{path.name}"
        for path in inside
        if path.is_dir() or path.suffix in endings
    ]
    return _beginning((n for n in names if not n.startswith(".")), incomplete)


def frames(ctx: Any, incomplete: str) -> list[str]:
    """Frames of the robot that was named: its links and joints."""
    found = [e.get("name", "") for e in _elements(ctx, "urdf", "link", "joint")]
    return _beginning(found, incomplete)


def joints(ctx: Any, incomplete: str) -> list[str]:
    """Moving joints of the robot that was named, as ``JOINT=``."""
    found = [
        f"{element.get('name', '')}="
        for element in _elements(ctx, "urdf", "joint")
        if element.get("type") in MOVING
    ]
    return _beginning(found, incomplete)


def groups(ctx: Any, incomplete: str) -> list[str]:
    """Groups of the SRDF file of the robot that was named."""
    found = [e.get("name", "") for e in _elements(ctx, "srdf", "group")]
    return _beginning(found, incomplete)


def positions(ctx: Any, incomplete: str) -> list[str]:
    """Group states of the robot that was named, and its joints."""
    states = [e.get("name", "") for e in _elements(ctx, "srdf", "group_state")]
    return [*_beginning(dict.fromkeys(states), incomplete), *joints(ctx, incomplete)]


def words(*choices: str) -> Callable[[str], list[str]]:
    """What completes one of a few words."""

    def complete(incomplete: str) -> list[str]:
        return _beginning(choices, incomplete)

    return complete


def _beginning(names: Any, incomplete: str) -> list[str]:
    return [name for name in names if name and name.startswith(incomplete)]


def _elements(ctx: Any, kind: str, *tags: str) -> Iterator[Element]:
    """Elements of a file of the robot that was named, those at the top of it."""
    from tominpmp.description.files import find_robot
    from tominpmp.description.xml_reader import read_xml
    from tominpmp.exceptions import TominpmpError

    robot = _robot(ctx)
    given = ctx.params.get("srdf") if kind == "srdf" else None
    try:
        path = Path(given) if given else getattr(find_robot(robot), kind)
        if path is None or path.stat().st_size > MOST_BYTES:
            return
        root = read_xml(path)
    except (TominpmpError, OSError, ParseError):
        return
    for tag in tags:
        yield from root.findall(tag)


def _robot(ctx: Any) -> Any:
    """The robot that was named, also where nothing could be parsed yet."""
    named = ctx.params.get("robot") or ctx.params.get("problem")
    typed = getattr(ctx, "meta", {}).get(TYPED, ())
    return named or next((word for word in typed if not word.startswith("-")), "")


#: What completes the values of options, by the name of the option.
COMPLETIONS: dict[str, Callable[..., list[str]]] = {
    "group": groups,
    "limits": words("datasheet"),
    "lock": joints,
    "start": positions,
    "goal": positions,
    "goal_position": frames,
    "goal_pose": frames,
    "interpolation": words("auto", "controller", "linear", "cubic", "quintic"),
    "ros_message": words("JointTrajectory", "FollowJointTrajectory", "RobotTrajectory"),
    "robot": robots,
}
