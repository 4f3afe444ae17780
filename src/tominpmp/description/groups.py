"""Groups of an SRDF file: which joints are planned together."""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias
from xml.etree.ElementTree import Element

from tominpmp.description.tree import JointDescription, UrdfDescription
from tominpmp.description.xml_reader import XmlContext
from tominpmp.exceptions import OptionsError, brief, warn_caller

# Group states, by their usual names, that say where joints rest.
RESTING = ("default", "neutral", "home", "half_sitting")


@dataclass(frozen=True)
class JointGroup:
    """A group of joints.

    Attributes:
        joints: Its joints that can move, in the order of the URDF file.
        unknown: Joints, links and groups in it that the robot lacks.
        moves_base: Whether it holds a virtual joint that is not fixed.
    """

    joints: tuple[str, ...]
    unknown: tuple[str, ...] = ()
    moves_base: bool = False


@dataclass(frozen=True)
class JointGroups:
    """The groups of an SRDF file, and what it says of their joints.

    Attributes:
        robot: Name of the robot in the file.
        groups: The groups by name.
        passive: Joints that the file calls passive.
    """

    robot: str = ""
    groups: Mapping[str, JointGroup] = field(default_factory=dict, hash=False)
    passive: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Make the mapping read-only."""
        object.__setattr__(self, "groups", MappingProxyType(dict(self.groups)))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the read-only mapping as a plain one."""
        return type(self), (self.robot, dict(self.groups), self.passive)

    def find(self, name: str) -> str | None:
        """Name in the file of a group; None if there is none.

        Where no group has the very name, one is taken that is meant without doubt:
        "panda_arm" is "arm" of the robot "panda", "left_arm" is "l_arm".
        """
        if name in self.groups:
            return name
        wanted = self._plain(name)
        alike = [group for group in self.groups if self._plain(group) == wanted]
        return alike[0] if len(alike) == 1 else None

    def _plain(self, name: str) -> str:
        words = [word for word in re.split(r"[\W_]+", name.lower()) if word]
        if len(words) > 1 and words[0] == self.robot.lower():
            words = words[1:]
        return " ".join({"left": "l", "right": "r"}.get(w, w) for w in words)


def read_groups(root: Element, path: Path, description: UrdfDescription) -> JointGroups:
    """Read the groups of an SRDF file.

    Args:
        root: The root element of the file.
        path: The file, for messages.
        description: The robot.

    Raises:
        RobotLoadError: If a group lacks its name or holds itself.
    """
    return _Reader(root, XmlContext(path), description).read()


class _Reader:
    """Joints of groups that may hold joints, links, chains and other groups."""

    def __init__(
        self, root: Element, context: XmlContext, description: UrdfDescription
    ) -> None:
        self.root, self.context = root, context
        self.description, self.links = description, set(description.links)
        self.order = [joint.name for joint in description.joints]
        self.carrying = {joint.child: joint.name for joint in description.tree}
        self.known = set(self.carrying.values())
        self.virtual = {
            joint.get("name", ""): joint.get("type", "fixed")
            for joint in root.findall("virtual_joint")
        }
        self.elements = {
            self.context.text(group, "name", "group"): group
            for group in root.findall("group")
        }

    def read(self) -> JointGroups:
        return JointGroups(
            self.root.get("name", ""),
            {name: self._group(name) for name in self.elements},
            tuple(
                self.context.text(joint, "name", "passive_joint")
                for joint in self.root.findall("passive_joint")
            ),
        )

    def _group(self, name: str) -> JointGroup:
        found, unknown = self._members(name, ())
        moves_base = any(self.virtual.get(k, "fixed") != "fixed" for k in found)
        joints = tuple(joint for joint in self.order if joint in found)
        return JointGroup(joints, tuple(dict.fromkeys(unknown)), moves_base)

    def _members(self, name: str, above: tuple[str, ...]) -> tuple[set[str], list[str]]:
        """Joints of any kind in a group, and what the robot lacks."""
        if name in above:
            self.context.fail(f"the group {name!r} holds itself")
        where = f"group {name}"
        found: set[str] = set()
        unknown: list[str] = []
        for element in self.elements[name]:
            if element.tag == "joint":
                joint = self._known(self.context.text(element, "name", where))
                found.add(joint)
                if joint not in {*self.known, *self.virtual}:
                    unknown.append(joint)
            elif element.tag == "link":
                link = self.context.text(element, "name", where)
                if link not in self.links:
                    unknown.append(link)
                found |= {self.carrying[link]} if link in self.carrying else set()
            elif element.tag == "chain":
                base, tip = (
                    self.context.text(element, f"{end}_link", where)
                    for end in ("base", "tip")
                )
                unknown += [link for link in (base, tip) if link not in self.links]
                if {base, tip} <= self.links:
                    found |= self.description.joints_between(base, tip)
            elif element.tag == "group":
                inner = self.context.text(element, "name", where)
                if inner not in self.elements:
                    unknown.append(inner)
                    continue
                members, lacking = self._members(inner, (*above, name))
                found |= members
                unknown += lacking
        return found, unknown

    def _known(self, joint: str) -> str:
        """A joint; some files put the name of the robot before it."""
        short = joint.rpartition("/")[2]
        return short if joint not in self.known and short in self.known else joint


#: Name of a group, names of joints, or the first and the last link of a chain.
Group: TypeAlias = "str | Sequence[str]"


def group_locks(
    groups: JointGroups,
    states: Mapping[str, Mapping[str, float]],
    description: UrdfDescription,
    group: Group,
    locked: Mapping[str, float],
) -> dict[str, float]:
    """Find where the joints outside a group are locked.

    Args:
        groups: The groups.
        states: Group states of the SRDF file, which say where joints rest.
        description: The robot.
        group: Name of the group; of a link, for the chain from the base to it; names of
            joints, or of the links before and at the end of a chain.
        locked: Positions of joints that the caller locks [rad or m].

    Returns:
        Positions by name of those, and of all joints outside the group: where a group
        state has them, else at zero or the limit nearest to it.

    Raises:
        OptionsError: If there is no such group, or it has no joint.
    """
    found = _asked_for(groups, description, group)
    joints = description.joints
    outside = [j for j in joints if j.name not in found.joints and not j.mimic]
    resting = {joint.name: rest_position(joint, states) for joint in outside}
    return resting | dict(locked)


def _asked_for(
    groups: JointGroups, description: UrdfDescription, group: Group
) -> JointGroup:
    """The group of a name, or one made of the joints that are meant."""
    name = groups.find(group) if isinstance(group, str) else None
    if name is not None:
        found = groups.groups[name]
        if not found.joints:
            raise OptionsError(
                f"group: the group {name!r} has no joint that the robot has", "group"
            )
        warn_of_group(name, found)
        return found
    own = _without_name(description, group)
    if own is None:
        raise OptionsError(_no_group(groups, group), "group")
    if not own.joints:
        raise OptionsError(f"group: no joint moves {brief(group)}", "group")
    return own


def _without_name(description: UrdfDescription, group: object) -> JointGroup | None:
    """Joints that are named, or of a chain of links; None if neither."""
    order = [joint.name for joint in description.joints]
    links = set(description.links)
    inside: set[str] | None = None
    names: list[Any] = []
    if isinstance(group, str):
        inside = description.joints_above(group) if group in links else None
    elif isinstance(group, Sequence | set | frozenset):
        names = [item for item in group if isinstance(item, str)]
        if len(names) == len(group) and names and {*names} <= {*order}:
            inside = set(names)
        elif len(names) == len(group) == 2 and {*names} <= links:
            inside = description.joints_between(*names)
    if inside is None:
        return None
    return JointGroup(tuple(joint for joint in order if joint in inside))


def _no_group(groups: JointGroups, group: object) -> str:
    known = f"; the robot has: {', '.join(groups.groups)}"
    if not groups.groups:
        known = ": the robot has no SRDF file with groups; give one with srdf="
    close: list[str] = []
    if isinstance(group, str):
        close = difflib.get_close_matches(group, list(groups.groups), n=2)
    hint = f"; did you mean {' or '.join(close)}?" if close else ""
    return (
        f"group: there is no group {brief(group)}{hint}{known}; or give the name of "
        "the last link of a chain, two links (base, tip), or names of joints"
    )


def warn_of_group(name: str, found: JointGroup) -> None:
    """Warn of what a group has and the robot has not."""
    told = []
    if found.unknown:
        told.append(f"names {', '.join(found.unknown)}, which the robot lacks")
    if found.moves_base:
        told.append("moves the base, which is planned for as standing still")
    if told:
        warn_caller(f"the group {name!r} {' and '.join(told)}")


def rest_position(
    joint: JointDescription, states: Mapping[str, Mapping[str, float]]
) -> float:
    """Where a joint rests that is not to move: in a state of a usual name first."""
    for state in dict.fromkeys((*RESTING, *states)):
        if joint.name in states.get(state, {}):
            return states[state][joint.name]
    if not joint.lower < joint.upper:
        return 0.0
    return min(max(0.0, joint.lower), joint.upper)


def warn_of_passive(passive: Collection[str], motors: Collection[str]) -> None:
    """Warn of joints that the SRDF file calls passive, and the URDF file drives."""
    driven = [joint for joint in passive if joint in motors]
    if driven:
        example = "{" + repr(driven[0]) + ": 0}"
        warn_caller(
            f"the SRDF file calls {', '.join(driven)} passive, but motors drive them "
            f"here: lock them, or give effort={example}"
        )
