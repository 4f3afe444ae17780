"""What a URDF file must look like: checked by name, and copied for yourdfpy.

yourdfpy reads what the specification has, but does not say which joint and which field
is wrong, stumbles over the remains of other programs, and knows no capsules and no
limits of acceleration and jerk. So it gets a copy that holds nothing but what is read,
in which every number is one. What a file says beyond that is warned of, as far as it
would change a motion.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement

from tominpmp.description.xml_reader import XmlContext, to_number
from tominpmp.exceptions import warn_caller

# The parsers recurse into the tree; humanoids have some hundred links.
MAX_LINKS = 2000
SHAPES = ("box", "cylinder", "capsule", "sphere", "mesh")
# How collision shapes are named in the copy that are capsules.
CAPSULE = "capsule"
# Limits that yourdfpy does not read.
MOTION = ("acceleration", "deceleration", "jerk")


class Form(NamedTuple):
    """What an element may hold; whatever else it holds is passed over.

    Attributes:
        texts: Attributes that must be there.
        numbers: Attributes of numbers, with their count.
        low: What no number may be below.
        limits: Attributes that may be infinite.
        hints: Numbers for other programs: wrong ones are passed over.
        needs: Children that must be there.
        may: Children that may be there; of several the first counts.
    """

    texts: Sequence[str] = ()
    numbers: Mapping[str, int] = {}
    low: float | None = None
    limits: Sequence[str] = ()
    hints: Sequence[str] = ()
    needs: Sequence[str] = ()
    may: Sequence[str] = ()


_ROD = Form(("radius", "length"), {"radius": 1, "length": 1})
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
FORMS = {
    "link": Form(("name",), may=("inertial",)),
    "inertial": Form(needs=("mass",), may=("origin", "inertia")),
    "mass": Form(numbers={"value": 1}, low=0.0),
    # No check of the sign: rounding leaves moments of -1e-20, and whether the robot as
    # a whole has inertia is checked on its mass matrix.
    "inertia": Form(numbers=dict.fromkeys(_MOMENTS, 1)),
    "collision": Form(may=("origin",)),
    "visual": Form(may=("origin",)),
    "box": Form(("size",), {"size": 3}),
    "cylinder": _ROD,
    "capsule": _ROD,
    "sphere": Form(("radius",), {"radius": 1}),
    "mesh": Form(("filename",), {"scale": 3}),
    "joint": Form(
        ("name", "type"),
        needs=("parent", "child"),
        may=("origin", "axis", "limit", "dynamics", "mimic", "safety_controller"),
    ),
    "fixed joint": Form(("name", "type"), needs=("parent", "child"), may=("origin",)),
    "parent": Form(("link",)),
    "child": Form(("link",)),
    "origin": Form(numbers={"xyz": 3, "rpy": 3}),
    "axis": Form(numbers={"xyz": 3}),
    "limit": Form(limits=("lower", "upper", "velocity", "effort", *MOTION)),
    "dynamics": Form(numbers={"damping": 1, "friction": 1}, low=0.0),
    "mimic": Form(("joint",), {"multiplier": 1, "offset": 1}),
    "safety_controller": Form(hints=("soft_lower_limit", "soft_upper_limit")),
}

# What is compared with what a file has: other names mean something to other programs,
# unless they are nearly these.
CHILDREN = ("limit", "dynamics", "mimic", "origin", "axis", "mass")
KNOWN = {
    "robot": ("link", "joint", "material"),
    "link": ("inertial", "visual", "collision"),
    **{tag: (*FORMS[tag].needs, *FORMS[tag].may) for tag in ("joint", "inertial")},
}
# How alike a name must be to be taken for a mistake, from 0 to 1.
ALIKE = 0.8
# Soft limits this little within the limits are on them [rad or m].
SLIGHT = 1e-9
# Beyond as many places a warning names no more.
MOST = 10

# Limits of joints that turn within which nobody gives radians: five to 115 turns.
MANY_TURNS, DEGREES = 30.0, 720.0


def write_numbers(element: Element, attribute: str, values: Iterable[float]) -> None:
    """Write numbers so that every parser reads exactly them."""
    element.set(attribute, " ".join(repr(float(value)) for value in values))


def checked_copy(root: Element, context: XmlContext) -> Element:
    """Copy what is read, with capsules as cylinders that are named ``CAPSULE``.

    Raises:
        RobotLoadError: If something is missing, or is no number.
    """
    # Joints of a <transmission> or <gazebo> are not children of the root.
    links, joints = root.findall("link"), root.findall("joint")
    if not links:
        context.fail("is no URDF file: it has no <link>")
    for items in (links, joints):
        if len(items) > MAX_LINKS:
            context.fail(
                f"has {len(items)} {items[0].tag}s, at most {MAX_LINKS} are read"
            )
    # Colours may be defined anywhere, and be used by their name.
    materials: dict[str, Element] = {}
    for element in root.iter("material"):
        if len(element):
            materials.setdefault(element.get("name", ""), element)
    copy = Element("robot", name=root.get("name", "").strip() or context.path.stem)
    for i, link in enumerate(links, 1):
        name = context.text(link, "name", f"link number {i}")
        copy.append(_link(name, link, context, materials))
    for i, joint in enumerate(joints, 1):
        name = context.text(joint, "name", f"joint number {i}")
        kind = context.text(joint, "type", f"joint {name}")
        form = FORMS["fixed joint" if kind == "fixed" else "joint"]
        copy.append(_copied(joint, f"joint {name}", context, form))
    return copy


def _copied(
    element: Element, where: str, context: XmlContext, form: Form | None = None
) -> Element:
    """Copy an element with what its form has."""
    tag = element.tag
    form = FORMS[tag] if form is None else form
    copy = Element(tag)
    for name in form.texts:
        copy.set(name, context.text(element, name, where))
    for name in element.attrib:
        if name in form.numbers:
            zeros = (0.0,) * form.numbers[name]
            numbers = context.numbers(element, name, where, zeros, form.low)
            write_numbers(copy, name, numbers)
        elif name in form.limits:
            write_numbers(copy, name, [context.limit(element, name, where)])
        elif name in form.hints and _is_number(element.attrib[name]):
            copy.set(name, element.attrib[name])
    for child_tag in (*form.needs, *form.may):
        child = element.find(child_tag)
        if child is not None:
            copy.append(_copied(child, where, context))
        elif child_tag in form.needs:
            holder = "" if "name" in form.texts else f": <{tag}>"
            context.fail(f"{where}{holder} lacks <{child_tag}>")
    return copy


def _link(
    name: str,
    link: Element,
    context: XmlContext,
    materials: Mapping[str, Element],
) -> Element:
    copy = _copied(link, f"link {name}", context)
    for inertia in copy.iter("inertia"):
        for moment in _MOMENTS:
            inertia.attrib.setdefault(moment, "0")  # yourdfpy takes 1 for some
    capsules = {c.get("name") for c in link.findall("collision_checking/capsule")}
    for tag in ("collision", "visual"):
        for i, old in enumerate(link.findall(tag)):
            where = f"link {name}, {tag} {i + 1}"
            new = _copied(old, where, context)
            shape = _shape(old, where, context)
            named = shape.tag == "cylinder" and old.get("name") in capsules
            if tag == "collision" and (shape.tag == "capsule" or named):
                new.set("name", CAPSULE)
            if shape.tag == "capsule":
                shape.tag = "cylinder"
            SubElement(new, "geometry").append(shape)
            material = old.find("material")
            if material is not None:
                defined = materials.get(material.get("name", ""), material)
                new.append(_material(material if len(material) else defined))
            copy.append(new)
    return copy


def _shape(item: Element, where: str, context: XmlContext) -> Element:
    """Copy the one shape of a <collision> or <visual>."""
    shapes = item.findall("geometry[1]/*")
    if len(shapes) != 1 or shapes[0].tag not in SHAPES:
        found = ", ".join(f"<{shape.tag}>" for shape in shapes) or "nothing"
        context.fail(
            f"{where}: <geometry> has {found}, expected one of {', '.join(SHAPES)}"
        )
    copy = _copied(shapes[0], where, context)
    for name in FORMS[copy.tag].numbers:
        sizes = [float(word) for word in copy.get(name, "1").split()]
        if copy.tag == "mesh" and 0.0 in sizes:
            context.fail(f"{where}: mesh {name}={sizes}, expected none to be zero")
        if copy.tag != "mesh" and min(sizes) <= 0.0:
            context.fail(
                f"{where}: {copy.tag} {name}={shapes[0].get(name)!r}, expected numbers "
                "greater than zero"
            )
    return copy


def _material(element: Element) -> Element:
    """Copy a colour and texture; these are looks, so what is wrong is left out."""
    copy = Element("material")
    color, texture = element.find("color"), element.find("texture")
    rgba = "" if color is None else color.get("rgba", "")
    words = rgba.split()
    if len(words) == 4 and all(_is_number(x) and 0 <= float(x) <= 1 for x in words):
        SubElement(copy, "color", rgba=rgba)
    if texture is not None and texture.get("filename"):
        SubElement(copy, "texture", filename=texture.get("filename", ""))
    return copy


def _is_number(text: str) -> bool:
    return not math.isnan(to_number(text))


def warn_of_unread(root: Element, joints: Sequence[Any], context: XmlContext) -> None:
    """Warn of likely mistakes, and of soft limits within the limits.

    Controllers may keep a ``<safety_controller>``'s soft limits; they are not read.
    """
    told = _mistakes(root, "robot")
    for element in (*root.findall("link"), *root.findall("joint")):
        where = f"{element.tag} {element.get('name', '').strip()}"
        told += _mistakes(element, where)
        for inertial in element.findall("inertial"):
            told += _mistakes(inertial, where)
    if told:
        warn_caller(f"{context.path}: not read: {'; '.join(told[:MOST])}")
    soft = _first_names(filter(_is_softer, joints))
    if soft:
        warn_caller(
            f"{context.path}: <safety_controller>: soft limits within the position "
            f"limits are not kept: {soft}; give position_lower and position_upper "
            "where a controller keeps them"
        )
    turned = _first_names(filter(_is_in_degrees, joints))
    if turned:
        warn_caller(
            f"{context.path}: position limits of many turns, which look like degrees: "
            f"{turned}; a URDF file has radians"
        )


def _first_names(joints: Iterable[Any]) -> str:
    names = [joint.name for joint in joints]
    return ", ".join(names[:MOST]) + (", ..." if len(names) > MOST else "")


def _is_in_degrees(joint: Any) -> bool:
    """Whether the limits of a joint that turns are those of most arms in degrees."""
    if joint.type != "revolute" or joint.limit is None:
        return False
    ends = [abs(x) for x in (joint.limit.lower, joint.limit.upper) if x is not None]
    return MANY_TURNS <= max(ends, default=0.0) <= DEGREES


def _mistakes(element: Element, where: str) -> list[str]:
    """Names of children, and of their attributes, that are nearly those read."""
    found = []
    for child in element:
        meant = _nearly(child.tag, KNOWN[element.tag])
        if meant:
            found.append(f"<{child.tag}> of {where} (did you mean <{meant}>?)")
        form = FORMS[child.tag] if child.tag in CHILDREN else Form()
        for name in child.attrib:
            meant = _nearly(name, (*form.texts, *form.numbers, *form.limits))
            if meant:
                found.append(
                    f"the attribute {name!r} of <{child.tag}> of {where} (did you mean "
                    f"{meant!r}?)"
                )
    return found


def _nearly(name: str, known: tuple[str, ...]) -> str | None:
    if name in known:
        return None
    close = difflib.get_close_matches(name.lower()[:80], known, n=1, cutoff=ALIKE)
    return close[0] if close else None


def _is_softer(joint: Any) -> bool:
    """Whether a joint that has ends has soft limits within its limits."""
    soft, hard = joint.safety_controller, joint.limit
    if soft is None or hard is None or joint.type not in ("revolute", "prismatic"):
        return False
    ends = (soft.soft_lower_limit, soft.soft_upper_limit, hard.lower, hard.upper)
    # What is left out is neither more nor less than anything.
    lower, upper, least, most = (math.nan if x is None else x for x in ends)
    # Two that are alike were left out, which the specification takes for zero.
    return lower < upper and (lower > least + SLIGHT or upper < most - SLIGHT)
