"""URDF files: a guarded XML file becomes a tree of links and joints, and back.

Every number and name is checked where it is read, with the link or joint and the field
in the message; what other programs have left in a file is passed over. Every mesh of
the tree (:mod:`~tominpmp.description.tree`) is an absolute path of a file that exists.
A file that says more of a motion than is read causes a warning.

Capsules may be given as ``<capsule radius="" length=""/>``, or as a cylinder named in
Pinocchio's extension ``<collision_checking><capsule name=""/></collision_checking>``;
the length is that of the straight part. ``<tominpmp gravity="x y z"/>`` in the robot
element gives a gravity [m/s^2] other than the usual one along -z.
"""

from __future__ import annotations

import difflib
import hashlib
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, fromstring

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray, frozen_array
from tominpmp.description.files import LONGEST_PATH, resolve_resource
from tominpmp.description.tree import (
    SIZES,
    JointDescription,
    LinkDescription,
    Mimic,
    Shape,
    UrdfDescription,
)
from tominpmp.description.xml_reader import (
    MAX_NUMBER,
    XmlContext,
    add,
    parse_xml,
    read_xml,
    to_number,
    xml_text,
)
from tominpmp.exceptions import brief, shortened, warn_caller

# What follows recurses into the tree; humanoids have some hundred links.
MAX_LINKS = 2000
# A mesh beyond this would take minutes and gigabytes.
MAX_MESH_BYTES = 512 * 2**20
# Colour of what has a texture only.
BLACK = (0.0, 0.0, 0.0, 1.0)

SHAPES = (*SIZES, "mesh")
MOTION = ("acceleration", "deceleration", "jerk")
LIMITS = ("lower", "upper", "velocity", "effort", *MOTION)

# What is compared with what a file has: other names mean something to other programs,
# unless they are nearly these.
CHILDREN = {
    "robot": ("link", "joint", "material"),
    "link": ("inertial", "visual", "collision"),
    "joint": (
        *("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
        "safety_controller",
    ),
    "inertial": ("mass", "origin", "inertia"),
}
ATTRIBUTES = {
    "limit": LIMITS,
    "dynamics": ("damping", "friction"),
    "mimic": ("joint", "multiplier", "offset"),
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "mass": ("value",),
}
# How alike a name must be to be taken for a mistake, from 0 to 1.
ALIKE = 0.8
# Soft limits this little within the limits are on them [rad or m].
SLIGHT = 1e-9
# Beyond as many places a warning names no more.
MOST = 10
# Limits of joints that turn within which nobody gives radians: five to 115 turns.
MANY_TURNS, DEGREES = 30.0, 720.0


def read_urdf(
    path: Path, package_dirs: Sequence[Path] = (), text: bytes | None = None
) -> UrdfDescription:
    """Read a URDF file, or a text with its name; folders are for ``package://``.

    Raises:
        RobotLoadError: If the file is no URDF file, contradicts itself, has a joint of
            several degrees of freedom, or refers to a mesh that is not there.
    """
    root = read_xml(path) if text is None else parse_xml(text, path)
    return _UrdfReader(root, XmlContext(path), package_dirs).read()


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
                given = {k: v for k, v in vars(said).items() if v is not None}
                add(element, tag, **given)
    return _UrdfReader(root, XmlContext(path), package_dirs).read()


class _UrdfReader:
    """Reads the links and joints of a file, and collects what to warn of.

    Meshes to look at that are not there are left out: motions are the same without
    them. Those to collide with have to be there.
    """

    def __init__(
        self, root: Element, context: XmlContext, folders: Sequence[Path]
    ) -> None:
        self.root, self.context, self.folders = root, context, folders
        # Colours may be defined anywhere, and be used by their name.
        self.materials: dict[str, Element] = {}
        for element in root.iter("material"):
            if len(element):
                self.materials.setdefault(element.get("name", ""), element)
        #: Visual shapes without their mesh.
        self.unseen: list[str] = []
        #: Joints with soft limits within their limits, and with limits in degrees.
        self.softer: list[str] = []
        self.turned: list[str] = []

    def read(self) -> UrdfDescription:
        root, context = self.root, self.context
        self._check_root()
        # Joints of a <transmission> or <gazebo> are not children of the root.
        elements = {tag: self._named(tag) for tag in ("link", "joint")}
        links = tuple(self._link(*item) for item in elements["link"].items())
        joints = tuple(self._joint(*item) for item in elements["joint"].items())
        gravity, own = None, root.find("tominpmp")
        if own is not None and "gravity" in own.attrib:
            gravity = context.numbers(own, "gravity", "robot", (0.0, 0.0, 0.0))
        _check_tree(elements["link"], joints, context)
        self._warn()
        return UrdfDescription(
            name=root.get("name", "").strip() or context.path.stem,
            bodies=links,
            tree=joints,
            gravity=gravity,
            path=context.path,
            package_dirs=tuple(self.folders),
        )

    def _check_root(self) -> None:
        """Refuse other kinds of XML files, saying what they seem to be."""
        if self.root.tag != "robot":
            self.context.fail(
                f"is no URDF file: its root is <{self.root.tag}>, expected <robot>"
            )
        for element in self.root.iter():
            if element.tag.startswith("xacro:"):
                self.context.fail(
                    f"is a xacro file (it has <{element.tag}>); expand it first: "
                    "xacro FILE > robot.urdf"
                )
        if self.root.find("link") is None:
            self.context.fail("is no URDF file: it has no <link>")

    def _named(self, tag: str) -> dict[str, Element]:
        """Links or joints by their names, which must differ."""
        elements, found = self.root.findall(tag), dict[str, Element]()
        if len(elements) > MAX_LINKS:
            self.context.fail(
                f"has {len(elements)} {tag}s, at most {MAX_LINKS} are read"
            )
        for number, element in enumerate(elements, 1):
            name = self.context.text(element, "name", f"{tag} number {number}")
            if name in found:
                self.context.fail(f"there are two {tag}s named {brief(name)}")
            found[name] = element
        return found

    # -- links -------------------------------------------------------------------------

    def _link(self, name: str, link: Element) -> LinkDescription:
        context, where = self.context, f"link {name}"
        shapes = self._shapes(link, where)
        inertial = link.find("inertial")
        if inertial is None:
            collisions, visuals = shapes
            return LinkDescription(name, collisions=collisions, visuals=visuals)
        mass = context.child(inertial, "mass", f"{where}: <inertial>")
        placement, moments = self._placement(inertial, where), inertial.find("inertia")
        # No check of their sign: rounding leaves moments of -1e-20, and whether the
        # robot as a whole has inertia is checked on its mass matrix.
        rows = [
            [context.number(moments, f"i{min(i, k)}{max(i, k)}", where) for k in "xyz"]
            for i in "xyz"
        ]
        turn = placement[:3, :3]
        return LinkDescription(
            name,
            context.number(mass, "value", where, low=0.0),
            frozen_array(placement[:3, 3]),
            frozen_array(turn @ np.array(rows) @ turn.T),
            *shapes,
        )

    def _placement(self, element: Element, where: str) -> Array:
        """Placement of an element in the axes of the link that it belongs to."""
        origin = element.find("origin")
        zeros = (0.0, 0.0, 0.0)
        matrix = np.eye(4)
        matrix[:3, 3] = self.context.numbers(origin, "xyz", where, zeros)
        angles = self.context.numbers(origin, "rpy", where, zeros)
        matrix[:3, :3] = _rotation(np.array(angles))
        return frozen_array(matrix)

    def _shapes(
        self, link: Element, where: str
    ) -> tuple[tuple[Shape, ...], tuple[Shape, ...]]:
        """Shapes of a link to collide with, and to look at."""
        capsules = {c.get("name") for c in link.findall("collision_checking/capsule")}
        found: dict[str, list[Shape]] = {"collision": [], "visual": []}
        for tag, shapes in found.items():
            for number, item in enumerate(link.findall(tag), 1):
                shape = self._shape(item, f"{where}, {tag} {number}")
                if shape is None:
                    continue
                if tag == "visual":
                    shape = self._coloured(shape, item.find("material"))
                elif shape.kind == "cylinder" and item.get("name") in capsules:
                    shape = replace(shape, kind="capsule")
                shapes.append(shape)
        return tuple(found["collision"]), tuple(found["visual"])

    def _shape(self, item: Element, where: str) -> Shape | None:
        """The shape of a <collision> or <visual>; None if one to look at is missing."""
        context, place = self.context, self._placement(item, where)
        shapes = item.findall("geometry[1]/*")
        if len(shapes) != 1 or shapes[0].tag not in SHAPES:
            found = ", ".join(f"<{shape.tag}>" for shape in shapes) or "nothing"
            context.fail(
                f"{where}: <geometry> has {found}, expected one of {', '.join(SHAPES)}"
            )
        (shape,), kind = shapes, shapes[0].tag
        if kind == "mesh":
            return self._mesh(shape, place, where, seen=item.tag == "visual")
        sizes: list[float] = []
        for name, count in SIZES[kind].items():
            text = context.text(shape, name, where)
            numbers = context.numbers(shape, name, where, (0.0,) * count)
            if min(numbers) <= 0.0:
                context.fail(
                    f"{where}: {kind} {name}={text!r}, expected numbers greater than "
                    "zero"
                )
            sizes += numbers
        return Shape(kind, tuple(sizes), place)

    def _mesh(
        self, mesh: Element, place: Array, where: str, *, seen: bool
    ) -> Shape | None:
        """A mesh with the path of its file; None if one to look at has none."""
        context, name = self.context, self.context.text(mesh, "filename", where)
        scale = context.numbers(mesh, "scale", where, (1.0, 1.0, 1.0))
        if 0.0 in scale:
            context.fail(f"{where}: mesh scale={list(scale)}, expected none to be zero")
        path, tried = self._find(name)
        if path is None and seen:
            self.unseen.append(f"{where} ({shortened(repr(name))})")
            return None
        if path is None:
            places = (shortened(str(place), LONGEST_PATH) for place in tried)
            remedy = "; give the folder that holds the package in package_dirs"
            context.fail(
                f"{where}: the mesh {shortened(repr(name))} is not there; tried "
                + ", ".join(places)
                + (remedy if name.startswith(("package://", "model://")) else "")
            )
        if path.stat().st_size > MAX_MESH_BYTES:
            context.fail(
                f"{where}: the mesh {path} has more than {MAX_MESH_BYTES} bytes"
            )
        return Shape("mesh", scale, place, str(path.absolute()))

    def _find(self, name: str) -> tuple[Path | None, tuple[Path, ...]]:
        """A file that the description refers to, and the paths tried."""
        return resolve_resource(name, self.context.path, self.folders)

    def _coloured(self, shape: Shape, material: Element | None) -> Shape:
        """Colour and texture; these are looks, so what is wrong is left out."""
        if material is None:
            return shape
        if not len(material):
            material = self.materials.get(material.get("name", ""), material)
        color, texture = material.find("color"), material.find("texture")
        words = () if color is None else color.get("rgba", "").split()
        rgba = tuple(map(to_number, words))
        known = len(rgba) == 4 and all(0.0 <= part <= 1.0 for part in rgba)
        name = "" if texture is None else texture.get("filename", "")
        path = self._find(name)[0] if name else None
        if not known and path is None:
            return shape
        file = "" if path is None else str(path)
        return replace(shape, colour=rgba if known else BLACK, texture=file)

    # -- joints ------------------------------------------------------------------------

    def _joint(self, name: str, joint: Element) -> JointDescription:
        """A joint, with limits, friction and leader if it can move."""
        context, where = self.context, f"joint {name}"
        kind = context.text(joint, "type", where)
        parent, child = (
            context.text(context.child(joint, end, where), "link", where)
            for end in ("parent", "child")
        )
        ends = parent, child, self._placement(joint, where)
        if kind == "fixed":
            return JointDescription(name, kind, *ends)
        if kind in ("floating", "planar"):
            context.fail(
                f"{where} is {kind}; only revolute, continuous, prismatic and fixed "
                "joints can be planned for"
            )
        if kind not in ("revolute", "continuous", "prismatic"):
            context.fail(f"{where} has the unknown type {brief(kind)}")
        axis = context.numbers(joint.find("axis"), "xyz", where, (1.0, 0.0, 0.0))
        norm = np.linalg.norm(axis)
        if norm < 1e-6:
            context.fail(f"{where}: the axis {axis} has no direction")
        limit = joint.find("limit")
        limits = {key: context.limit(limit, key, where) for key in LIMITS}
        for key, value in limits.items():
            if key not in ("lower", "upper") and value < 0.0:
                context.fail(f"{where}: limit {key}={value:g} is negative")
        self._look_at_ends(name, joint, limits)
        limits = {key: _bounded(value) for key, value in limits.items()}
        lower, upper = limits["lower"], limits["upper"]
        if kind == "continuous":
            lower, upper = -math.inf, math.inf
        elif math.isnan(lower) != math.isnan(upper):
            # By the specification a limit left out is zero; if both are, they are
            # missing.
            lower, upper = (0.0 if math.isnan(x) else x for x in (lower, upper))
        # Zero means that none is given.
        acceleration, jerk = (
            min((limits[key] for key in keys if limits[key] > 0.0), default=math.inf)
            for keys in (MOTION[:2], MOTION[2:])
        )
        dynamics, leader = joint.find("dynamics"), joint.find("mimic")
        mimic = None
        if leader is not None:
            (ratio,) = context.numbers(leader, "multiplier", where, (1.0,))
            offset = context.number(leader, "offset", where)
            mimic = Mimic(context.text(leader, "joint", where), ratio, offset)
        return JointDescription(
            name,
            kind,
            *ends,
            frozen_array(np.array(axis) / norm),
            lower,
            upper,
            limits["velocity"],
            limits["effort"],
            context.number(dynamics, "damping", where, low=0.0),
            context.number(dynamics, "friction", where, low=0.0),
            mimic,
            acceleration=acceleration,
            jerk=jerk,
        )

    # -- warnings ----------------------------------------------------------------------

    def _look_at_ends(
        self, name: str, joint: Element, limits: Mapping[str, float]
    ) -> None:
        """Note soft limits within the limits of a joint, and limits in degrees."""
        kind, least, most = joint.get("type"), limits["lower"], limits["upper"]
        ends = [abs(x) for x in (least, most) if not math.isnan(x)]
        if kind == "revolute" and MANY_TURNS <= max(ends, default=0.0) <= DEGREES:
            self.turned.append(name)
        soft = joint.find("safety_controller")
        if soft is None or kind == "continuous":
            return
        # What is left out, or no number, is neither more nor less than anything.
        lower, upper = (
            to_number(soft.get(f"soft_{end}_limit", "")) for end in ("lower", "upper")
        )
        # Two that are alike were left out, which the specification takes for zero.
        if lower < upper and (lower > least + SLIGHT or upper < most - SLIGHT):
            self.softer.append(name)

    def _warn(self) -> None:
        """Warn of likely mistakes, soft and strange limits, and meshes not there.

        Controllers may keep a ``<safety_controller>``'s soft limits; they are not read.
        """
        path, unread = self.context.path, _mistakes(self.root, "robot")
        for element in (*self.root.findall("link"), *self.root.findall("joint")):
            where = f"{element.tag} {element.get('name', '').strip()}"
            for part in (element, *element.findall("inertial")):
                unread += _mistakes(part, where)
        if unread:
            warn_caller(f"{path}: not read: {'; '.join(unread[:MOST])}")
        if self.softer:
            warn_caller(
                f"{path}: <safety_controller>: soft limits within the position limits "
                f"are not kept: {_first(self.softer)}; give position_lower and "
                "position_upper where a controller keeps them"
            )
        if self.turned:
            warn_caller(
                f"{path}: position limits of many turns, which look like degrees: "
                f"{_first(self.turned)}; a URDF file has radians"
            )
        if self.unseen:
            others = len(self.unseen) - 1
            more = f" and {others} more" if others else ""
            warn_caller(
                f"{path}: not shown, as their meshes are not there: {self.unseen[0]}"
                f"{more}; folders that hold packages are given in package_dirs"
            )


def _rotation(angles: Array) -> Array:
    """Rotation by roll, pitch and yaw about fixed axes, shape (3, 3)."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles), np.cos(angles)
    rotation = np.array(
        [
            [cy * cz, sy * (sx * cz) - cx * sz, sy * (cx * cz) + sx * sz],
            [cy * sz, sy * (sx * sz) + cx * cz, sy * (cx * sz) - sx * cz],
            [-sy, cy * sx, cy * cx],
        ]
    )
    return rotation + 0.0  # no zero has a sign


def _bounded(value: float) -> float:
    """A limit: infinite if it is beyond reason."""
    # "No limit" is commonly written as 1e16 or the like.
    return math.copysign(math.inf, value) if abs(value) > MAX_NUMBER else value


def _check_tree(
    links: Mapping[str, Element],
    joints: Sequence[JointDescription],
    context: XmlContext,
) -> None:
    """Check that the joints make one tree of the links, and follow joints."""
    names = [joint.name for joint in joints]
    above: dict[str, JointDescription] = {}
    for joint in joints:
        for end in ("parent", "child"):
            link = getattr(joint, end)
            if link not in links:
                context.fail(
                    f"joint {joint.name}: its {end} link {brief(link)} does not exist"
                )
        if joint.child in above:
            context.fail(
                f"link {joint.child} is the child of two joints, "
                f"{above[joint.child].name} and {joint.name}: closed loops are not "
                "supported"
            )
        above[joint.child] = joint
        if joint.mimic is not None and joint.mimic.leader not in names:
            context.fail(
                f"joint {joint.name} follows {brief(joint.mimic.leader)}, which is no "
                "joint"
            )
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        context.fail(
            f"has {len(roots)} links without a parent joint, expected one: "
            f"{', '.join(roots[:10])}"
        )
    reached, front = set(roots), roots
    while front:
        front = [joint.child for joint in joints if joint.parent in front]
        reached.update(front)
    rest = [name for name in links if name not in reached]
    if rest:
        context.fail(f"the links {', '.join(rest[:10])} form a loop without a base")


def _first(names: Sequence[str]) -> str:
    return ", ".join(names[:MOST]) + (", ..." if len(names) > MOST else "")


def _mistakes(element: Element, where: str) -> list[str]:
    """Names of children, and of their attributes, that are nearly those read."""
    found = []
    for child in element:
        meant = _nearly(child.tag, CHILDREN[element.tag])
        if meant:
            found.append(f"<{child.tag}> of {where} (did you mean <{meant}>?)")
        for name in child.attrib:
            meant = _nearly(name, ATTRIBUTES.get(child.tag, ()))
            if meant:
                found.append(
                    f"the attribute {name!r} of <{child.tag}> of {where} (did you mean "
                    f"{meant!r}?)"
                )
    return found


def _nearly(name: str, known: Sequence[str]) -> str | None:
    if name in known:
        return None
    close = difflib.get_close_matches(name.lower()[:80], known, n=1, cutoff=ALIKE)
    return close[0] if close else None


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
        add(root, "tominpmp", gravity=description.gravity)
    return xml_text(root), files


def _add_link(root: Element, link: LinkDescription, stem: str) -> dict[str, bytes]:
    """Add a link, and return the meshes that no file holds."""
    element, files = add(root, "link", name=link.name), {}
    if link.mass is not None:
        inertial = add(element, "inertial")
        add(inertial, "origin", xyz=link.com)
        add(inertial, "mass", value=link.mass)
        moments = zip(*np.triu_indices(3), strict=True)
        named = {f"i{'xyz'[i]}{'xyz'[k]}": link.inertia[i, k] for i, k in moments}
        add(inertial, "inertia", **named)
    for tag, shapes in (("collision", link.collisions), ("visual", link.visuals)):
        for shape in shapes:
            item = add(element, tag)
            _add_origin(item, shape.placement)
            files.update(_add_shape(add(item, "geometry"), shape, stem))
            if shape.colour is not None:
                material = add(item, "material", name="")
                add(material, "color", rgba=shape.colour)
                if shape.texture:
                    add(material, "texture", filename=shape.texture)
    return files


def _add_shape(element: Element, shape: Shape, stem: str) -> dict[str, bytes]:
    """Add a shape, and return its mesh if no file holds that."""
    if shape.kind != "mesh":
        sizes = iter(shape.sizes)
        counts = SIZES[shape.kind].items()
        named = {name: [*islice(sizes, count)] for name, count in counts}
        add(element, shape.kind, **named)
        return {}
    item = add(element, "mesh", scale=shape.sizes, filename=shape.file)
    if shape.corners is None or shape.faces is None:
        return {}
    content = _stl(shape.corners, shape.faces)
    file = f"{stem}_{hashlib.sha256(content).hexdigest()[:32]}.stl"
    item.set("filename", file)
    return {file: content}


def _stl(corners: Array, faces: IntArray) -> bytes:
    """A binary STL file of triangles."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("z", "<u2")])
    rows = np.zeros(len(faces), dtype=record)
    rows["corners"] = corners[faces]
    return bytes(80) + len(faces).to_bytes(4, "little") + bytes(rows.tobytes())


def _add_origin(element: Element, placement: Array) -> None:
    """Add a placement, exact to rounding also where the pitch is a right angle."""
    angles = pin.rpy.matrixToRpy(placement[:3, :3])
    add(element, "origin", xyz=placement[:3, 3], rpy=angles)


def _add_joint(root: Element, joint: JointDescription) -> None:
    element = add(root, "joint", name=joint.name, type=joint.kind)
    _add_origin(element, joint.placement)
    add(element, "parent", link=joint.parent)
    add(element, "child", link=joint.child)
    if joint.kind == "fixed":
        return
    add(element, "axis", xyz=joint.axis)
    names = ["velocity", "effort"]
    names += [k for k in ("acceleration", "jerk") if getattr(joint, k) < math.inf]
    if joint.kind != "continuous":
        names += ["lower", "upper"]
    limits = {name: getattr(joint, name) for name in names}
    known = {k: v for k, v in limits.items() if not math.isnan(v)}
    most = {k: np.clip(v, -NO_LIMIT, NO_LIMIT) for k, v in known.items()}
    add(element, "limit", **most)
    add(element, "dynamics", damping=joint.damping, friction=joint.friction)
    if joint.mimic is not None:
        own = joint.mimic
        ratio, offset = own.multiplier, own.offset
        add(element, "mimic", joint=own.leader, multiplier=ratio, offset=offset)
