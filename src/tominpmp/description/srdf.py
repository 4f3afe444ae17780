"""Reading semantic robot descriptions (SRDF): what a URDF cannot say."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tominpmp.arrays import record_line
from tominpmp.description.urdf import UrdfDescription
from tominpmp.description.xml_reader import XmlContext, read_xml
from tominpmp.exceptions import RobotLoadError


@dataclass(frozen=True)
class SemanticDescription:
    """What an SRDF file says about a robot.

    Attributes:
        disabled_pairs: Pairs of links whose collision is not to be checked, each pair
            in alphabetical order and none twice.
        group_states: Joint positions [rad or m] by joint name, by the name of the
            state; states of several groups that share a name are one.
        path: The file.
    """

    disabled_pairs: tuple[tuple[str, str], ...]
    group_states: Mapping[str, Mapping[str, float]] = field(hash=False)
    path: Path

    def __repr__(self) -> str:
        """What it holds, on one line."""
        return record_line(self)

    def __post_init__(self) -> None:
        """Make the mappings read-only."""
        frozen = {k: MappingProxyType(dict(v)) for k, v in self.group_states.items()}
        object.__setattr__(self, "group_states", MappingProxyType(frozen))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the read-only mappings as plain ones."""
        states = {name: dict(state) for name, state in self.group_states.items()}
        return type(self), (self.disabled_pairs, states, self.path)


def read_srdf(
    path: Path, links: Collection[str], joints: Collection[str]
) -> SemanticDescription:
    """Read an SRDF file.

    Entries about links and joints that the robot lacks are left out, for one SRDF file
    often serves several variants of a robot.

    Args:
        path: The file.
        links: Names of the robot's links.
        joints: Names of the robot's joints.

    Returns:
        The description.

    Raises:
        RobotLoadError: If the file is no SRDF file, or speaks of none of the links
            that it names.
    """
    root = read_xml(path)
    context = XmlContext(path)
    if root.tag != "robot":
        context.fail(f"is no SRDF file: its root is <{root.tag}>, expected <robot>")
    pairs: dict[tuple[str, str], None] = {}
    strangers = set()
    for element in root.iter("disable_collisions"):
        one = context.text(element, "link1", "disable_collisions")
        other = context.text(element, "link2", "disable_collisions")
        if one in links and other in links:
            pairs[(min(one, other), max(one, other))] = None
        else:
            strangers |= {one, other} - set(links)
    if strangers and not pairs:
        raise RobotLoadError(
            f"{path} belongs to another robot: it names the links "
            f"{', '.join(sorted(strangers)[:10])}, the robot has {', '.join(links)}",
            path,
        )
    states: dict[str, dict[str, float]] = {}
    for element in root.iter("group_state"):
        name = context.text(element, "name", "group_state")
        state = states.setdefault(name, {})
        for joint in element.iter("joint"):
            where = f"group_state {name}"
            joint_name = context.text(joint, "name", where)
            # A floating joint has seven values, and is none of ours.
            if joint_name in joints:
                context.text(joint, "value", where)
                state[joint_name] = context.number(joint, "value", where)
    return SemanticDescription(tuple(pairs), states, path)


def read_semantics(
    path: str | os.PathLike[str] | None, description: UrdfDescription
) -> SemanticDescription | None:
    """Read the SRDF file that belongs to a description, if there is one.

    Raises:
        RobotLoadError: As :func:`read_srdf`.
    """
    if path is None:
        return None
    joints = [joint.name for joint in description.joints]
    return read_srdf(Path(path).expanduser().absolute(), description.links, joints)
