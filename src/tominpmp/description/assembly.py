"""Descriptions made of others: with one more link, or of several robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from xml.etree.ElementTree import Element, SubElement, fromstring, tostring

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, real_array
from tominpmp.description.urdf import UrdfDescription
from tominpmp.description.urdf_syntax import (
    fresh_name,
    write_inertia,
    write_numbers,
    write_origin,
)
from tominpmp.exceptions import ProblemError, brief
from tominpmp.inputs import by_joint, in_order

# The link that the bases of several robots are fixed to, and the one that a robot
# stands on that is somewhere else in the world.
WORLD, GROUND = "world", "ground"
# Attribute of the joint between ground and robot, which tells it from the robot's own.
MOUNT = "mount"


@dataclass(frozen=True)
class Shape:
    """A shape of a link.

    Attributes:
        kind: "box", "sphere", "cylinder", "capsule" or "mesh".
        sizes: Numbers by attribute, as URDF has them [m].
        placement: Placement shape_to_link.
        file: File of a mesh.
    """

    kind: str
    sizes: Mapping[str, Sequence[float]]
    placement: pin.SE3
    file: str | None = None


@dataclass(frozen=True)
class LinkParts:
    """A link to be added.

    Attributes:
        name: Its name.
        mass: Mass [kg].
        com: Centre of mass, shape (3,) [m].
        inertia: Inertia about it, shape (3, 3) [kg m^2].
        shapes: Shapes, for collisions and to look at.
    """

    name: str
    mass: float
    com: Array
    inertia: Array
    shapes: tuple[Shape, ...]


def carrying_link(description: UrdfDescription, frame: str) -> str | None:
    """Link whose axes a frame has: the one of its name, or the child of that joint."""
    if frame in description.links:
        return frame
    for joint in fromstring(description.xml).iter("joint"):
        if joint.get("name") == frame:
            return _end(joint, "child")
    return None


def with_link(
    description: UrdfDescription, link: LinkParts, parent: str
) -> UrdfDescription:
    """Fix one more link to a link of a description."""
    robot = fromstring(description.xml)
    new = SubElement(robot, "link", name=link.name)
    inertial = SubElement(new, "inertial")
    write_origin(inertial, pin.SE3(np.eye(3), np.array(link.com)))
    write_inertia(inertial, link.mass, link.inertia)
    checking = Element("collision_checking")
    for number, shape in enumerate(link.shapes):
        _add_shape(SubElement(new, "collision", name=str(number)), shape)
        _add_shape(SubElement(new, "visual"), shape)
        if shape.kind == "capsule":
            SubElement(checking, "capsule", name=str(number))
    if len(checking):
        new.append(checking)
    _fix(robot, f"{link.name}_joint", parent, link.name)
    return replace(
        description,
        xml=tostring(robot, encoding="unicode"),
        links=(*description.links, link.name),
    )


def _add_shape(element: Element, shape: Shape) -> None:
    write_origin(element, shape.placement)
    # URDF knows no capsule; those to collide with are marked as such.
    tag = "cylinder" if shape.kind == "capsule" else shape.kind
    copy = SubElement(SubElement(element, "geometry"), tag)
    if shape.file is not None:
        copy.set("filename", shape.file)
    for attribute, values in shape.sizes.items():
        write_numbers(copy, attribute, values)


def joined(
    parts: Mapping[str, tuple[UrdfDescription, pin.SE3]],
) -> UrdfDescription:
    """Several robots in one description, with the part before every name.

    Args:
        parts: Description and placement base_to_world of each part by its name.
    """
    name = "+".join(parts)
    robot = Element("robot", name=name)
    SubElement(robot, "link", name=WORLD)
    links, joints = [WORLD], []
    for number, (part, (description, base)) in enumerate(parts.items()):
        for element in fromstring(description.xml):
            robot.append(_renamed(element, part))
        # Parsers sort joints by name: the number keeps the order of the parts.
        mount = f"mount{number:03d}/{part}"
        _fix(robot, mount, WORLD, f"{part}/{_root(description)}", placement=base)
        links += [f"{part}/{link}" for link in description.links]
        for joint in description.joints:
            mimic = joint.mimic
            if mimic is not None:
                mimic = replace(mimic, leader=f"{part}/{mimic.leader}")
            joints.append(replace(joint, name=f"{part}/{joint.name}", mimic=mimic))
    first = next(iter(parts.values()))[0]
    folders = [folder for one, _ in parts.values() for folder in one.package_dirs]
    return UrdfDescription(
        name=name,
        xml=tostring(robot, encoding="unicode"),
        links=tuple(links),
        joints=tuple(joints),
        gravity=None,
        path=first.path,
        package_dirs=tuple(dict.fromkeys(folders)),
        parts=tuple(parts),
        order=_joined_order(parts),
        meshes=tuple(
            {k: v for one, _ in parts.values() for k, v in one.meshes}.items()
        ),
    )


def _joined_order(
    parts: Mapping[str, tuple[UrdfDescription, pin.SE3]],
) -> tuple[str, ...]:
    """Order of the joints of all robots; none where none has one of its own."""
    if not any(description.order for description, _ in parts.values()):
        return ()
    return tuple(
        f"{part}/{joint}"
        for part, (description, _) in parts.items()
        for joint in description.order or joint_order(description.xml)
    )


def on_base(description: UrdfDescription, base: pin.SE3) -> UrdfDescription:
    """The same description with its root somewhere else in the world.

    Args:
        description: The description, which may have been moved before.
        base: Placement base_to_world of its root.
    """
    robot = fromstring(description.xml)
    links, mount = description.links, robot.find(f"joint[@{MOUNT}]")
    if mount is None:
        ground = fresh_name(GROUND, set(links))
        SubElement(robot, "link", name=ground)
        mount = _fix(robot, f"{GROUND}_{MOUNT}", ground, _root(description))
        mount.set(MOUNT, "")
        links = (ground, *links)
    write_origin(mount, base)
    return replace(description, xml=tostring(robot, encoding="unicode"), links=links)


def _renamed(element: Element, part: str) -> Element:
    """Put the name of a part before the names of a link or a joint, in place."""
    element.set("name", f"{part}/{element.get('name')}")
    element.attrib.pop(MOUNT, None)
    for end in ("parent", "child"):
        for found in element.findall(end):
            found.set("link", f"{part}/{found.get('link')}")
    for material in element.iter("material"):
        # Parsers take materials of one name for the same.
        material.set("name", f"{part}/{material.get('name')}")
    return element


def _root(description: UrdfDescription) -> str:
    """The link without a parent."""
    robot = fromstring(description.xml)
    children = {_end(joint, "child") for joint in robot.findall("joint")}
    return next(link for link in description.links if link not in children)


def _end(joint: Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _fix(
    robot: Element,
    name: str,
    parent: str,
    child: str,
    *,
    placement: pin.SE3 | None = None,
) -> Element:
    """Fix a link to another by a joint, under a name that no other joint has."""
    taken = {joint.get("name", "") for joint in robot.iterfind("joint")}
    joint = SubElement(robot, "joint", name=fresh_name(name, taken), type="fixed")
    write_origin(joint, pin.SE3.Identity() if placement is None else placement)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    return joint


def joint_order(xml: str) -> tuple[str, ...]:
    """Names of the joints in the order that Pinocchio's model of a text has."""
    return tuple(pin.buildModelFromXML(xml).names)[1:]


def _part_row(values: object, joints: Sequence[str], part: str) -> Array:
    """Values of the joints of one robot, which may be given by their own names."""
    named = by_joint(values)
    if named is None:
        return real_array(values)
    own = [joint.removeprefix(f"{part}/") for joint in joints]
    return in_order(named, own, part)


def stack_parts(
    joints: Sequence[str], names: Sequence[str], values: Mapping[str, object]
) -> Array:
    """Put values of the joints of several robots into one array.

    The names of the joints have that of their robot before each.

    Raises:
        ProblemError: If a robot is missing or unknown, or a length is wrong.
    """
    known = ", ".join(names) or "none; it was not combined from several"
    for name in (*values, *names):
        if name not in names or name not in values:
            state = "given" if name not in names else "missing"
            raise ProblemError(
                f"values for {brief(name)} are {state}; the robots are: {known}", name
            )
    out = np.empty(len(joints))
    for name in names:
        rows = [i for i, joint in enumerate(joints) if joint.startswith(f"{name}/")]
        try:
            given = _part_row(values[name], [joints[i] for i in rows], name)
        except ValueError:
            given = np.empty((0, 0))
        if given.shape != (len(rows),):
            raise ProblemError(
                f"{name} has shape {given.shape}, expected {len(rows)} numbers, one "
                f"for each of: {', '.join(joints[i] for i in rows)}",
                name,
            )
        out[rows] = given
    return out
