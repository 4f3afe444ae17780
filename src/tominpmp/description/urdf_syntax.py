"""What a URDF file must look like: checked by name, and copied for yourdfpy.

yourdfpy reads what the specification has, but does not say which joint and which field
is wrong, stumbles over the remains of other programs, and knows no capsules. So it gets
a copy that holds nothing but what is read, in which every number is one, and also those
are written out that the file leaves to their defaults.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

from tominpmp.description.tree import SIZES
from tominpmp.description.xml_reader import XmlContext, add, to_number
from tominpmp.exceptions import brief

# The parsers recurse into the tree; humanoids have some hundred links.
MAX_LINKS = 2000
SHAPES = (*SIZES, "mesh")
# Limits of joints that yourdfpy does not read.
MOTION = ("acceleration", "deceleration", "jerk")
# How alike a name must be to be taken for a mistake, from 0 to 1.
ALIKE = 0.8


class Form(NamedTuple):
    """What is read of an element; whatever else it holds is passed over.

    Attributes:
        texts: Attributes that must be there.
        numbers: Attributes of numbers, with the numbers that stand for those left out.
        low: The least that a number may be.
        limits: Attributes of numbers that may be infinite; NaN stands for those left
            out.
        hints: Numbers for other programs: NaN stands for wrong ones too.
        needs: Children that must be there.
        parts: Children that are written out with their defaults if they are left out.
        may: Children that may be there; of several the first counts.
    """

    texts: Sequence[str] = ()
    numbers: Mapping[str, tuple[float, ...]] = {}
    low: float | None = None
    limits: Sequence[str] = ()
    hints: Sequence[str] = ()
    needs: Sequence[str] = ()
    parts: Sequence[str] = ()
    may: Sequence[str] = ()


_ZERO, _ZEROS = (0.0,), (0.0, 0.0, 0.0)
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
FORMS = {
    "link": Form(("name",), may=("inertial",)),
    "inertial": Form(needs=("mass",), parts=("origin", "inertia")),
    "mass": Form(numbers={"value": _ZERO}, low=0.0),
    # No check of the sign: rounding leaves moments of -1e-20, and whether the robot as
    # a whole has inertia is checked on its mass matrix.
    "inertia": Form(numbers=dict.fromkeys(_MOMENTS, _ZERO)),
    "collision": Form(parts=("origin",)),
    "visual": Form(parts=("origin",)),
    **{
        kind: Form(tuple(sizes), {name: _ZERO * n for name, n in sizes.items()})
        for kind, sizes in SIZES.items()
    },
    "mesh": Form(("filename",), {"scale": (1.0, 1.0, 1.0)}),
    "joint": Form(
        ("name", "type"),
        needs=("parent", "child"),
        parts=("origin", "axis", "limit", "dynamics", "safety_controller"),
        may=("mimic",),
    ),
    "fixed joint": Form(("name", "type"), needs=("parent", "child"), parts=("origin",)),
    "parent": Form(("link",)),
    "child": Form(("link",)),
    "origin": Form(numbers={"xyz": _ZEROS, "rpy": _ZEROS}),
    "axis": Form(numbers={"xyz": (1.0, 0.0, 0.0)}),
    "limit": Form(limits=("lower", "upper", "velocity", "effort")),
    "dynamics": Form(numbers={"damping": _ZERO, "friction": _ZERO}, low=0.0),
    "mimic": Form(("joint",), {"multiplier": (1.0,), "offset": _ZERO}),
    "safety_controller": Form(hints=("soft_lower_limit", "soft_upper_limit")),
}

# What is compared with what a file has: other names mean something to other programs,
# unless they are nearly these.
CHILDREN = {
    "robot": ("link", "joint", "material"),
    "link": ("inertial", "visual", "collision"),
    **{
        tag: (*FORMS[tag].needs, *FORMS[tag].parts, *FORMS[tag].may)
        for tag in ("joint", "inertial")
    },
}
ATTRIBUTES = {
    tag: (*FORMS[tag].texts, *FORMS[tag].numbers, *FORMS[tag].limits)
    for tag in ("dynamics", "mimic", "origin", "axis", "mass", "limit")
}
ATTRIBUTES["limit"] += MOTION


class UrdfChecker:
    """Checks the elements of a file, and copies what is read of them."""

    def __init__(self, root: Element, context: XmlContext) -> None:
        self.root, self.context = root, context
        # Colours may be defined anywhere, and be used by their name.
        self.materials: dict[str, Element] = {}
        for element in root.iter("material"):
            if len(element):
                self.materials.setdefault(element.get("name", ""), element)

    def copy(self) -> Element:
        """The copy: shapes have the names of their kinds, and capsules are cylinders.

        Raises:
            RobotLoadError: If it is no URDF file, or something is missing, is no number
                or has the name of something else.
        """
        self._check_root()
        name = self.root.get("name", "").strip() or self.context.path.stem
        robot = Element("robot", name=name)
        for where, link in self._named("link").items():
            self._add_shapes(self._add(robot, link, where), link, where)
        for where, joint in self._named("joint").items():
            is_fixed = self.context.text(joint, "type", where) == "fixed"
            form = FORMS["fixed joint" if is_fixed else "joint"]
            self._add(robot, joint, where, form)
        return robot

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
        """Links or joints by how messages name them; their names must differ."""
        # Joints of a <transmission> or <gazebo> are not children of the root.
        elements, found = self.root.findall(tag), dict[str, Element]()
        if len(elements) > MAX_LINKS:
            self.context.fail(
                f"has {len(elements)} {tag}s, at most {MAX_LINKS} are read"
            )
        for number, element in enumerate(elements, 1):
            name = self.context.text(element, "name", f"{tag} number {number}")
            where = f"{tag} {name}"
            if where in found:
                self.context.fail(f"there are two {tag}s named {brief(name)}")
            found[where] = element
        return found

    def _add(
        self, parent: Element, element: Element, where: str, form: Form | None = None
    ) -> Element:
        """Add a copy of an element with what its form has."""
        context, tag = self.context, element.tag
        form = FORMS[tag] if form is None else form
        values: dict[str, Any] = {
            name: context.text(element, name, where) for name in form.texts
        }
        for name, default in form.numbers.items():
            numbers = context.numbers(element, name, where, default, form.low)
            if tag in SIZES and min(numbers) <= 0.0:
                context.fail(
                    f"{where}: {tag} {name}={values[name]!r}, expected numbers greater "
                    "than zero"
                )
            if tag == "mesh" and 0.0 in numbers:
                context.fail(
                    f"{where}: mesh {name}={list(numbers)}, expected none to be zero"
                )
            values[name] = numbers
        values |= {name: context.limit(element, name, where) for name in form.limits}
        values |= {name: to_number(element.get(name, "")) for name in form.hints}
        copy = add(parent, tag, **values)
        for child_tag in (*form.needs, *form.parts, *form.may):
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
        """Add the shapes of a link to collide with, and to look at."""
        capsules = {c.get("name") for c in link.findall("collision_checking/capsule")}
        for tag in ("collision", "visual"):
            for number, item in enumerate(link.findall(tag), 1):
                copy = self._add(parent, item, f"{where}, {tag} {number}")
                shape = self._add_shape(copy, item, f"{where}, {tag} {number}")
                named = tag == "collision" and item.get("name") in capsules
                if shape.tag == "cylinder" and named:
                    shape.tag = "capsule"
                copy.set("name", shape.tag)
                if shape.tag == "capsule":
                    shape.tag = "cylinder"
                material = item.find("material")
                if material is not None:
                    self._add_material(copy, material)

    def _add_shape(self, parent: Element, item: Element, where: str) -> Element:
        """Add the one shape of a <collision> or <visual>."""
        shapes = item.findall("geometry[1]/*")
        if len(shapes) != 1 or shapes[0].tag not in SHAPES:
            found = ", ".join(f"<{shape.tag}>" for shape in shapes) or "nothing"
            self.context.fail(
                f"{where}: <geometry> has {found}, expected one of {', '.join(SHAPES)}"
            )
        return self._add(add(parent, "geometry"), shapes[0], where)

    def _add_material(self, parent: Element, material: Element) -> None:
        """Add a colour and texture; these are looks, so what is wrong is left out."""
        if not len(material):
            material = self.materials.get(material.get("name", ""), material)
        copy = add(parent, "material")
        color, texture = material.find("color"), material.find("texture")
        words = () if color is None else color.get("rgba", "").split()
        rgba = tuple(map(to_number, words))
        if len(rgba) == 4 and all(0.0 <= part <= 1.0 for part in rgba):
            add(copy, "color", rgba=rgba)
        if texture is not None and texture.get("filename"):
            add(copy, "texture", filename=texture.get("filename"))


def mistakes(element: Element, where: str) -> list[str]:
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
