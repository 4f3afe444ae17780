"""What a URDF file may say beyond what is read, as far as it would change a motion."""

from __future__ import annotations

import difflib
import math
import warnings
from collections.abc import Mapping
from xml.etree.ElementTree import Element

from tominpmp.description.xml_reader import XmlContext
from tominpmp.exceptions import TominpmpWarning

# Elements and attributes that are read; others mean something to other programs, unless
# they are nearly these: then they are mistakes.
ELEMENTS = {
    "robot": ("link", "joint", "material"),
    "link": ("inertial", "visual", "collision"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
    "inertial": ("origin", "mass", "inertia"),
}
ATTRIBUTES = {
    "limit": (
        *("lower", "upper", "velocity", "effort"),
        *("acceleration", "deceleration", "jerk"),
    ),
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


def warn_of_unread(
    root: Element,
    links: Mapping[str, Element],
    joints: Mapping[str, Element],
    context: XmlContext,
) -> None:
    """Warn of likely mistakes, and of soft limits within the limits.

    Controllers may keep a ``<safety_controller>``'s soft limits; they are not read.

    Args:
        root: The file.
        links: Its links by name.
        joints: Its joints by name.
        context: The file, for messages.
    """
    told = _mistakes(root, "robot", "robot")
    for name, link in links.items():
        told += _mistakes(link, "link", f"link {name}")
        for inertial in link.findall("inertial"):
            told += _mistakes(inertial, "inertial", f"link {name}")
    soft = []
    for name, joint in joints.items():
        told += _mistakes(joint, "joint", f"joint {name}")
        if _is_softer(joint):
            soft.append(name)
    if told:
        warnings.warn(
            f"{context.path}: not read: {'; '.join(told[:MOST])}",
            TominpmpWarning,
            stacklevel=5,
        )
    if soft:
        more = ", ..." if len(soft) > MOST else ""
        warnings.warn(
            f"{context.path}: <safety_controller>: soft limits within the position "
            f"limits are not kept: {', '.join(soft[:MOST])}{more}; give position_lower "
            "and position_upper where a controller keeps them",
            TominpmpWarning,
            stacklevel=5,
        )


def _mistakes(element: Element, kind: str, where: str) -> list[str]:
    """Names of children, and of their attributes, that are nearly those read."""
    found = []
    for child in element:
        if not isinstance(child.tag, str):
            continue
        meant = _nearly(child.tag, ELEMENTS[kind])
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


def _nearly(name: str, known: tuple[str, ...]) -> str | None:
    if name in known:
        return None
    close = difflib.get_close_matches(name.lower()[:80], known, n=1, cutoff=ALIKE)
    return close[0] if close else None


def _is_softer(joint: Element) -> bool:
    """Whether a joint that has ends has soft limits within its limits."""
    soft, hard = joint.find("safety_controller"), joint.find("limit")
    ends = joint.get("type") in ("revolute", "prismatic")
    if soft is None or hard is None or not ends:
        return False
    lower, upper = (_number(soft, f"soft_{end}_limit") for end in ("lower", "upper"))
    if not lower < upper:  # left out, which the specification takes for zero
        return False
    return lower > _number(hard, "lower") + SLIGHT or upper < (
        _number(hard, "upper") - SLIGHT
    )


def _number(element: Element, attribute: str) -> float:
    """A number; NaN, which is neither more nor less, if it is none."""
    try:
        return float(element.get(attribute, ""))
    except ValueError:
        return math.nan
