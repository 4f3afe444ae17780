"""Inertia that the joints of a description move: missing, or physically impossible.

The relevant body is all that a joint moves: links fixed to each other are one body, so
that massless frames, as of tools and bases, do no harm.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from tominpmp.arrays import Array
from tominpmp.description.joint_table import KINEMATIC, JointTable, example_values
from tominpmp.description.tree import UrdfDescription
from tominpmp.exceptions import enumerated, warn_caller

# Moments below this share of the mass times 1 m^2 count as zero.
POINT = 1e-9
# Relative violation of the triangle inequality of moments that rounding explains: for
# flat bodies three digits violate it by up to 0.995 % of the largest moment, and no
# moment falls below zero by more.
ROUNDED = 1e-2
# Distance of joints that count as coincident, with only nominal links between them [m].
COINCIDENT = 1e-2

# Below these values a mass matrix counts as singular: the smallest diagonal entry [kg
# m^2 or kg], and the smallest eigenvalue once the diagonal is scaled to one. The
# smallest of the robots in example-robot-data are 4e-6 (a finger) and 4e-6 (a
# humanoid).
MIN_INERTIA = 1e-12
MIN_SCALED_INERTIA = 1e-10

# Number of random configurations whose mass matrix is checked.
INERTIA_SAMPLES = 5


def warn_of_inertia(model: pin.Model, description: UrdfDescription) -> None:
    """Warn of moving joints that carry massless or physically impossible links.

    Frames between coincident joints need no mass.
    """
    bodies = description.bodies
    shaped = {link.name for link in bodies if link.collisions or link.visuals}
    faults = [
        f"{_named_body(model, joint)} {fault}"
        for joint in range(1, model.njoints)
        if (fault := _missing(model, joint, shaped) or _impossible(model, joint))
    ]
    if faults:
        found = f"{description.path}: {listed(faults)}"
        warn_caller(f"{found}: correct the <inertial> elements")


def listed(faults: Sequence[str]) -> str:
    """Faults of bodies, with their consequences, in a sentence."""
    return (
        f"{enumerated(faults)}. The torques that their joints need come out wrong, "
        "mostly too small, and motions too fast for the arm"
    )


def _impossible(model: pin.Model, joint: int) -> str | None:
    """Fault of a physically impossible inertia behind a joint, in a clause."""
    inertia = model.inertias[joint]
    if inertia.mass < 0.0:
        return f"has a mass of {inertia.mass:.3g} kg, expected a mass >= 0"
    return None if _is_point(inertia) else impossible_moments(inertia.inertia)


def impossible_moments(tensor: Array) -> str | None:
    """Fault of a physically impossible inertia, in a clause; None if it is possible.

    Args:
        tensor: Inertia about the centre of mass, shape (3, 3) [kg m^2].
    """
    small, middle, large = np.linalg.eigvalsh(tensor).tolist()
    # A negative moment makes the middle one too small for the largest.
    if small + middle >= (1.0 - ROUNDED) * large:
        return None
    return (
        f"has the principal moments {small:.3g}, {middle:.3g} and {large:.3g} kg m^2, "
        "expected moments >= 0, each at most the sum of the other two"
    )


def _missing(model: pin.Model, joint: int, shaped: set[str]) -> str | None:
    """Missing mass or moments of the body behind a joint, in a clause."""
    inertia = model.inertias[joint]
    if inertia.mass == 0.0 and not _virtual(model, joint, shaped):
        return "has no mass"
    if inertia.mass > 0.0 and _is_point(inertia):
        return "has no moments of inertia, as if it were a point"
    return None


def _is_point(inertia: pin.Inertia) -> bool:
    return bool(np.abs(inertia.inertia).max() <= POINT * inertia.mass)


def _virtual(model: pin.Model, joint: int, shaped: set[str]) -> bool:
    """Whether links have no shape and only connect coincident joints."""
    carried = [k for k in range(1, model.njoints) if int(model.parents[k]) == joint]
    if not carried or shaped.intersection(_link_names(model, joint)):
        return False
    apart = [np.linalg.norm(model.jointPlacements[k].translation) for k in carried]
    return bool(np.max(apart) <= COINCIDENT)


def _link_names(model: pin.Model, joint: int) -> list[str]:
    """Names of the links of the body behind a joint."""
    return [
        str(frame.name)
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and int(frame.parentJoint) == joint
    ]


def _named_body(model: pin.Model, joint: int) -> str:
    """Description of the body behind a joint, with the links fixed to each other."""
    first, *others = _link_names(model, joint) or [""]
    fixed = f" with what is fixed to it ({', '.join(others[:2])})" if others else ""
    return f"link {first}{fixed} behind joint {model.names[joint]}"


def check_inertia(model: pin.Model, table: JointTable) -> None:
    """Check that each joint moves some inertia, and that it is physically possible.

    A joint with rotor inertia may move an impossible body: its torques do not come from
    that body alone.

    Args:
        model: Model with its rotor inertia.
        table: Values of the n free joints; the limits bound the sampled positions.

    Raises:
        RobotLoadError: If joints move impossible bodies, or the mass matrix is
            singular; names the joints.
    """
    linkage, description = table.linkage, table.linkage.description
    names, (matrix, offset) = linkage.free, linkage.expansion
    ratios = np.abs(matrix)
    bare = (np.flatnonzero(ratios @ table["armature"] == 0.0) + 1).tolist()
    wrong = {joint: fault for joint in bare if (fault := _impossible(model, joint))}
    if wrong:
        leaders = np.unique([ratios[joint - 1].argmax() for joint in wrong])
        faults = [f"{_named_body(model, joint)} {wrong[joint]}" for joint in wrong]
        rotors = example_values([names[leader] for leader in leaders.tolist()])
        description.fail(
            f"{listed(faults)}: correct the <inertial> elements, or give "
            f"armature={rotors} [kg m^2 or kg] to plan with them nevertheless, or "
            f"{KINEMATIC}"
        )
    rng = np.random.default_rng(0)
    low, high = np.clip(table.ends, -np.pi, np.pi)
    data = model.createData()
    for _ in range(INERTIA_SAMPLES):
        q = matrix @ rng.uniform(low, high) + offset
        mass = matrix.T @ pin.crba(model, data, q) @ matrix
        singular = np.flatnonzero(singular_directions(mass))
        if singular.size:
            joints = [names[i] for i in singular]
            given = {link.name for link in description.bodies if link.mass is not None}
            lacking = [
                f"{_named_body(model, k)} has no <inertial>"
                for k in map(int, map(model.getJointId, joints))
                if not given.intersection(_link_names(model, k))
            ]
            least = float(np.diag(mass)[singular].min())
            why = f"what the <inertial> elements give is {least:.2g} kg m^2 or kg"
            description.fail(
                f"{' and '.join(joints)} can move without any inertia "
                f"({', '.join(lacking) or why}), so that any torque would accelerate "
                f"them without bound: give armature={example_values(joints)} [kg m^2 "
                f"or kg], correct the <inertial> elements, or give {KINEMATIC}"
            )


def singular_directions(mass: Array) -> NDArray[np.bool_]:
    """Find the joints that move in the null space of a mass matrix, if it is singular.

    Args:
        mass: The matrix, shape (n, n).

    Returns:
        Whether each joint moves there, shape (n,); False throughout for a regular
        matrix.
    """
    own = np.diag(mass)
    if (own < MIN_INERTIA).any():
        return np.asarray(own < MIN_INERTIA)
    scale = np.sqrt(own)
    values, vectors = np.linalg.eigh(mass / np.outer(scale, scale))
    motion = np.abs(vectors[:, 0])
    return np.asarray((values[0] < MIN_SCALED_INERTIA) & (motion > 0.1 * motion.max()))
