"""What a shell completes: robots, and the names that a robot's files have.

A shell asks while one types, so that the files are only looked through for names:
what a robot is loaded for takes too long, and complains of what is not finished yet.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias
from xml.etree.ElementTree import Element, ParseError

from cyclopts import Parameter

if TYPE_CHECKING:
    from cyclopts.completion import CompletionContext

Completer: TypeAlias = "Callable[[CompletionContext], list[str]]"

# Endings of files that a robot or a problem is read from.
ENDINGS = (".urdf", ".toml")
# Joints that can be given a position.
MOVING = ("revolute", "continuous", "prismatic")
# Larger files are not looked through while one types [bytes].
MOST_BYTES = 4_000_000


def supported(**marks: Any) -> dict[str, Any]:
    """Those arguments of a ``Parameter`` that the installed Cyclopts knows.

    Version 4, which Python 3.10 has, completes only the names of options, and does not
    name their values in the line of the usage.
    """
    known = signature(Parameter).parameters
    return {name: value for name, value in marks.items() if name in known}


def robots(typed: CompletionContext) -> list[str]:
    """Names of robots, and files and folders, that begin so."""
    from tominpmp.description.files import robot_names

    return [*robot_names(), *_files(typed.incomplete)]


def _files(incomplete: str) -> list[str]:
    """Files that a robot or a problem is read from, and folders, that begin so."""
    folder, slash, _ = incomplete.rpartition("/")
    try:
        inside = sorted(Path(folder or slash or ".").iterdir())
    except OSError:
        return []
    start = f"{folder}{slash}"
    names = [
        f"{start}{path.name}/" if path.is_dir() else f"{start}{path.name}"
        for path in inside
        if path.name[0] != "." and (path.is_dir() or path.suffix in ENDINGS)
    ]
    return [name for name in names if name.startswith(incomplete)]


def frames(typed: CompletionContext) -> list[str]:
    """Frames of the robot that was named: its links and joints."""
    return [e.get("name", "") for e in _elements(typed, "urdf", "link", "joint")]


def joints(typed: CompletionContext) -> list[str]:
    """Moving joints of the robot that was named, as ``JOINT=``."""
    return [
        f"{element.get('name', '')}="
        for element in _elements(typed, "urdf", "joint")
        if element.get("type") in MOVING
    ]


def groups(typed: CompletionContext) -> list[str]:
    """Groups of the SRDF file of the robot that was named."""
    return [e.get("name", "") for e in _elements(typed, "srdf", "group")]


def positions(typed: CompletionContext) -> list[str]:
    """Group states of the robot that was named, and its joints."""
    states = [e.get("name", "") for e in _elements(typed, "srdf", "group_state")]
    return [*dict.fromkeys(states), *joints(typed)]


def words(*choices: str) -> Completer:
    """What completes one of a few words."""
    return lambda typed: list(choices)


def _elements(typed: CompletionContext, kind: str, *tags: str) -> Iterator[Element]:
    """Elements of a file of the robot that was named, those at the top of it."""
    from tominpmp.description.files import find_robot
    from tominpmp.description.xml_reader import read_xml
    from tominpmp.exceptions import TominpmpError

    given = _given(typed, "srdf") if kind == "srdf" else None
    robot = _given(typed, "robot") or _given(typed, "scenario")
    # With an option that lacks its values, no argument is told apart.
    robot = robot or next((w for w in sys.argv[3:] if not w.startswith("-")), "")
    try:
        path = Path(given) if given else getattr(find_robot(robot), kind)
        if path is None or path.stat().st_size > MOST_BYTES:
            return
        root = read_xml(path)
    except (TominpmpError, OSError, ParseError):
        return
    for tag in tags:
        yield from root.findall(tag)


def _given(typed: CompletionContext, name: str) -> str | None:
    """What was typed for an argument before."""
    found = typed.get(name)
    return None if found is None else found.raw


#: What completes the values of options, by the name of the option.
COMPLETIONS: dict[str, Completer] = {
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
