"""Reading URDF files into a form that parses the same way everywhere.

The file is guarded and checked (:mod:`~tominpmp.description.urdf_syntax`), parsed by
yourdfpy and written anew, with nothing but what kinematics and geometry need: parsers
print about the remains of simulators, differ in how they take missing attributes, and
report any mistake as "no valid URDF". In the new text

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
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, fromstring, tostring

import numpy as np

from tominpmp.arrays import record_line
from tominpmp.description.links import simplified_links
from tominpmp.description.urdf_keys import warn_of_unread
from tominpmp.description.urdf_syntax import checked_copy
from tominpmp.description.xml_reader import (
    MAX_NUMBER,
    XmlContext,
    parse_xml,
    read_xml,
)
from tominpmp.exceptions import brief


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
        armature: Rotor inertia seen at the joint [kg m^2 or kg].
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
    armature: float = 0.0


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
        order: Names of the joints in the order that arrays have; empty for that of
            Pinocchio's model of the description.
        meshes: Meshes that no file holds, as STL files, with the names that the
            description has for them.
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
    order: tuple[str, ...] = ()
    meshes: tuple[tuple[str, bytes], ...] = field(default=(), repr=False)

    def __repr__(self) -> str:
        """What it holds, on one line."""
        return record_line(self)


def read_urdf(
    path: Path, package_dirs: Sequence[Path] = (), text: bytes | None = None
) -> UrdfDescription:
    """Read a URDF file, or a text with its name; folders are for ``package://``.

    Raises:
        RobotLoadError: If the file is no URDF file, contradicts itself, has a joint of
            several degrees of freedom, or refers to a mesh that is not there.
    """
    root = read_xml(path) if text is None else parse_xml(text, path)
    return _read(root, XmlContext(path), package_dirs)


def read_parsed(
    parsed: Any, path: Path, package_dirs: Sequence[Path] = ()
) -> UrdfDescription:
    """Take what yourdfpy has read, or what was made of it, as a file that says it.

    Args:
        parsed: A ``yourdfpy.URDF``.
        path: Where it comes from; names of meshes are relative to it.
        package_dirs: Folders in which to look for ``package://``.

    Raises:
        RobotLoadError: As :func:`read_urdf`.
    """
    root = fromstring(parsed.write_xml_string())
    for element, joint in zip(root.iter("joint"), parsed.robot.joints, strict=True):
        # What its writer leaves out.
        for tag in ("mimic", "safety_controller"):
            said = getattr(joint, tag)
            if said is not None:
                given = {k: str(v) for k, v in vars(said).items() if v is not None}
                SubElement(element, tag, given)
    return _read(root, XmlContext(path), package_dirs)


def _read(
    root: Element, context: XmlContext, folders: Sequence[Path]
) -> UrdfDescription:
    _check_root(root, context)
    copy, beyond = checked_copy(root, context)
    # Its import takes a second: only what reads a file needs it.
    import yourdfpy

    source = BytesIO(tostring(copy))
    only_text = {"build_scene_graph": False, "load_meshes": False}
    robot = yourdfpy.URDF.load(source, **only_text).robot
    warn_of_unread(root, robot.joints, context)
    links = _by_name(robot.links, "link", context)
    joints = _by_name(robot.joints, "joint", context)
    _check_tree(links, joints, context)
    moving = tuple(
        _describe_joint(joint, beyond.motion.get(name, {}), context)
        for name, joint in joints.items()
        if joint.type != "fixed"
    )
    for described in moving:
        mimic = described.mimic
        if mimic is not None and mimic.leader not in joints:
            context.fail(
                f"joint {described.name} follows {brief(mimic.leader)}, which is no "
                "joint"
            )
    # Limits are placeholders, for the parsers demand some.
    limit = yourdfpy.Limit(effort=1.0, velocity=1.0, lower=-1.0, upper=1.0)
    simple = yourdfpy.Robot(
        robot.name,
        simplified_links(list(links.values()), context, folders),
        [_simplified_joint(joint, limit, context) for joint in joints.values()],
    )
    writer = yourdfpy.URDF(
        simple, filename_handler=yourdfpy.filename_handler_null, **only_text
    )
    return UrdfDescription(
        name=robot.name,
        xml=_with_capsules(writer.write_xml_string(), beyond.capsules),
        links=tuple(links),
        joints=moving,
        gravity=beyond.gravity,
        path=context.path,
        package_dirs=tuple(folders),
    )


def _with_capsules(xml: bytes, capsules: Mapping[str, Sequence[int]]) -> str:
    """Say which cylinders are capsules, as Pinocchio reads it."""
    root = fromstring(xml)
    for link in root.iter("link"):
        own = capsules.get(link.get("name", ""), ())
        checking = SubElement(link, "collision_checking") if own else link
        for i in own:
            SubElement(checking, "capsule", name=str(i))
    return tostring(root, encoding="unicode")


def _simplified_joint(joint: Any, limit: Any, context: XmlContext) -> Any:
    """A joint as every parser reads it: its motion is said elsewhere."""
    if joint.type == "fixed":
        return replace(joint, axis=None)
    norm = np.linalg.norm(joint.axis)
    if norm < 1e-6:
        axis = tuple(joint.axis.tolist())
        context.fail(f"joint {joint.name}: the axis {axis} has no direction")
    kind = "revolute" if joint.type == "continuous" else joint.type
    axis = joint.axis / norm
    return replace(joint, type=kind, axis=axis, limit=limit, dynamics=None)


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


def _by_name(items: Sequence[Any], tag: str, context: XmlContext) -> dict[str, Any]:
    """Links or joints by their names, which must differ."""
    found: dict[str, Any] = {}
    for item in items:
        if item.name in found:
            context.fail(f"there are two {tag}s named {brief(item.name)}")
        found[item.name] = item
    return found


def _check_tree(
    links: Mapping[str, Any], joints: Mapping[str, Any], context: XmlContext
) -> None:
    """Check that the joints make one tree of the links."""
    children: dict[str, list[str]] = {name: [] for name in links}
    parent_joint: dict[str, str] = {}
    for name, joint in joints.items():
        parent, child = joint.parent, joint.child
        for end, link in (("parent", parent), ("child", child)):
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


def _describe_joint(
    joint: Any, motion: Mapping[str, float], context: XmlContext
) -> JointDescription:
    """Limits, friction and leader of a joint that can move."""
    where = f"joint {joint.name}"
    kind = joint.type
    if kind in ("floating", "planar"):
        context.fail(
            f"{where} is {kind}; only revolute, continuous, prismatic and fixed "
            "joints can be planned for"
        )
    if kind not in ("revolute", "continuous", "prismatic"):
        context.fail(f"{where} has the unknown type {brief(kind)}")
    lower, upper, velocity, effort = (
        _limit(getattr(joint.limit, name, None))
        for name in ("lower", "upper", "velocity", "effort")
    )
    if kind == "continuous":
        lower, upper = -math.inf, math.inf
    elif math.isnan(lower) != math.isnan(upper):
        # By the specification a limit left out is zero; if both are, they are missing.
        lower, upper = (0.0 if math.isnan(x) else x for x in (lower, upper))
    for quantity, value in {"velocity": velocity, "effort": effort, **motion}.items():
        if value < 0:
            context.fail(f"{where}: limit {quantity}={value:g} is negative")
    # Zero means that none is given.
    known = {name: _limit(value) for name, value in motion.items() if value > 0.0}
    # yourdfpy keeps these as text.
    losses = (getattr(joint.dynamics, name, None) for name in ("damping", "friction"))
    damping, friction = (float(loss or 0.0) for loss in losses)
    leader = joint.mimic
    return JointDescription(
        joint.name,
        kind,
        lower,
        upper,
        velocity,
        effort,
        damping,
        friction,
        leader and Mimic(leader.joint, leader.multiplier, leader.offset),
        acceleration=min(
            known.get(name, math.inf) for name in ("acceleration", "deceleration")
        ),
        jerk=known.get("jerk", math.inf),
    )


def _limit(value: float | None) -> float:
    """A limit: NaN if it is not given, infinite if it is beyond reason."""
    if value is None:
        return math.nan
    # "No limit" is commonly written as 1e16 or the like.
    return math.copysign(math.inf, value) if abs(value) > MAX_NUMBER else value
