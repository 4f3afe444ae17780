"""Reading URDF files into a form that parses the same way everywhere.

The file is checked and written anew, with nothing but what kinematics, dynamics and
geometry need: parsers print about the remains of simulators, differ in how they take
missing attributes, and report any mistake as "no valid URDF". In the new text

- every mesh is an absolute path of a file that exists,
- a continuous joint is a revolute one, so that it is one angle,
- mimic joints are ordinary joints: who follows whom is said by
  :class:`JointDescription`, as are limits and damping.

Capsules may be given as ``<capsule radius="" length=""/>``, or as a cylinder named in
Pinocchio's extension ``<collision_checking><capsule name=""/></collision_checking>``;
the length is that of the straight part. ``<tominpmp gravity="x y z"/>`` in the robot
element gives a gravity [m/s^2] other than the usual one along -z.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

from tominpmp.arrays import record_line
from tominpmp.description.links import (
    copy_link,
    copy_origin,
    read_materials,
    write_numbers,
)
from tominpmp.description.urdf_keys import warn_of_unread
from tominpmp.description.xml_reader import XmlContext, read_xml
from tominpmp.exceptions import brief

# The parsers recurse into the tree; humanoids have some hundred links.
MAX_LINKS = 2000

_ENDS = ("parent", "child")


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: q = multiplier * q_leader + offset.

    Attributes:
        leader: Name of the joint that is followed.
        multiplier: Ratio of the two positions.
        offset: Position while the leader is at zero [rad or m].
    """

    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class JointDescription:
    """A joint that can move, as the URDF file has it; a limit not given is NaN.

    Attributes:
        name: Name.
        kind: ``"revolute"``, ``"continuous"`` or ``"prismatic"``.
        lower: Lower position limit [rad or m], infinite if continuous.
        upper: Upper position limit [rad or m].
        velocity: Velocity limit [rad/s or m/s].
        effort: Effort limit [N m or N].
        damping: Viscous friction [N m s/rad or N s/m].
        friction: Dry friction [N m or N].
        mimic: The joint that it follows, if it does.
        acceleration: Largest acceleration, or deceleration [rad/s^2 or m/s^2]; infinite
            if none is given.
        jerk: Largest jerk [rad/s^3 or m/s^3]; infinite if none is given.
    """

    name: str
    kind: str
    lower: float
    upper: float
    velocity: float
    effort: float
    damping: float
    friction: float
    mimic: Mimic | None
    acceleration: float = math.inf
    jerk: float = math.inf


@dataclass(frozen=True)
class UrdfDescription:
    """A URDF file, checked.

    Attributes:
        name: Name of the robot.
        xml: The description, written anew as the module says.
        links: Names of the links.
        joints: Joints that can move, in the order of the file.
        gravity: Gravity [m/s^2], if the file gives one.
        path: The file.
        package_dirs: Folders given for ``package://``.
        parts: Names of the robots that it was put together from; mostly none.
        attached: What was fixed to its links after it was read, in that order.
    """

    name: str
    xml: str
    links: tuple[str, ...]
    joints: tuple[JointDescription, ...]
    gravity: tuple[float, ...] | None
    path: Path
    package_dirs: tuple[Path, ...]
    parts: tuple[str, ...] = ()
    attached: tuple[Any, ...] = ()

    def __repr__(self) -> str:
        """What it holds, on one line."""
        return record_line(self)


def read_urdf(path: Path, package_dirs: Sequence[Path] = ()) -> UrdfDescription:
    """Read a URDF file.

    Args:
        path: The file.
        package_dirs: Folders in which to look for ``package://``.

    Returns:
        The description.

    Raises:
        RobotLoadError: If the file is no URDF file, contradicts itself, has a joint of
            several degrees of freedom, or refers to a mesh that is not there.
    """
    root = read_xml(path)
    context = XmlContext(path)
    _check_root(root, context)
    links = _by_name(root, "link", context)
    joints = _by_name(root, "joint", context)
    if not links:
        context.fail("is no URDF file: it has no <link>")
    if len(links) > MAX_LINKS:
        context.fail(f"has {len(links)} links, at most {MAX_LINKS} are read")
    _check_tree(links, joints, context)
    warn_of_unread(root, links, joints, context)

    name = root.get("name", "").strip() or path.stem
    clean = Element("robot", name=name)
    materials = read_materials(root)
    for link_name, link in links.items():
        copy_link(link_name, link, clean, context, materials, package_dirs)
    for joint_name, joint in joints.items():
        _copy_joint(joint_name, joint, clean, context)
    moving = tuple(
        _describe_joint(joint_name, joint, context)
        for joint_name, joint in joints.items()
        if joint.get("type") != "fixed"
    )
    for described in moving:
        mimic = described.mimic
        if mimic is not None and mimic.leader not in joints:
            context.fail(
                f"joint {described.name} follows {brief(mimic.leader)}, which is no "
                "joint"
            )
    return UrdfDescription(
        name=name,
        xml=tostring(clean, encoding="unicode"),
        links=tuple(links),
        joints=moving,
        gravity=_read_gravity(root, context),
        path=path,
        package_dirs=tuple(package_dirs),
    )


def _check_root(root: Element, context: XmlContext) -> None:
    """Refuse other kinds of XML files, saying what they seem to be."""
    if root.tag != "robot":
        context.fail(f"is no URDF file: its root is <{root.tag}>, expected <robot>")
    for element in root.iter():
        if element.tag.startswith("xacro:"):
            context.fail(
                f"is a xacro file (it has <{element.tag}>); expand it first: "
                "xacro FILE > robot.urdf"
            )


def _by_name(root: Element, tag: str, context: XmlContext) -> dict[str, Element]:
    """Collect the links or the joints, whose names must differ."""
    elements: dict[str, Element] = {}
    for element in root.findall(tag):
        # Joints of a <transmission> or <gazebo> are not children of the root.
        name = context.text(element, "name", f"{tag} number {len(elements) + 1}")
        if name in elements:
            context.fail(f"there are two {tag}s named {brief(name)}")
        elements[name] = element
    return elements


def _read_gravity(root: Element, context: XmlContext) -> tuple[float, ...] | None:
    element = root.find("tominpmp")
    if element is None or "gravity" not in element.attrib:
        return None
    return context.numbers(element, "gravity", "robot", (0.0, 0.0, 0.0))


def _check_tree(
    links: Mapping[str, Element], joints: Mapping[str, Element], context: XmlContext
) -> None:
    """Check that the joints make one tree of the links."""
    children: dict[str, list[str]] = {name: [] for name in links}
    parent_joint: dict[str, str] = {}
    for name, joint in joints.items():
        parent, child = (_end_link(name, joint, end, context) for end in _ENDS)
        for end, link in zip(_ENDS, (parent, child), strict=True):
            if link not in links:
                context.fail(
                    f"joint {name}: its {end} link {brief(link)} does not exist"
                )
        if child in parent_joint:
            context.fail(
                f"link {child} is the child of two joints, {parent_joint[child]} and "
                f"{name}: closed loops are not supported"
            )
        parent_joint[child] = name
        children[parent].append(child)
    roots = [name for name in links if name not in parent_joint]
    if len(roots) > 1:
        context.fail(
            f"has {len(roots)} links without a parent joint, expected one: "
            f"{', '.join(roots[:10])}"
        )
    reached, front = set(), list(roots)
    while front:
        link = front.pop()
        reached.add(link)
        front += children[link]
    rest = [name for name in links if name not in reached]
    if rest:
        context.fail(f"the links {', '.join(rest[:10])} form a loop without a base")


def _end_link(name: str, joint: Element, end: str, context: XmlContext) -> str:
    """Name of the parent or the child link of a joint."""
    element = joint.find(end)
    if element is None:
        context.fail(f"joint {name} lacks <{end}>")
    return context.text(element, "link", f"joint {name}")


def _copy_joint(name: str, joint: Element, clean: Element, context: XmlContext) -> None:
    """Copy a joint; its limits are placeholders, for the parsers demand some."""
    kind = context.text(joint, "type", f"joint {name}")
    if kind in ("floating", "planar"):
        context.fail(
            f"joint {name} is {kind}; only revolute, continuous, prismatic and fixed "
            "joints can be planned for"
        )
    if kind not in ("revolute", "continuous", "prismatic", "fixed"):
        context.fail(f"joint {name} has the unknown type {brief(kind)}")
    new = SubElement(
        clean, "joint", name=name, type="revolute" if kind == "continuous" else kind
    )
    where = f"joint {name}"
    copy_origin(where, joint, new, context)
    for end in _ENDS:
        SubElement(new, end, link=_end_link(name, joint, end, context))
    if kind == "fixed":
        return
    axis = context.numbers(joint.find("axis"), "xyz", where, (1.0, 0.0, 0.0))
    norm = math.hypot(*axis)
    if norm < 1e-6:
        context.fail(f"{where}: the axis {axis} has no direction")
    write_numbers(SubElement(new, "axis"), "xyz", [x / norm for x in axis])
    SubElement(new, "limit", lower="-1", upper="1", effort="1", velocity="1")


def _describe_joint(name: str, joint: Element, context: XmlContext) -> JointDescription:
    """Read limits, friction and leader of a joint that can move."""
    where = f"joint {name}"
    kind = joint.get("type", "").strip()
    limit = joint.find("limit")
    lower = context.limit(limit, "lower", where)
    upper = context.limit(limit, "upper", where)
    if kind == "continuous":
        lower, upper = -math.inf, math.inf
    elif math.isnan(lower) != math.isnan(upper):
        # By the specification a limit left out is zero; if both are, they are missing.
        lower, upper = (0.0 if math.isnan(x) else x for x in (lower, upper))
    velocity = context.limit(limit, "velocity", where)
    effort = context.limit(limit, "effort", where)
    # These are not in all versions of the format.
    further = {
        quantity: context.limit(limit, quantity, where)
        for quantity in ("acceleration", "deceleration", "jerk")
    }
    given = {"velocity": velocity, "effort": effort, **further}
    for quantity, value in given.items():
        if value < 0:
            context.fail(f"{where}: limit {quantity}={value:g} is negative")
    known = {
        quantity: value if value > 0.0 else math.inf  # zero and NaN: not given
        for quantity, value in further.items()
    }
    losses = joint.find("dynamics")
    damping = context.number(losses, "damping", where, low=0.0)
    friction = context.number(losses, "friction", where, low=0.0)
    return JointDescription(
        name,
        kind,
        lower,
        upper,
        velocity,
        effort,
        damping,
        friction,
        _read_mimic(joint, context),
        acceleration=min(known["acceleration"], known["deceleration"]),
        jerk=known["jerk"],
    )


def _read_mimic(joint: Element, context: XmlContext) -> Mimic | None:
    element = joint.find("mimic")
    if element is None:
        return None
    where = f"joint {joint.get('name')}"
    return Mimic(
        leader=context.text(element, "joint", where),
        multiplier=context.number(element, "multiplier", where, default=1.0),
        offset=context.number(element, "offset", where),
    )
