"""Writing descriptions as URDF and SRDF files that give them back.

Meshes that no file holds become files beside them.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray
from tominpmp.description.srdf import NEVER, SemanticDescription
from tominpmp.description.tree import (
    JointDescription,
    LinkDescription,
    Shape,
    UrdfDescription,
)
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
    root, files = Element("robot", name=description.name), {}
    for link in description.bodies:
        if link.name not in without:
            files.update(_add_link(root, link, stem))
    for joint in description.tree:
        if joint.child not in without:
            _add_joint(root, joint)
    if description.gravity is not None:
        write_numbers(SubElement(root, "tominpmp"), "gravity", description.gravity)
    return _text(root), files


def _add_link(root: Element, link: LinkDescription, stem: str) -> dict[str, bytes]:
    """Add a link, and return the meshes that no file holds."""
    element, files = SubElement(root, "link", name=link.name), {}
    if link.mass is not None:
        inertial = SubElement(element, "inertial")
        write_numbers(SubElement(inertial, "origin"), "xyz", link.com)
        write_numbers(SubElement(inertial, "mass"), "value", [link.mass])
        moments = SubElement(inertial, "inertia")
        for i, k in zip(*np.triu_indices(3), strict=True):
            write_numbers(moments, f"i{'xyz'[i]}{'xyz'[k]}", [link.inertia[i, k]])
    for tag, shapes in (("collision", link.collisions), ("visual", link.visuals)):
        for shape in shapes:
            item = SubElement(element, tag)
            _add_origin(item, shape.placement)
            files.update(_add_shape(SubElement(item, "geometry"), shape, stem))
            if shape.colour is not None:
                material = SubElement(item, "material", name="")
                write_numbers(SubElement(material, "color"), "rgba", shape.colour)
                if shape.texture:
                    SubElement(material, "texture", filename=shape.texture)
    return files


def _add_shape(element: Element, shape: Shape, stem: str) -> dict[str, bytes]:
    """Add a shape, and return its mesh if no file holds that."""
    item = SubElement(element, shape.kind)
    if shape.kind == "mesh":
        write_numbers(item, "scale", shape.sizes)
        item.set("filename", shape.file)
        if shape.corners is None or shape.faces is None:
            return {}
        content = _stl(shape.corners, shape.faces)
        file = f"{stem}_{hashlib.sha256(content).hexdigest()[:32]}.stl"
        item.set("filename", file)
        return {file: content}
    if shape.kind == "box":
        write_numbers(item, "size", shape.sizes)
    else:
        for name, size in zip(("radius", "length"), shape.sizes, strict=False):
            write_numbers(item, name, [size])
    return {}


def _stl(corners: Array, faces: IntArray) -> bytes:
    """A binary STL file of triangles."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("z", "<u2")])
    rows = np.zeros(len(faces), dtype=record)
    rows["corners"] = corners[faces]
    return bytes(80) + len(faces).to_bytes(4, "little") + bytes(rows.tobytes())


def _add_origin(element: Element, placement: Array) -> None:
    """Add a placement, exact to rounding also where the pitch is a right angle."""
    origin = SubElement(element, "origin")
    write_numbers(origin, "xyz", placement[:3, 3])
    write_numbers(origin, "rpy", pin.rpy.matrixToRpy(placement[:3, :3]))


def _add_joint(root: Element, joint: JointDescription) -> None:
    element = SubElement(root, "joint", name=joint.name, type=joint.kind)
    _add_origin(element, joint.placement)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    if joint.kind == "fixed":
        return
    write_numbers(SubElement(element, "axis"), "xyz", joint.axis)
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
