"""Writing descriptions as URDF and SRDF files that give them back.

What :mod:`~tominpmp.description.urdf` keeps beside the text of a description (limits,
friction, who follows whom, gravity) goes into it again, and so do groups, states and
pairs of an SRDF file. Meshes that no file holds become files.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from xml.etree.ElementTree import Element, SubElement, fromstring, indent, tostring

from tominpmp.description.srdf import NEVER, SemanticDescription
from tominpmp.description.urdf import JointDescription, UrdfDescription
from tominpmp.description.urdf_syntax import write_numbers

# How a limit is written that is none; readers take numbers of this size for that.
NO_LIMIT = 1e16


def urdf_file(
    description: UrdfDescription, without: Collection[str], stem: str
) -> tuple[bytes, dict[str, bytes]]:
    """A description as a URDF file.

    Args:
        description: The description.
        without: Names of links, each fixed to another, that are left out: payloads.
        stem: How the names of files for its meshes begin.

    Returns:
        The file, and the meshes that are to lie beside it, by their names.
    """
    root = fromstring(description.xml)
    root.set("name", description.name)
    _leave_out(root, without)
    described = {joint.name: joint for joint in description.joints}
    for element in root.findall("joint"):
        joint = described.get(element.get("name", ""))
        if joint is not None:
            _say(element, joint)
    for link in root.findall("link"):
        if link.find("collision_checking") is not None:
            # Capsules are named by their places.
            for number, item in enumerate(link.findall("collision")):
                item.set("name", str(number))
    if description.gravity is not None:
        write_numbers(SubElement(root, "tominpmp"), "gravity", description.gravity)
    carried, files = dict(description.meshes), {}
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        if name in carried:
            file = f"{stem}_{name.rpartition(':')[2]}"
            files[file] = carried[name]
            mesh.set("filename", file)
    return _text(root), files


def _leave_out(root: Element, links: Collection[str]) -> None:
    """Remove links, and the joints that hold them."""
    for link in root.findall("link"):
        if link.get("name") in links:
            root.remove(link)
    for joint in root.findall("joint"):
        child = joint.find("child")
        if child is not None and child.get("link") in links:
            root.remove(joint)


def _say(element: Element, joint: JointDescription) -> None:
    """Say of a joint what its description has, in place of what stands for it."""
    element.set("type", joint.kind)
    for tag in ("limit", "dynamics", "mimic", "safety_controller"):
        for old in element.findall(tag):
            element.remove(old)
    limit = SubElement(element, "limit")
    names = ["velocity", "effort", "acceleration", "jerk"]
    if joint.kind != "continuous":
        names += ["lower", "upper"]
    for name in names:
        value = getattr(joint, name)
        if math.isinf(value) and name in ("acceleration", "jerk"):
            continue
        if not math.isnan(value):
            large = math.copysign(NO_LIMIT, value)
            write_numbers(limit, name, [large if math.isinf(value) else value])
    losses = SubElement(element, "dynamics")
    write_numbers(losses, "damping", [joint.damping])
    write_numbers(losses, "friction", [joint.friction])
    if joint.mimic is not None:
        mimic = SubElement(element, "mimic", joint=joint.mimic.leader)
        write_numbers(mimic, "multiplier", [joint.mimic.multiplier])
        write_numbers(mimic, "offset", [joint.mimic.offset])


def srdf_file(
    semantics: SemanticDescription, name: str, without: Collection[str]
) -> bytes:
    """What an SRDF file has said, as one.

    Args:
        semantics: What it has said.
        name: Name of the robot.
        without: Links whose pairs are left out.
    """
    groups = semantics.groups
    root = Element("robot", name=groups.robot or name)
    for one, other in semantics.disabled_pairs:
        if not {one, other} & set(without):
            item = SubElement(root, "disable_collisions", link1=one, link2=other)
            if (one, other) in semantics.never_touch:
                item.set("reason", NEVER)
    for group, found in groups.groups.items():
        element = SubElement(root, "group", name=group)
        for joint in (*found.joints, *found.unknown):
            SubElement(element, "joint", name=joint)
        if found.moves_base:
            base = f"{group}_base"
            SubElement(element, "joint", name=base)
            SubElement(root, "virtual_joint", name=base, type="floating")
    for state, positions in semantics.group_states.items():
        element = SubElement(root, "group_state", name=state)
        _add_values(element, "value", positions)
    for joint in groups.passive:
        SubElement(root, "passive_joint", name=joint)
    if semantics.rotor_inertias:
        rotors = SubElement(root, "rotor_params")
        _add_values(rotors, "mass", semantics.rotor_inertias)
        for item in rotors:
            item.set("gear_ratio", "1.0")
    return _text(root)


def _add_values(element: Element, attribute: str, values: Mapping[str, float]) -> None:
    for name, value in values.items():
        write_numbers(SubElement(element, "joint", name=name), attribute, [value])


def _text(root: Element) -> bytes:
    indent(root)
    return b'<?xml version="1.0"?>\n' + tostring(root, encoding="unicode").encode()
