"""Reading semantic robot descriptions (SRDF): what a URDF cannot say."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.etree.ElementTree import Element

from tominpmp.arrays import record_line
from tominpmp.description.groups import JointGroups, read_groups
from tominpmp.description.paths import checked_path
from tominpmp.description.tree import UrdfDescription
from tominpmp.description.xml_reader import XmlContext, parse_xml, read_xml
from tominpmp.exceptions import RobotLoadError, warn_caller

# Elements that are read, and those that do not touch a motion: hands and tools, spheres
# for other collision checkers, metrics of samplers, footprints.
READ = (
    "disable_collisions",
    "disable_default_collisions",
    "enable_collisions",
    "group",
    "group_state",
    "passive_joint",
    "rotor_params",
    "virtual_joint",
)
WITHOUT_EFFECT = (
    "end_effector",
    "gripper",
    "joint_property",
    "link_sphere_approximation",
    "specificities",
)
# The reason for which MoveIt disables pairs that it has not seen to touch, and the one
# of pairs that a file disables for a link as a whole.
NEVER, WHOLE_LINK = "Never", "disable_default_collisions"


@dataclass(frozen=True)
class SemanticDescription:
    """What an SRDF file says about a robot.

    Attributes:
        disabled_pairs: Pairs of links whose collision is not to be checked, each pair
            in alphabetical order and none twice.
        group_states: Joint positions [rad or m] by joint name, by the name of the
            state; states of several groups that share a name are one.
        path: The file.
        groups: Groups of joints that are planned together.
        rotor_inertias: Inertia of the rotor, seen at the joint [kg m^2], by joint name.
        never_touch: Those of the disabled pairs that are said, or have to be taken, to
            be apart at all configurations: with the reason "Never", or without one
            where two joints or more are between the links.
    """

    disabled_pairs: tuple[tuple[str, str], ...]
    group_states: Mapping[str, Mapping[str, float]] = field(hash=False)
    path: Path
    groups: JointGroups = field(default_factory=JointGroups)
    rotor_inertias: Mapping[str, float] = field(default_factory=dict, hash=False)
    never_touch: tuple[tuple[str, str], ...] = ()

    def __repr__(self) -> str:
        """What it holds, on one line."""
        return record_line(self)

    def __post_init__(self) -> None:
        """Make the mappings read-only."""
        frozen = {k: MappingProxyType(dict(v)) for k, v in self.group_states.items()}
        object.__setattr__(self, "group_states", MappingProxyType(frozen))
        rotors = MappingProxyType(dict(self.rotor_inertias))
        object.__setattr__(self, "rotor_inertias", rotors)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the read-only mappings as plain ones."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        values["group_states"] = {k: dict(v) for k, v in self.group_states.items()}
        values["rotor_inertias"] = dict(self.rotor_inertias)
        return type(self), tuple(values.values())


def read_srdf(
    path: Path, description: UrdfDescription, text: bytes | None = None
) -> SemanticDescription:
    """Read an SRDF file, or a text with its name.

    Entries about links and joints that the robot lacks are left out, for one SRDF file
    often serves several variants of a robot.

    Raises:
        RobotLoadError: If the file is no SRDF file, or speaks of none of the links
            that it names.
    """
    root = read_xml(path) if text is None else parse_xml(text, path)
    context = XmlContext(path)
    if root.tag != "robot":
        context.fail(f"is no SRDF file: its root is <{root.tag}>, expected <robot>")
    unread = {element.tag for element in root} - {*READ, *WITHOUT_EFFECT}
    if unread:
        names = ", ".join(f"<{str(tag)[:80]}>" for tag in sorted(unread, key=str)[:10])
        warn_caller(f"{path}: not read: {names}")
    joints = [joint.name for joint in description.joints]
    disabled = _disabled_pairs(root, context, description.links)
    return SemanticDescription(
        tuple(disabled),
        _group_states(root, context, joints),
        path,
        read_groups(root, path, description),
        _rotor_inertias(root, context),
        tuple(
            pair
            for pair, reason in disabled.items()
            if reason == NEVER or (not reason and _far_apart(description, *pair))
        ),
    )


def _far_apart(description: UrdfDescription, one: str, other: str) -> bool:
    """Whether more than one joint can move two links against each other."""
    between = description.joints_between(one, other)
    moving = (j for j in description.joints if j.kind != "fixed" and j.name in between)
    return sum(1 for _ in moving) > 1


def _disabled_pairs(
    root: Element, context: XmlContext, links: Collection[str]
) -> dict[tuple[str, str], str]:
    """Why the collision of pairs of links is not to be checked.

    Each pair is in alphabetical order; the reason is empty where the file has none.
    """
    known, strangers = set(links), set()
    pairs: dict[tuple[str, str], str] = {}
    for element in root.iter("disable_default_collisions"):
        one = context.text(element, "link", element.tag)
        if one in known:
            pairs |= {
                _ordered(one, other): WHOLE_LINK for other in links if other != one
            }
        else:
            strangers.add(one)
    for element in root.iter("enable_collisions"):
        ends = (context.text(element, f"link{i}", element.tag) for i in (1, 2))
        pairs.pop(_ordered(*ends), None)
    for element in root.iter("disable_collisions"):
        one, other = (context.text(element, f"link{i}", element.tag) for i in (1, 2))
        if one in known and other in known:
            pairs[_ordered(one, other)] = element.get("reason", "").strip()
        else:
            strangers |= {one, other} - known
    if strangers and not pairs:
        raise RobotLoadError(
            f"{context.path} belongs to another robot: it names the links "
            f"{', '.join(sorted(strangers)[:10])}, the robot has {', '.join(links)}",
            context.path,
        )
    return pairs


def _ordered(one: str, other: str) -> tuple[str, str]:
    return min(one, other), max(one, other)


def _group_states(
    root: Element, context: XmlContext, joints: Collection[str]
) -> dict[str, dict[str, float]]:
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
    return states


def _rotor_inertias(root: Element, context: XmlContext) -> dict[str, float]:
    """Inertia of rotors times the square of the gear ratio, as Pinocchio reads them."""
    found = {}
    for table in root.iter("rotor_params"):
        for joint in table.iter("joint"):
            name = context.text(joint, "name", "rotor_params")
            inertia = context.number(joint, "mass", "rotor_params", low=0.0)
            ratio = context.number(joint, "gear_ratio", "rotor_params")
            found[name] = inertia * ratio**2
    return found


def read_semantics(
    path: str | os.PathLike[str] | None, description: UrdfDescription
) -> SemanticDescription | None:
    """Read the SRDF file, or the text of one, that belongs to a description.

    Raises:
        RobotLoadError: As :func:`read_srdf`.
    """
    if path is None:
        return None
    if isinstance(path, str) and path.lstrip().startswith("<"):
        text = path.lstrip().encode("utf-8", "replace")
        return read_srdf(Path("<text of an SRDF file>"), description, text)
    file = checked_path(path, "srdf", RobotLoadError).absolute()
    return read_srdf(file, description)
