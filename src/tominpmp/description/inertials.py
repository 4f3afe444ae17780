"""Inertia of what the joints of a description move: left out, or of no body at all.

What counts is the body that a joint moves: links fixed to each other are one, so that
frames without mass, as of tools and bases, do no harm.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.description.tree import UrdfDescription
from tominpmp.exceptions import warn_caller

# Moments below this share of mass times a square metre are none.
POINT = 1e-9
# By this share of the largest moment the other two may fall short of it together: in
# three digits those of flat bodies do by 0.995 %, and none of their moments falls below
# zero by more.
ROUNDED = 1e-2
# Joints in one place: with links between them that only name them [m].
TOGETHER = 1e-2
# Joints that a warning names.
MOST = 5


def warn_of_inertia(model: pin.Model, description: UrdfDescription) -> None:
    """Warn of moving joints that carry links without mass, or of none that can be.

    Frames between joints in one place need no mass.
    """
    shaped = {
        link.name for link in description.bodies if link.collisions or link.visuals
    }
    every = range(1, model.njoints)
    found = impossible_bodies(model) | {
        joint: f"{named_body(model, joint)} {fault}"
        for joint in every
        if (fault := _lack(model, joint, shaped)) is not None
    }
    if found:
        told = listed([found[joint] for joint in every if joint in found])
        warn_caller(f"{description.path}: {told}: mend the <inertial> elements")


def listed(faults: Sequence[str]) -> str:
    """Faults of bodies, and what follows from them."""
    shown = "; ".join(faults[:MOST])
    rest = f"; and {len(faults) - MOST} more" if len(faults) > MOST else ""
    return (
        f"{shown}{rest}. The torques that their joints need come out wrong, mostly too "
        "small, and motions too fast for the arm"
    )


def impossible_bodies(model: pin.Model) -> dict[int, str]:
    """By joint whose body has an inertia that no body has what is wrong with it."""
    found = {}
    for joint in range(1, model.njoints):
        inertia, fault = model.inertias[joint], None
        if inertia.mass < 0.0:
            fault = f"has a mass of {inertia.mass:.3g} kg, expected none below 0"
        elif not _is_point(inertia):
            fault = impossible_moments(inertia.inertia)
        if fault is not None:
            found[joint] = f"{named_body(model, joint)} {fault}"
    return found


def impossible_moments(tensor: Array) -> str | None:
    """What no body has of an inertia, in a clause; None where a body can have it.

    Args:
        tensor: Inertia about the centre of mass, shape (3, 3) [kg m^2].
    """
    small, middle, large = np.linalg.eigvalsh(tensor).tolist()
    # A moment below zero leaves the middle one too small for the largest.
    if small + middle >= (1.0 - ROUNDED) * large:
        return None
    return (
        f"has the principal moments {small:.3g}, {middle:.3g} and {large:.3g} kg m^2, "
        "expected none below 0 or above the sum of the other two"
    )


def _lack(model: pin.Model, joint: int, shaped: set[str]) -> str | None:
    """What the body behind a joint is without, in a clause."""
    inertia = model.inertias[joint]
    if inertia.mass == 0.0 and not _virtual(model, joint, shaped):
        return "has no mass"
    if inertia.mass > 0.0 and _is_point(inertia):
        return "has no moments of inertia, as if it were a point"
    return None


def _is_point(inertia: pin.Inertia) -> bool:
    return bool(np.abs(inertia.inertia).max() <= POINT * inertia.mass)


def _virtual(model: pin.Model, joint: int, shaped: set[str]) -> bool:
    """Whether links have no shape and only stand between joints in one place."""
    carried = [k for k in range(1, model.njoints) if int(model.parents[k]) == joint]
    if not carried or shaped.intersection(links_of(model, joint)):
        return False
    apart = [np.linalg.norm(model.jointPlacements[k].translation) for k in carried]
    return bool(np.max(apart) <= TOGETHER)


def links_of(model: pin.Model, joint: int) -> list[str]:
    """Names of the links of the body behind a joint."""
    return [
        str(frame.name)
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and int(frame.parentJoint) == joint
    ]


def named_body(model: pin.Model, joint: int) -> str:
    """The link behind a joint, or some that are fixed to each other."""
    first, *others = links_of(model, joint) or [""]
    fixed = f" with what is fixed to it ({', '.join(others[:2])})" if others else ""
    return f"link {first}{fixed} behind joint {model.names[joint]}"
