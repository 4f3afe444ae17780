"""Warnings of inertia that a description leaves out, of what its joints move."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from tominpmp.exceptions import warn_caller

# Moments below this share of mass times a square metre are none, and are negative or
# break the triangle inequality if they do so by this share of the largest.
POINT = 1e-9
NEGATIVE = 1e-6
TRIANGLE = 1e-2
# Joints in one place: with links between them that only name them [m].
TOGETHER = 1e-2
# Joints that a warning names.
MOST = 5


def warn_of_inertia(model: pin.Model, xml: str, path: Path) -> None:
    """Warn of moving joints that carry links without mass, or of none that can be.

    Links fixed to each other are one body, so that frames without mass, as of tools and
    bases, do no harm; nor do those that stand between joints in one place.
    """
    shaped = {
        link.get("name", "")
        for link in ElementTree.fromstring(xml).iter("link")
        if link.find("visual") is not None or link.find("collision") is not None
    }
    found = [
        f"{_named(_links(model, joint))} behind joint {model.names[joint]} {fault}"
        for joint in range(1, model.njoints)
        if (fault := _fault(model, joint, shaped)) is not None
    ]
    if not found:
        return
    rest = f"; and {len(found) - MOST} more" if len(found) > MOST else ""
    warn_caller(
        f"{path}: {'; '.join(found[:MOST])}{rest}. The torques that their joints need "
        "come out wrong, mostly too small, and motions too fast for the arm: mend the "
        "<inertial> elements"
    )


def _fault(model: pin.Model, joint: int, shaped: set[str]) -> str | None:
    """What is wrong with the body behind a joint, in a clause."""
    inertia = model.inertias[joint]
    if not inertia.mass > 0.0:
        return None if _virtual(model, joint, shaped) else "has no mass"
    small, middle, large = np.linalg.eigvalsh(np.asarray(inertia.inertia)).tolist()
    if large <= POINT * inertia.mass:
        return "has no moments of inertia, as if it were a point"
    if small < -NEGATIVE * large:
        return f"has a negative moment of inertia ({small:.2g} kg m^2)"
    if small + middle < (1.0 - TRIANGLE) * large:
        return (
            f"has moments of inertia that no body has ({small:.2g} + {middle:.2g} < "
            f"{large:.2g} kg m^2)"
        )
    return None


def _virtual(model: pin.Model, joint: int, shaped: set[str]) -> bool:
    """Whether links have no shape and only stand between joints in one place."""
    carried = [k for k in range(1, model.njoints) if int(model.parents[k]) == joint]
    if not carried or shaped.intersection(_links(model, joint)):
        return False
    apart = [np.linalg.norm(model.jointPlacements[k].translation) for k in carried]
    return bool(np.max(apart) <= TOGETHER)


def _links(model: pin.Model, joint: int) -> list[str]:
    """Names of the links of the body behind a joint."""
    return [
        str(frame.name)
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and int(frame.parentJoint) == joint
    ]


def _named(links: Sequence[str]) -> str:
    """One link, or some that are fixed to each other."""
    if len(links) < 2:
        return f"link {''.join(links)}"
    return f"link {links[0]} with what is fixed to it ({', '.join(links[1:3])})"
