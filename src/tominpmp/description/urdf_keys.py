"""What a URDF file may say beyond what is read, as far as it would change a motion."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from typing import Any
from xml.etree.ElementTree import Element

from tominpmp.description.urdf_syntax import FORMS, Form
from tominpmp.description.xml_reader import XmlContext
from tominpmp.exceptions import warn_caller

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
    soft = [joint.name for joint in joints if _is_softer(joint)]
    if told:
        warn_caller(f"{context.path}: not read: {'; '.join(told[:MOST])}")
    if soft:
        more = ", ..." if len(soft) > MOST else ""
        warn_caller(
            f"{context.path}: <safety_controller>: soft limits within the position "
            f"limits are not kept: {', '.join(soft[:MOST])}{more}; give position_lower "
            "and position_upper where a controller keeps them"
        )
    turned = [joint.name for joint in joints if _is_in_degrees(joint)]
    if turned:
        more = ", ..." if len(turned) > MOST else ""
        warn_caller(
            f"{context.path}: position limits of many turns, which look like degrees: "
            f"{', '.join(turned[:MOST])}{more}; a URDF file has radians"
        )


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
