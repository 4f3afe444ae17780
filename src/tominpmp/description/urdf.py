"""Reading URDF files into a form that parses the same way everywhere.

The file is guarded and checked (:mod:`~tominpmp.description.urdf_syntax`), parsed by
yourdfpy, and becomes a tree of links and joints (:mod:`~tominpmp.description.tree`), in
which every mesh is an absolute path of a file that exists.

Capsules may be given as ``<capsule radius="" length=""/>``, or as a cylinder named in
Pinocchio's extension ``<collision_checking><capsule name=""/></collision_checking>``;
the length is that of the straight part. ``<tominpmp gravity="x y z"/>`` in the robot
element gives a gravity [m/s^2] other than the usual one along -z.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, fromstring, tostring

import numpy as np

from tominpmp.arrays import Array, frozen_array
from tominpmp.description.files import LONGEST_PATH, resolve_resource
from tominpmp.description.tree import (
    JointDescription,
    LinkDescription,
    Mimic,
    Shape,
    UrdfDescription,
)
from tominpmp.description.urdf_syntax import (
    CAPSULE,
    MOTION,
    checked_copy,
    warn_of_unread,
)
from tominpmp.description.xml_reader import (
    MAX_NUMBER,
    XmlContext,
    parse_xml,
    read_xml,
)
from tominpmp.exceptions import brief, shortened, warn_caller

# A mesh beyond this would take minutes and gigabytes.
MAX_MESH_BYTES = 512 * 2**20
# Colour of what has a texture only.
BLACK = (0.0, 0.0, 0.0, 1.0)


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
    gravity, own = None, root.find("tominpmp")
    if own is not None and "gravity" in own.attrib:
        gravity = context.numbers(own, "gravity", "robot", (0.0, 0.0, 0.0))
    copy = checked_copy(root, context)
    # Its import takes a second: only what reads a file needs it.
    import yourdfpy

    source = BytesIO(tostring(copy))
    only_text = {"build_scene_graph": False, "load_meshes": False}
    robot = yourdfpy.URDF.load(source, **only_text).robot
    warn_of_unread(root, robot.joints, context)
    links = _by_name(robot.links, "link", context)
    joints = _by_name(robot.joints, "joint", context)
    _check_tree(links, joints, context)
    motion = {
        joint.get("name", ""): {k: float(v) for k, v in limit.items() if k in MOTION}
        for joint in copy.iter("joint")
        for limit in joint.findall("limit")
    }
    tree = [
        _describe_joint(joint, motion.get(name, {}), context)
        for name, joint in joints.items()
    ]
    for described in tree:
        mimic = described.mimic
        if mimic is not None and mimic.leader not in joints:
            context.fail(
                f"joint {described.name} follows {brief(mimic.leader)}, which is no "
                "joint"
            )
    found = _Links(context, folders).read(links.values())
    return UrdfDescription(
        name=robot.name,
        bodies=found,
        tree=tuple(tree),
        gravity=gravity,
        path=context.path,
        package_dirs=tuple(folders),
    )


class _Links:
    """Links of those of yourdfpy, with meshes that are there.

    Meshes to look at that are not there are left out, with a warning: motions are the
    same without them. Those to collide with have to be there.
    """

    def __init__(self, context: XmlContext, folders: Sequence[Path]) -> None:
        self.context, self.folders = context, folders
        self.unseen: list[str] = []

    def read(self, links: Iterable[Any]) -> tuple[LinkDescription, ...]:
        found = tuple(self._link(link) for link in links)
        if self.unseen:
            others = len(self.unseen) - 1
            more = f" and {others} more" if others else ""
            warn_caller(
                f"{self.context.path}: not shown, as their meshes are not there: "
                f"{self.unseen[0]}{more}; folders that hold packages are given in "
                "package_dirs"
            )
        return found

    def _link(self, link: Any) -> LinkDescription:
        collisions, visuals = [], []
        for i, item in enumerate(link.collisions):
            shape = self._shape(item, f"link {link.name}, collision {i + 1}")
            capsule = item.name == CAPSULE
            collisions.append(replace(shape, kind="capsule") if capsule else shape)
        for i, item in enumerate(link.visuals):
            where, mesh = f"link {link.name}, visual {i + 1}", item.geometry.mesh
            if mesh is not None and self._find(mesh.filename)[0] is None:
                self.unseen.append(f"{where} ({shortened(repr(mesh.filename))})")
            else:
                visuals.append(self._coloured(self._shape(item, where), item.material))
        shapes = tuple(collisions), tuple(visuals)
        if link.inertial is None:
            return LinkDescription(link.name, collisions=shapes[0], visuals=shapes[1])
        own, axes = link.inertial, _placement(link.inertial.origin)
        turn, moments = axes[:3, :3], own.inertia
        inertia = np.zeros((3, 3)) if moments is None else turn @ moments @ turn.T
        com, tensor = frozen_array(axes[:3, 3]), frozen_array(inertia)
        return LinkDescription(link.name, float(own.mass), com, tensor, *shapes)

    def _find(self, name: str) -> tuple[Path | None, tuple[Path, ...]]:
        """A file that the description refers to, and the paths tried."""
        return resolve_resource(name, self.context.path, self.folders)

    def _shape(self, item: Any, where: str) -> Shape:
        """A shape; a mesh with the absolute path of its file."""
        placement, geometry = _placement(item.origin), item.geometry
        if geometry.box is not None:
            return Shape("box", _sizes(geometry.box.size), placement)
        if geometry.sphere is not None:
            return Shape("sphere", _sizes(geometry.sphere.radius), placement)
        rod, mesh = geometry.cylinder, geometry.mesh
        if rod is not None:
            return Shape("cylinder", _sizes([rod.radius, rod.length]), placement)
        path, tried = self._find(mesh.filename)
        if path is None:
            remedy = "; give the folder that holds the package in package_dirs"
            package = mesh.filename.startswith(("package://", "model://"))
            self.context.fail(
                f"{where}: the mesh {shortened(repr(mesh.filename))} is not there; "
                "tried "
                + ", ".join(shortened(str(place), LONGEST_PATH) for place in tried)
                + (remedy if package else "")
            )
        if path.stat().st_size > MAX_MESH_BYTES:
            self.context.fail(
                f"{where}: the mesh {path} has more than {MAX_MESH_BYTES} bytes"
            )
        scale = np.broadcast_to(1.0 if mesh.scale is None else mesh.scale, 3)
        return Shape("mesh", _sizes(scale), placement, str(path.absolute()))

    def _coloured(self, shape: Shape, material: Any) -> Shape:
        """Colour and texture; these are looks, so a texture not found is left out."""
        if material is None:
            return shape
        texture, path = material.texture, None
        if texture is not None:
            path = self._find(texture.filename)[0]
        if material.color is None and path is None:
            return shape
        colour = BLACK if material.color is None else _sizes(material.color.rgba)
        return replace(shape, colour=colour, texture="" if path is None else str(path))


def _placement(matrix: Any) -> Array:
    return frozen_array(np.eye(4) if matrix is None else matrix)


def _sizes(values: Any) -> tuple[float, ...]:
    return tuple(np.ravel(values).astype(float).tolist())


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
    """A joint, with limits, friction and leader if it can move."""
    where = f"joint {joint.name}"
    kind = joint.type
    ends = joint.parent, joint.child, _placement(joint.origin)
    if kind == "fixed":
        return JointDescription(joint.name, kind, *ends)
    if kind in ("floating", "planar"):
        context.fail(
            f"{where} is {kind}; only revolute, continuous, prismatic and fixed "
            "joints can be planned for"
        )
    if kind not in ("revolute", "continuous", "prismatic"):
        context.fail(f"{where} has the unknown type {brief(kind)}")
    axis, norm = tuple(joint.axis.tolist()), np.linalg.norm(joint.axis)
    if norm < 1e-6:
        context.fail(f"{where}: the axis {axis} has no direction")
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
        *ends,
        frozen_array(joint.axis / norm),
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
