"""URDF files: reading them into a tree of links and joints, and writing them.

A file is checked element by element, parsed by yourdfpy, and converted to a tree of
links and joints (:mod:`~tominpmp.description.tree`), in which every mesh is the
absolute path of an existing file. Data that would affect a motion and are not read
cause a warning.

Capsules may be given as ``<capsule radius="" length=""/>``, or as a cylinder named in
Pinocchio's extension ``<collision_checking><capsule name=""/></collision_checking>``;
the length is that of the straight part. ``<tominpmp gravity="x y z"/>`` in the robot
element sets a gravity [m/s^2] other than the default along -z.

yourdfpy reads all elements of the specification, but its errors do not name the joint
and the field at fault, it fails on leftovers of other programs, and it does not support
capsules. So it gets a copy that contains only the elements that are read, with all
numbers checked and defaults written out.
"""

from __future__ import annotations

import difflib
import hashlib
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from graphlib import CycleError, TopologicalSorter
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, fromstring, tostring

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray
from tominpmp.description.files import missing_resource, resolve_resource
from tominpmp.description.tree import (
    EMPTY,
    SIZES,
    UNREAD,
    UNSEEN,
    JointDescription,
    LinkDescription,
    Mimic,
    Shape,
    UrdfDescription,
    solid,
    warn_of,
)
from tominpmp.description.xml_reader import (
    MAX_NUMBER,
    XmlContext,
    add,
    limit_or_infinity,
    read_xml,
    to_number_or_nan,
    xml_text,
)
from tominpmp.exceptions import brief, shortened

# Largest mesh file; a larger one would take minutes and gigabytes [bytes].
MAX_MESH_BYTES = 512 * 2**20
# Colour of shapes that have only a texture.
BLACK = (0.0, 0.0, 0.0, 1.0)
# Distance within which soft limits count as equal to the limits [rad or m].
SOFT_TOLERANCE = 1e-9
# Range in which limits of revolute joints look like degrees: five to 115 turns.
MANY_TURNS, MOST_TURNS = 30.0, 720.0
# Most links; the parsers recurse into the tree, and humanoids have some hundred.
MAX_LINKS = 2000
SHAPES = (*SIZES, "mesh")
# Limits of joints that yourdfpy does not read; Drake prefixes their names.
MOTION = ("acceleration", "deceleration", "jerk")
# Further remarks about a file. Controllers may enforce the soft limits, which are not
# read here.
SOFT_LIMITS = (
    "<safety_controller>: soft limits within the position limits are not kept: {}; "
    "give position_lower and position_upper where a controller keeps them"
)
IN_DEGREES = (
    "position limits of many turns, which look like degrees: {}; a URDF file has "
    "radians"
)
# Similarity from which a name is taken for a misspelling, from 0 to 1.
SIMILARITY = 0.8


class Form(NamedTuple):
    """Content of an element that is read; everything else in it is ignored.

    Attributes:
        texts: Required attributes.
        numbers: Attributes of numbers, with their defaults.
        low: Smallest valid number.
        most: Largest valid number.
        needs: Required children.
        parts: Children that are added with their defaults if missing.
        optional: Optional children; the first of several counts.
        several: Children that may repeat.
    """

    texts: Sequence[str] = ()
    numbers: Mapping[str, tuple[float, ...]] = {}
    low: float = -MAX_NUMBER
    most: float = MAX_NUMBER
    needs: Sequence[str] = ()
    parts: Sequence[str] = ()
    optional: Sequence[str] = ()
    several: Sequence[str] = ()


_ZERO, _ZEROS, _UNKNOWN = (0.0,), (0.0, 0.0, 0.0), (math.nan,)
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_LIMITS = ("lower", "upper", "velocity", "effort")
FORMS = {
    "robot": Form(several=("link", "joint", "material")),
    "link": Form(("name",), optional=("inertial",), several=("visual", "collision")),
    "inertial": Form(needs=("mass",), parts=("origin", "inertia")),
    "mass": Form(numbers={"value": _ZERO}, low=0.0),
    # The sign is not checked: rounding leaves moments of -1e-20, and the inertia of the
    # whole robot is checked by its mass matrix.
    "inertia": Form(numbers=dict.fromkeys(_MOMENTS, _ZERO)),
    "collision": Form(parts=("origin",)),
    "visual": Form(parts=("origin",)),
    **{
        kind: Form(tuple(sizes), {name: _ZERO * n for name, n in sizes.items()}, 0.0)
        for kind, sizes in SIZES.items()
    },
    "mesh": Form(("filename",), {"scale": (1.0, 1.0, 1.0)}),
    "joint": Form(
        ("name", "type"),
        needs=("parent", "child"),
        parts=("origin", "axis", "limit", "dynamics"),
        optional=("mimic",),
        several=("safety_controller",),
    ),
    "fixed joint": Form(("name", "type"), needs=("parent", "child"), parts=("origin",)),
    "parent": Form(("link",)),
    "child": Form(("link",)),
    "origin": Form(numbers={"xyz": _ZEROS, "rpy": _ZEROS}),
    "axis": Form(numbers={"xyz": (1.0, 0.0, 0.0)}),
    "limit": Form(
        numbers=dict.fromkeys(_LIMITS, _UNKNOWN), low=-math.inf, most=math.inf
    ),
    "dynamics": Form(numbers={"damping": _ZERO, "friction": _ZERO}, low=0.0),
    "mimic": Form(("joint",), {"multiplier": (1.0,), "offset": _ZERO}),
}


def _misspellings(element: Element, where: str) -> list[str]:
    """Names of children and attributes that look like misspellings of known ones.

    Other names belong to other programs.
    """
    form = FORMS[element.tag]
    faults = []
    children = (*form.needs, *form.parts, *form.optional, *form.several)
    for child in element:
        known = _closest_match(child.tag, children)
        if known:
            faults.append(f"<{child.tag}> of {where} (did you mean <{known}>?)")
        own = FORMS.get(child.tag, Form())
        attributes = (*own.texts, *own.numbers)
        for name in child.attrib:
            known = _closest_match(name, attributes + MOTION * (child.tag == "limit"))
            if known:
                faults.append(
                    f"the attribute {name!r} of <{child.tag}> of {where} (did you mean "
                    f"{known!r}?)"
                )
    return faults


def _closest_match(name: str, known: Sequence[str]) -> str | None:
    # Names with a prefix belong to other programs.
    if name in known or ":" in name:
        return None
    close = difflib.get_close_matches(name.lower()[:80], known, n=1, cutoff=SIMILARITY)
    return close[0] if close else None


def read_urdf(
    path: Path, package_dirs: Sequence[Path] = (), root: Element | None = None
) -> UrdfDescription:
    """Read a URDF file, or its root element; the folders resolve ``package://``.

    Raises:
        RobotLoadError: If the file is not a URDF file or inconsistent, has a joint with
            several degrees of freedom, or refers to a missing mesh.
    """
    root = read_xml(path) if root is None else root
    return _UrdfReader(root, XmlContext(path, tuple(package_dirs))).read()


def read_parsed(
    parsed: Any, path: Path, package_dirs: Sequence[Path] = ()
) -> UrdfDescription:
    """Convert a robot that yourdfpy has read or built, by way of its XML.

    Args:
        parsed: A ``yourdfpy.URDF``.
        path: Its file or a name for it; names of meshes are relative to it.
        package_dirs: Folders in which ``package://`` is resolved.

    Raises:
        RobotLoadError: As raised by :func:`read_urdf`.
    """
    root = fromstring(parsed.write_xml_string())
    for element, joint in zip(root.iter("joint"), parsed.robot.joints, strict=True):
        # The XML writer of yourdfpy omits these elements.
        for tag in ("mimic", "safety_controller"):
            field = getattr(joint, tag)
            if field is not None:
                values = {k: v for k, v in vars(field).items() if v is not None}
                add(element, tag, **values)
    return read_urdf(path, package_dirs, root)


class _UrdfReader:
    """Checks the elements of a file, and converts the robot that yourdfpy makes.

    Visual meshes that are missing are dropped: they do not affect motions. Collision
    meshes are required.
    """

    def __init__(self, root: Element, context: XmlContext) -> None:
        self.root, self.context = root, context
        # Materials may be defined anywhere, and be referred to by name.
        self.materials: dict[str, Element] = {}
        for element in root.iter("material"):
            if len(element):
                self.materials.setdefault(element.get("name", ""), element)
        kinds = (EMPTY, UNSEEN, UNREAD, SOFT_LIMITS, IN_DEGREES)
        #: Joints, shapes and names by the remarks about them.
        self.remarks: dict[str, list[str]] = {kind: [] for kind in kinds}

    def read(self) -> UrdfDescription:
        """Read the file.

        Raises:
            RobotLoadError: As raised by :func:`read_urdf`.
        """
        root, context = self.root, self.context
        if root.tag != "robot":
            context.fail(f"is not a URDF file: its root is <{root.tag}>, not <robot>")
        if root.find("link") is None:
            context.fail("is not a URDF file: it has no <link>")
        self.remarks[UNREAD] += _misspellings(root, "robot")
        name = root.get("name", "").strip() or context.path.stem
        copy = Element("robot", name=name)
        for where, link in self._named("link").items():
            self._add_shapes(self._add(copy, link, where), link, where)
        for where, joint in self._named("joint").items():
            self._add(copy, joint, where)
        # The import takes a second, and is needed only to read a file.
        import yourdfpy

        only_text = {"build_scene_graph": False, "load_meshes": False}
        robot = yourdfpy.URDF.load(BytesIO(tostring(copy)), **only_text).robot
        gravity = None
        own = root.find("tominpmp[@gravity]")
        if own is not None:
            gravity = context.numbers(own, "gravity", "robot", _ZEROS)
        description = UrdfDescription(
            name=robot.name,
            bodies=tuple(map(self._link, robot.links, root.findall("link"))),
            tree=tuple(map(self._joint, robot.joints, root.findall("joint"))),
            gravity=gravity,
            path=context.path,
            package_dirs=context.folders,
        )
        _check_tree(description)
        warn_of(self.remarks, context.path)
        return description

    # -- copy for yourdfpy -------------------------------------------------------------

    def _named(self, tag: str) -> dict[str, Element]:
        """Links or joints by their names in messages; names must be unique."""
        # Joints of a <transmission> or <gazebo> are not children of the root.
        elements, named = self.root.findall(tag), dict[str, Element]()
        if len(elements) > MAX_LINKS:
            self.context.fail(
                f"has {len(elements)} {tag}s, at most {MAX_LINKS} are read"
            )
        for number, element in enumerate(elements, 1):
            name = self.context.text(element, "name", f"{tag} number {number}")
            where = f"{tag} {name}"
            if where in named:
                self.context.fail(f"there are two {tag}s named {brief(name)}")
            named[where] = element
        return named

    def _add(self, parent: Element, element: Element, where: str) -> Element:
        """Add a copy of an element with the content of its form."""
        context, tag = self.context, element.tag
        is_fixed = tag == "joint" and element.get("type", "").strip() == "fixed"
        form = FORMS["fixed joint" if is_fixed else tag]
        values: dict[str, Any] = {
            name: context.text(element, name, where) for name in form.texts
        }
        for name, default in form.numbers.items():
            bounds = default, form.low, form.most
            numbers = context.numbers(element, name, where, *bounds)
            if tag == "mesh" and 0.0 in numbers:
                context.fail(
                    f"{where}: mesh {name}={list(numbers)}, expected none to be zero"
                )
            values[name] = numbers
        if tag in ("link", "joint", "inertial"):
            self.remarks[UNREAD] += _misspellings(element, where)
        copy = add(parent, tag, **values)
        for child_tag in (*form.needs, *form.parts, *form.optional):
            child = element.find(child_tag)
            if child is None and child_tag in form.needs:
                holder = "" if "name" in form.texts else f": <{tag}>"
                context.fail(f"{where}{holder} lacks <{child_tag}>")
            if child is None and child_tag in form.parts:
                child = Element(child_tag)
            if child is not None:
                self._add(copy, child, where)
        return copy

    def _add_shapes(self, parent: Element, link: Element, where: str) -> None:
        """Add the collision and visual shapes of a link, each with its kind as name.

        Capsules become cylinders.
        """
        capsules = {c.get("name") for c in link.findall("collision_checking/capsule")}
        for tag in ("collision", "visual"):
            for number, item in enumerate(link.findall(tag), 1):
                place = f"{where}, {tag} {number}"
                copy = self._add(parent, item, place)
                shapes = item.findall("geometry[1]/*")
                if len(shapes) != 1 or shapes[0].tag not in SHAPES:
                    found = ", ".join(f"<{shape.tag}>" for shape in shapes) or "nothing"
                    self.context.fail(
                        f"{place}: <geometry> has {found}, expected one of "
                        f"{', '.join(SHAPES)}"
                    )
                shape = self._add(add(copy, "geometry"), shapes[0], place)
                named = tag == "collision" and item.get("name") in capsules
                is_capsule = named and shape.tag == "cylinder"
                copy.set("name", "capsule" if is_capsule else shape.tag)
                if shape.tag == "capsule":  # yourdfpy has none
                    shape.tag = "cylinder"

    # -- links -------------------------------------------------------------------------

    def _link(self, link: Any, element: Element) -> LinkDescription:
        name, inertial = link.name, link.inertial
        collisions = self._shapes(link.collisions, element, f"link {name}", "collision")
        visuals = self._shapes(link.visuals, element, f"link {name}", "visual")
        if inertial is None:
            return LinkDescription(name, collisions=collisions, visuals=visuals)
        turn, com = inertial.origin[:3, :3], inertial.origin[:3, 3]
        moments = turn @ inertial.inertia @ turn.T
        return LinkDescription(name, inertial.mass, com, moments, collisions, visuals)

    def _shapes(
        self, items: Iterable[Any], link: Element, where: str, tag: str
    ) -> tuple[Shape, ...]:
        """Collision shapes, or visual shapes with existing meshes."""
        shapes = []
        elements = zip(items, link.findall(tag), strict=True)
        for number, (item, element) in enumerate(elements, 1):
            shape = self._shape(item, f"{where}, {tag} {number}", seen=tag == "visual")
            material = element.find("material")
            if tag == "visual" and shape is not None and material is not None:
                shape = self._coloured(shape, material)
            shapes.append(shape)
        return tuple(filter(None, shapes))

    def _shape(self, item: Any, where: str, *, seen: bool) -> Shape | None:
        """A shape; None if its sizes are zero, or its visual mesh is missing."""
        kind, geometry, place = item.name, item.geometry, item.origin
        if kind == "mesh":
            return self._mesh(geometry.mesh, place, where, seen=seen)
        held = geometry.box or geometry.sphere or geometry.cylinder
        sizes = np.hstack([getattr(held, name) for name in SIZES[kind]])
        shape = solid(kind, sizes, place)
        if shape is None:
            self.remarks[EMPTY].append(where)
        return shape

    def _mesh(self, mesh: Any, place: Array, where: str, *, seen: bool) -> Shape | None:
        """A mesh with the path of its file; None for a missing visual mesh."""
        context, name = self.context, mesh.filename
        path, tried = self._find(name)
        if path is None and seen:
            self.remarks[UNSEEN].append(f"{where} ({shortened(repr(name))})")
            return None
        if path is None:
            context.fail(f"{where}: the mesh {missing_resource(name, tried)}")
        if path.stat().st_size > MAX_MESH_BYTES:
            context.fail(
                f"{where}: the mesh {path} has more than {MAX_MESH_BYTES} bytes"
            )
        return Shape("mesh", tuple(mesh.scale.tolist()), place, str(path.absolute()))

    def _find(self, name: str) -> tuple[Path | None, tuple[Path, ...]]:
        """File that the description refers to, and the paths tried."""
        return resolve_resource(name, self.context.path, self.context.folders)

    def _coloured(self, shape: Shape, material: Element) -> Shape:
        """Add colour and texture; as they are cosmetic, invalid ones are dropped."""
        if not len(material):
            material = self.materials.get(material.get("name", ""), material)
        color, texture = material.find("color"), material.find("texture")
        words = () if color is None else color.get("rgba", "").split()
        rgba = tuple(map(to_number_or_nan, words))
        known = len(rgba) == 4 and all(0.0 <= part <= 1.0 for part in rgba)
        file = "" if texture is None else texture.get("filename", "")
        found = str(self._find(file)[0] or "") if file else ""
        if not known and not found:
            return shape
        return replace(shape, colour=rgba if known else BLACK, texture=found)

    # -- joints ------------------------------------------------------------------------

    def _joint(self, joint: Any, element: Element) -> JointDescription:
        """A joint, with limits, friction and mimic relation if it can move."""
        context, where, kind = self.context, f"joint {joint.name}", joint.type
        ends = joint.parent, joint.child, joint.origin
        if kind == "fixed":
            return JointDescription(joint.name, kind, *ends)
        if kind not in ("revolute", "continuous", "prismatic"):
            context.fail(
                f"{where} has the type {brief(kind)}; only revolute, continuous and "
                "prismatic joints can be planned for: make it fixed"
            )
        norm = np.linalg.norm(joint.axis)
        if norm < 1e-6:
            axis = tuple(joint.axis.tolist())
            context.fail(f"{where}: the axis {axis} has no direction")
        self._collect_soft_limits(joint, element.find("safety_controller"))
        limits, bounds = dict(vars(joint.limit)), (_UNKNOWN, -math.inf, math.inf)
        own = next(element.iterfind("limit"), Element("limit"))
        for key in MOTION:
            name = key if key in own.attrib else f"drake:{key}"
            (limits[key],) = context.numbers(own, name, where, *bounds)
        for key, value in limits.items():
            if key not in ("lower", "upper") and value < 0.0:
                context.fail(f"{where}: limit {key}={value:g} is negative")
        limits = {key: limit_or_infinity(value) for key, value in limits.items()}
        lower, upper = limits["lower"], limits["upper"]
        if kind == "continuous":
            lower, upper = -math.inf, math.inf
        elif math.isnan(lower) != math.isnan(upper):
            # By the specification a missing limit is zero; two missing limits are an
            # omission.
            lower, upper = (0.0 if math.isnan(x) else x for x in (lower, upper))
        # Zero stands for no limit.
        acceleration, jerk = (
            min((limits[key] for key in keys if limits[key] > 0.0), default=math.inf)
            for keys in (MOTION[:2], MOTION[2:])
        )
        leader = joint.mimic
        return JointDescription(
            joint.name,
            kind,
            *ends,
            joint.axis / norm,
            lower,
            upper,
            limits["velocity"],
            np.array([-limits["effort"], limits["effort"]]),
            # yourdfpy stores these as text.
            float(joint.dynamics.damping),
            float(joint.dynamics.friction),
            leader and Mimic(leader.joint, leader.multiplier, leader.offset),
            acceleration=acceleration,
            jerk=jerk,
        )

    def _collect_soft_limits(self, joint: Any, safety: Element | None) -> None:
        """Collect joints with soft limits inside their limits, or limits in degrees."""
        name, kind = joint.name, joint.type
        least, most = joint.limit.lower, joint.limit.upper
        ends = [abs(x) for x in (least, most) if not math.isnan(x)]
        if kind == "revolute" and MANY_TURNS <= max(ends, default=0.0) <= MOST_TURNS:
            self.remarks[IN_DEGREES].append(name)
        # Missing limits are NaN, for which these comparisons are false.
        soft = {} if safety is None else safety.attrib
        lower = to_number_or_nan(soft.get("soft_lower_limit", ""))
        upper = to_number_or_nan(soft.get("soft_upper_limit", ""))
        is_within = lower > least + SOFT_TOLERANCE or upper < most - SOFT_TOLERANCE
        # Equal soft limits were omitted: both are zero by the specification.
        if kind != "continuous" and lower < upper and is_within:
            self.remarks[SOFT_LIMITS].append(name)


def _check_tree(description: UrdfDescription) -> None:
    """Check that the joints form one tree of the links, and that leaders exist."""
    links, joints = description.links, description.tree
    names = [joint.name for joint in joints]
    above: dict[str, JointDescription] = {}
    for joint in joints:
        for end in ("parent", "child"):
            link = getattr(joint, end)
            if link not in links:
                description.fail(
                    f"joint {joint.name}: its {end} link {brief(link)} does not exist"
                )
        if joint.child in above:
            description.fail(
                f"link {joint.child} is the child of two joints, "
                f"{above[joint.child].name} and {joint.name}: closed loops are not "
                "supported"
            )
        above[joint.child] = joint
        if joint.mimic is not None and joint.mimic.leader not in names:
            description.fail(
                f"joint {joint.name} follows {brief(joint.mimic.leader)}, which is "
                "not a joint"
            )
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        description.fail(
            f"has {len(roots)} links without a parent joint, expected one: "
            f"{', '.join(roots[:10])}"
        )
    try:
        TopologicalSorter({joint.child: [joint.parent] for joint in joints}).prepare()
    except CycleError as error:
        loop = [name for name in links if name in error.args[1]]
        description.fail(f"the links {', '.join(loop[:10])} form a loop without a base")


# Number written for no limit; readers take numbers of this size for no limit.
NO_LIMIT = 1e16


def urdf_file(
    description: UrdfDescription, without: Collection[str], stem: str
) -> tuple[bytes, dict[str, bytes]]:
    """Write a description as a URDF file.

    Args:
        description: The description.
        without: Names of links to leave out, each fixed to another link: payloads.
        stem: Beginning of the names of its mesh files.

    Returns:
        The file, and the mesh files to be written next to it, by name.
    """
    root, files = Element("robot", name=description.name), dict[str, bytes]()
    for link in description.bodies:
        if link.name not in without:
            _add_link(root, link, stem, files)
    for joint in description.tree:
        if joint.child not in without:
            _add_joint(root, joint)
    if description.gravity is not None:
        add(root, "tominpmp", gravity=description.gravity)
    return xml_text(root), files


def _add_link(
    root: Element, link: LinkDescription, stem: str, files: dict[str, bytes]
) -> None:
    """Add a link, and the files of its meshes that have none yet."""
    element = add(root, "link", name=link.name)
    if link.mass is not None:
        inertial = add(element, "inertial")
        add(inertial, "origin", xyz=link.com)
        add(inertial, "mass", value=link.mass)
        moments = link.inertia[np.triu_indices(3)]
        add(inertial, "inertia", **dict(zip(_MOMENTS, moments, strict=True)))
    for tag, shapes in (("collision", link.collisions), ("visual", link.visuals)):
        for shape in shapes:
            item = add(element, tag)
            _add_origin(item, shape.placement)
            _add_shape(add(item, "geometry"), shape, stem, files)
            if shape.colour is not None:
                material = add(item, "material", name="")
                add(material, "color", rgba=shape.colour)
                if shape.texture:
                    add(material, "texture", filename=shape.texture)


def _add_shape(
    element: Element, shape: Shape, stem: str, files: dict[str, bytes]
) -> None:
    """Add a shape, and the file of its mesh if that has none yet."""
    if shape.kind != "mesh":
        sizes = iter(shape.sizes)
        counts = SIZES[shape.kind].items()
        named = {name: [*islice(sizes, count)] for name, count in counts}
        add(element, shape.kind, **named)
        return
    item = add(element, "mesh", scale=shape.sizes, filename=shape.file)
    if shape.corners is not None and shape.faces is not None:
        content = _stl(shape.corners, shape.faces)
        file = f"{stem}_{hashlib.sha256(content).hexdigest()[:32]}.stl"
        item.set("filename", file)
        files[file] = content


def _stl(corners: Array, faces: IntArray) -> bytes:
    """Binary STL file of a triangle mesh."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("z", "<u2")])
    rows = np.zeros(len(faces), dtype=record)
    rows["corners"] = corners[faces]
    return bytes(80) + len(faces).to_bytes(4, "little") + bytes(rows.tobytes())


def _add_origin(element: Element, placement: Array) -> None:
    """Add a placement, exact up to rounding even for a pitch of 90 degrees."""
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
    names = ["velocity"]
    names += [k for k in ("acceleration", "jerk") if getattr(joint, k) < math.inf]
    if joint.kind != "continuous":
        names += ["lower", "upper"]
    values = {k: getattr(joint, k) for k in names} | {"effort": joint.in_file.effort[1]}
    known = ((k, v) for k, v in values.items() if not np.isnan(v))
    add(element, "limit", **{k: np.clip(v, -NO_LIMIT, NO_LIMIT) for k, v in known})
    add(element, "dynamics", damping=joint.damping, friction=joint.friction)
    if joint.mimic is not None:
        own = joint.mimic
        ratio, offset = own.multiplier, own.offset
        add(element, "mimic", joint=own.leader, multiplier=ratio, offset=offset)
