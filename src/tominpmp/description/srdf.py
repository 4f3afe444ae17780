"""Semantic robot descriptions (SRDF): data that a URDF cannot contain.

They are the link pairs that are not checked for collision, the rest positions of
joints, and the groups of joints that are planned together.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias
from xml.etree.ElementTree import Element

from tominpmp.arrays import Record
from tominpmp.description.paths import checked_path
from tominpmp.description.tree import UNREAD, JointDescription, UrdfDescription, warn_of
from tominpmp.description.xacro_files import Arguments, expanded_root
from tominpmp.description.xml_reader import XmlContext, add, given_text, xml_text
from tominpmp.exceptions import (
    OptionsError,
    RobotLoadError,
    brief,
    shortened,
    unknown,
    warn_caller,
)

# Usual names of group states with rest positions, in the order of preference.
REST_STATES = ("default", "neutral", "home", "half_sitting")
# Elements that are read, and those without effect on a motion.
KNOWN = {
    "disable_collisions",
    "disable_default_collisions",
    "enable_collisions",
    "group",
    "group_state",
    "passive_joint",
    "rotor_params",
    "virtual_joint",
    # Hands and tools, metrics of samplers, spheres for other collision checkers,
    # footprints.
    "end_effector",
    "gripper",
    "joint_property",
    "link_sphere_approximation",
    "specificities",
}
# Reasons with which MoveIt disables pairs that never touched in its samples, and pairs
# that its user chose; and the reason of pairs that a file disables for a whole link.
NEVER, BY_USER, WHOLE_LINK = "Never", "User", "disable_default_collisions"

#: Names of two links, in alphabetical order.
Pair: TypeAlias = tuple[str, str]
#: Joint positions by joint name [rad or m].
Positions: TypeAlias = "Mapping[str, float]"
#: Name of a group or of the last link of a chain, names of joints, or the first and the
#: last link of a chain.
Group: TypeAlias = "str | Sequence[str]"


def _read_only(value: Any) -> Any:
    """Freeze a mapping, and mappings inside it; other values remain unchanged."""
    if not isinstance(value, Mapping):
        return value
    return MappingProxyType({key: _read_only(item) for key, item in value.items()})


@dataclass(frozen=True)
class JointGroup:
    """A group of joints.

    Attributes:
        joints: Its joints that can move, in the order of the URDF file.
        unknown: Joints, links and groups in it that the robot lacks.
        moves_base: Whether it contains a virtual joint that is not fixed.
    """

    joints: tuple[str, ...]
    unknown: tuple[str, ...] = ()
    moves_base: bool = False


@dataclass(frozen=True, eq=False)
class SemanticDescription(Record):
    """Content of an SRDF file of a robot.

    Attributes:
        disabled_pairs: Link pairs that are not checked for collision, each pair in
            alphabetical order and only once.
        states: Joint positions [rad or m] by joint name, by the names of the group and
            of the state; the group is empty for a state of the whole robot.
        path: The file.
        groups: Groups of joints that are planned together, by name.
        robot: Name of the robot in the file.
        passive: Joints that the file marks as passive.
        rotor_inertias: Inertia of the rotor, seen at the joint [kg m^2 or kg], by joint
            name.
        never_touch: Disabled pairs that are apart at all configurations, by their
            reason "Never", or by assumption if they have no reason and two or more
            joints between the links.
    """

    disabled_pairs: tuple[tuple[str, str], ...] = ()
    states: Mapping[tuple[str, str], Positions] = field(default_factory=dict)
    path: Path = Path()
    groups: Mapping[str, JointGroup] = field(default_factory=dict)
    robot: str = ""
    passive: tuple[str, ...] = ()
    rotor_inertias: Mapping[str, float] = field(default_factory=dict)
    never_touch: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        """Make the mappings read-only."""
        for name, value in vars(self).items():
            self._keep(**{name: _read_only(value)})

    def group_states(self, names: Collection[str]) -> dict[str, dict[str, float]]:
        """States by their names, for a robot that moves these joints.

        States of one name of several groups are merged. If they differ, the state of
        the smallest group with all these joints takes precedence, and then the last in
        the file.
        """

        def preference(key: tuple[str, str]) -> float:
            group = self.groups.get(key[0], JointGroup(()))
            fits = group.joints and {*names} <= {*group.joints}
            return 1.0 / len(group.joints) if fits else 0.0

        merged = {name: dict[str, float]() for _, name in self.states}
        for key in sorted(self.states, key=preference):
            merged[key[1]] |= self.states[key]
        return merged

    def joints_of(self, group: Group, description: UrdfDescription) -> Collection[str]:
        """Find the joints of a group.

        Args:
            group: Name of a group; of a link, for the chain from the base to it; names
                of joints, or of the base and tip links of a chain.
            description: Description of the robot.

        Raises:
            OptionsError: If the group is unknown, or has no joint.
        """
        name = self.find_group(group) if isinstance(group, str) else None
        moving = {joint.name for joint in description.joints}
        single = isinstance(group, str) or not isinstance(
            group, Sequence | set | frozenset
        )
        # A single link stands for the chain from the base to it.
        names: list[Any] = [description.root, group] if single else list(group)
        valid = all(isinstance(name, str) for name in names)
        joints: Collection[str]
        if name is not None:
            joints = self.groups[name].joints
            warn_of_group(name, self.groups[name])
        elif names and valid and not single and moving.issuperset(names):
            joints = names
        elif len(names) == 2 and valid and {*names} <= {*description.links}:
            joints = moving & description.joints_between(*names)
        else:
            fault = unknown("group", group, list(self.groups), "the robot has")
            raise OptionsError(
                f"group: {fault}; or give an SRDF file with groups as srdf, the name "
                "of the last link of a chain, two links (base, tip), or names of "
                "joints",
                "group",
            )
        if not joints:
            raise OptionsError(f"group: no joint moves {brief(group)}", "group")
        return joints

    def rest_positions(
        self, joints: Sequence[JointDescription], inside: Collection[str]
    ) -> dict[str, float]:
        """Rest positions [rad or m] of the joints outside a group, by joint name.

        They are those of the group states, else zero or the limit nearest to it; joints
        that follow others have none.

        Args:
            joints: Joints of the robot.
            inside: Names of the joints in the group.
        """
        rest = {
            j.name: min(max(0.0, j.lower), j.upper) if j.lower < j.upper else 0.0
            for j in joints
        }
        states = self.group_states(rest)
        for state in reversed(dict.fromkeys((*REST_STATES, *states))):
            rest |= states.get(state, {})
        outside = (j for j in joints if j.name not in inside and not j.mimic)
        return {joint.name: rest[joint.name] for joint in outside}

    def find_group(self, name: str) -> str | None:
        """Name of a group in the file; None without a match.

        If no group has exactly this name, an unambiguous variant is accepted:
        "panda_arm" matches "arm" of the robot "panda", "left_arm" matches "l_arm".
        """
        if name in self.groups:
            return name
        words = self._words(name)
        alike = [group for group in self.groups if self._words(group) == words]
        return alike[0] if len(alike) == 1 else None

    def _words(self, name: str) -> list[str]:
        """Words of a name, without the name of the robot."""
        words = [word for word in re.split(r"[\W_]+", name.lower()) if word]
        if len(words) > 1 and words[0] == self.robot.lower():
            words = words[1:]
        return [{"left": "l", "right": "r"}.get(word, word) for word in words]


def read_srdf(
    source: str | os.PathLike[str],
    description: UrdfDescription,
    args: Arguments,
) -> SemanticDescription:
    """Read the SRDF file of a robot, from a path or a text.

    A xacro file is expanded with those arguments that it declares. Entries about links
    and joints that the robot lacks are dropped, as one SRDF file often serves several
    variants of a robot.

    Args:
        source: The path or the text.
        description: The robot.
        args: Values of arguments, of which the robot's own file may declare some.

    Raises:
        RobotLoadError: If the file is not an SRDF file, every link pair that it
            disables has a link that the robot lacks, an attribute is missing or wrong,
            or a group contains itself.
    """
    text = given_text(source)
    path = Path("<text of an SRDF file>")
    if text is None:
        path = checked_path(source, "srdf", RobotLoadError).absolute()
    root = expanded_root(path, description.package_dirs, text, args)
    context = XmlContext(path)
    if root.tag != "robot":
        context.fail(f"is not an SRDF file: its root is <{root.tag}>, not <robot>")
    unread = {f"<{shortened(child.tag)}>" for child in root if child.tag not in KNOWN}
    warn_of({UNREAD: sorted(unread)}, path)
    return _SrdfReader(root, context, description).read()


class _SrdfReader:
    """Reads an SRDF file; groups may contain joints, links, chains and other groups."""

    def __init__(
        self, root: Element, context: XmlContext, description: UrdfDescription
    ) -> None:
        self.root, self.context, self.description = root, context, description
        self.links = set(description.links)
        self.moving = [joint.name for joint in description.joints]
        self.carrying = {joint.child: joint.name for joint in description.tree}
        self.virtual = {
            joint.get("name", ""): joint.get("type", "fixed")
            for joint in root.findall("virtual_joint")
        }
        self.known = {*self.carrying.values(), *self.virtual}
        self.groups: dict[str, Element] = {}
        for group in root.findall("group"):
            name = context.text(group, "name", "group")
            if name in self.groups:
                warn_caller(f"{context.path}: of the groups {name!r} the last counts")
            self.groups[name] = group

    def read(self) -> SemanticDescription:
        text, disabled = self.context.text, self._disabled_pairs()
        never = (
            pair
            for pair, reason in disabled.items()
            if reason == NEVER or (not reason and self._far_apart(*pair))
        )
        passive = self.root.findall("passive_joint")
        return SemanticDescription(
            tuple(disabled),
            self._group_states(),
            self.context.path,
            self._groups(),
            self.root.get("name", ""),
            tuple(text(joint, "name", joint.tag) for joint in passive),
            self._rotor_inertias(),
            tuple(never),
        )

    def _far_apart(self, one: str, other: str) -> bool:
        """Whether more than one joint can move two links relative to each other."""
        between = self.description.joints_between(one, other)
        return len(between.intersection(self.moving)) > 1

    def _disabled_pairs(self) -> dict[Pair, str]:
        """Reasons for which link pairs are not checked for collision, by pair.

        The reason is empty if the file states no reason.
        """
        text, named = self.context.text, dict[Pair, str]()
        for element in self.root.iter("disable_default_collisions"):
            first = text(element, "link", element.tag)
            rest = (link for link in self.description.links if link != first)
            named |= {ordered_pair(first, second): WHOLE_LINK for second in rest}
        for tag in ("enable_collisions", "disable_collisions"):
            for element in self.root.iter(tag):
                first, second = (text(element, f"link{i}", tag) for i in (1, 2))
                pair = ordered_pair(first, second)
                if tag == "enable_collisions":
                    named.pop(pair, None)
                else:
                    named[pair] = element.get("reason", "").strip()
        lacking = set().union(*named) - self.links
        pairs = {k: why for k, why in named.items() if self.links.issuperset(k)}
        if lacking and not pairs:
            self.context.fail(
                "belongs to another robot: it names the links "
                f"{', '.join(sorted(lacking)[:10])}, the robot has "
                f"{', '.join(self.description.links)}"
            )
        return pairs

    def _group_states(self) -> dict[tuple[str, str], dict[str, float]]:
        context = self.context
        states: dict[tuple[str, str], dict[str, float]] = {}
        for element in self.root.iter("group_state"):
            name = context.text(element, "name", "group_state")
            key = element.get("group", ""), name
            where = f"group_state {name}"
            state = states.setdefault(key, {})
            for joint in element.iter("joint"):
                joint_name = context.text(joint, "name", where)
                # A floating joint has seven values, and cannot be planned for.
                if joint_name in self.moving:
                    of_joint = f"{where}, joint {joint_name}"
                    context.text(joint, "value", of_joint)
                    (state[joint_name],) = context.numbers(joint, "value", of_joint)
        return states

    def _rotor_inertias(self) -> dict[str, float]:
        """Inertia of rotors times the squared gear ratio, as in Pinocchio."""
        context, inertias = self.context, {}
        for joint in self.root.findall(".//rotor_params//joint"):
            name = context.text(joint, "name", "rotor_params")
            where = f"rotor_params, joint {name}"
            (inertia,) = context.numbers(joint, "mass", where, low=0.0)
            (ratio,) = context.numbers(joint, "gear_ratio", where)
            inertias[name] = inertia * ratio**2
        return inertias

    def _groups(self) -> dict[str, JointGroup]:
        """Groups by name; each is read once, after the groups in it."""
        inside = {
            name: [inner.get("name", "").strip() for inner in group.findall("group")]
            for name, group in self.groups.items()
        }
        read: dict[str, JointGroup] = {}
        try:
            for name in TopologicalSorter(inside).static_order():
                if name in self.groups:
                    read[name] = self._group(name, read)
        except CycleError as error:
            self.context.fail(f"the group {error.args[1][0]!r} holds itself")
        return {name: read[name] for name in self.groups}

    def _group(self, name: str, read: Mapping[str, JointGroup]) -> JointGroup:
        """A group, with the members of groups in it, which are read already."""
        text, where = self.context.text, f"group {name}"
        members, unknown, moves_base = set[str](), dict[str, None](), False
        for element in self.groups[name]:
            tag = element.tag
            if tag == "chain":
                ends = [text(element, f"{end}_link", where) for end in ("base", "tip")]
                lacking = [link for link in ends if link not in self.links]
                unknown |= dict.fromkeys(lacking)
                if not lacking:
                    members |= self.description.joints_between(*ends)
            elif tag in ("joint", "link", "group"):
                member = text(element, "name", where)
                if tag == "group" and member in self.groups:
                    inner = read[member]
                    members.update(inner.joints)
                    unknown |= dict.fromkeys(inner.unknown)
                    moves_base |= inner.moves_base
                elif tag == "link" and member in self.links:
                    if member in self.carrying:  # no joint carries the root link
                        members.add(self.carrying[member])
                elif tag == "joint" and self._short(member) in self.known:
                    members.add(self._short(member))
                else:
                    unknown[member] = None
        moves_base |= any(self.virtual.get(k, "fixed") != "fixed" for k in members)
        joints = tuple(joint for joint in self.moving if joint in members)
        return JointGroup(joints, tuple(unknown), moves_base)

    def _short(self, joint: str) -> str:
        """A joint name, without the prefix of the robot that some files add."""
        return joint if joint in self.known else joint.rpartition("/")[2]


def ordered_pair(one: str, other: str) -> Pair:
    """Names of two links in alphabetical order."""
    return min(one, other), max(one, other)


def warn_of_group(name: str, group: JointGroup) -> None:
    """Warn of members of a group that the robot lacks, and of moving bases."""
    faults = []
    if group.unknown:
        faults.append(f"names {', '.join(group.unknown)}, which the robot lacks")
    if group.moves_base:
        faults.append("moves the base, which is planned for as standing still")
    if faults:
        warn_caller(f"the group {name!r} {' and '.join(faults)}")


def warn_of_passive(passive: Collection[str], motors: Collection[str]) -> None:
    """Warn of joints that the SRDF file marks as passive and that have motors here."""
    driven = [joint for joint in passive if joint in motors]
    if driven:
        example = "{" + repr(driven[0]) + ": 0}"
        warn_caller(
            f"the SRDF file calls {', '.join(driven)} passive, but motors drive them "
            f"here: lock them, or give effort={example}"
        )


def srdf_file(
    semantics: SemanticDescription, name: str, without: Collection[str]
) -> bytes:
    """Write a semantic description as an SRDF file.

    Args:
        semantics: The description.
        name: Name of the robot.
        without: Links whose pairs are left out.
    """
    root = Element("robot", name=semantics.robot or name)
    for one, other in semantics.disabled_pairs:
        if not {one, other} & set(without):
            # Pairs of distant links without a reason would be taken for never touching.
            reason = NEVER if (one, other) in semantics.never_touch else BY_USER
            add(root, "disable_collisions", link1=one, link2=other, reason=reason)
    for group, members in semantics.groups.items():
        element = add(root, "group", name=group)
        for joint in (*members.joints, *members.unknown):
            add(element, "joint", name=joint)
        if members.moves_base:
            base = f"{group}_base"
            add(element, "joint", name=base)
            add(root, "virtual_joint", name=base, type="floating")
    for (group, state), positions in semantics.states.items():
        element = add(root, "group_state", name=state, group=group)
        for joint, value in positions.items():
            add(element, "joint", name=joint, value=value)
    for joint in semantics.passive:
        add(root, "passive_joint", name=joint)
    if semantics.rotor_inertias:
        rotors = add(root, "rotor_params")
        for joint, mass in semantics.rotor_inertias.items():
            add(rotors, "joint", name=joint, mass=mass, gear_ratio=1.0)
    return xml_text(root)
