"""Several robots in one workspace, combined into one robot with several arms.

Its joints are the joints of all robots, with one common duration T. The names of
joints, links and frames are prefixed with the name of their robot: "left/tool0".
Collisions between the robots are self-collisions of the combined robot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array
from tominpmp.checks import instance, split_pose, wrong
from tominpmp.collision.query import PairDistances
from tominpmp.collision.selection import link_bodies, own_pairs
from tominpmp.description.joint_table import JointTable, Linkage, check_gravity
from tominpmp.description.srdf import Pair, SemanticDescription
from tominpmp.description.tree import joined_descriptions
from tominpmp.exceptions import ProblemError, brief
from tominpmp.motion_limits import MotionLimits
from tominpmp.robot.robot import Robot, assembled
from tominpmp.scene.rotations import checked_pose

# Name of a robot, the robot, and the placement base_to_world or position of its base.
Part: TypeAlias = "tuple[str, Robot, pin.SE3 | ArrayLike]"

# Depth to which bases may overlap: adjacent bases touch [m].
OVERLAP = 1e-3
# Distance below which two bases without collision shapes count as coincident [m].
SAME_PLACE = 1e-3


def combine_robots(parts: Sequence[Part], *, gravity: ArrayLike | None = None) -> Robot:
    """Combine several robots in one workspace into one robot.

    Args:
        parts: For each robot its name, the robot, and the placement base_to_world
            (pinocchio.SE3) or the position of its base, shape (3,) [m].
        gravity: Gravity in the world, shape (3,) [m/s^2]; None for the gravity of the
            robots, which must agree.

    Returns:
        The robot; ``robot.stack(left=q1, right=q2)`` concatenates values of its joints.

    Raises:
        ProblemError: If two robots have the same name, their bases overlap, their
            gravities differ, or only some of them are kinematic.
        OptionsError: If the gravity is not a vector.
    """
    robots, bases = _checked_parts(parts)
    world = _common_gravity(robots) if gravity is None else check_gravity(gravity)
    placed = {part: (robot.description, bases[part]) for part, robot in robots.items()}
    joints = [f"{part}/{k}" for part, r in robots.items() for k in r.joint_names]
    locked = {
        f"{part}/{joint}": position
        for part, robot in robots.items()
        for joint, position in robot.locked_joints.items()
    }
    linkage = Linkage.resolve(joined_descriptions(placed, joints), locked)
    robot = assembled(
        _joined_table(robots, linkage),
        name=linkage.description.name,
        gravity=world,
        srdf=_joined_semantics(robots, linkage.description.path),
        kinematic=_all_kinematic(robots),
        motion_limits=_joined_motion_limits(robots, joints),
    )
    _check_bases(robot, bases)
    return robot


def _checked_parts(
    parts: Sequence[Part],
) -> tuple[dict[str, Robot], dict[str, pin.SE3]]:
    robots, bases = dict[str, Robot](), dict[str, pin.SE3]()
    if not isinstance(parts, Sequence) or not parts:
        raise wrong(parts, "robots", "a list of (name, robot, base)")
    for number, part in enumerate(parts):
        if not isinstance(part, Sequence) or len(part) != 3:
            raise wrong(part, f"robots[{number}]", "(name, robot, base)")
        name, robot, base = part
        if not isinstance(name, str) or not name or "/" in name or name in robots:
            form = "expected a text without '/', another one for each robot"
            raise ProblemError(f"robots: a name is {brief(name)}, {form}", "robots")
        instance(robot, Robot, f"robots: {brief(name)}", "a Robot", "robots")
        robots[name], bases[name] = robot, base_placement(name, base)
    return robots, bases


def base_placement(name: str, base: object, field: str = "robots") -> pin.SE3:
    """Check the placement of the base of a robot.

    Args:
        name: Name of the robot, for the message.
        base: Placement base_to_world, or position, shape (3,) [m].
        field: The argument that holds it.

    Raises:
        ProblemError: If it is neither a placement nor a position.
    """
    pose = (base, np.eye(3)) if split_pose(base) is None else base
    try:
        return checked_pose(pose, field)
    except ProblemError as error:
        raise ProblemError(
            f"{field}: the base of {brief(name)} is {brief(base)}, expected a "
            "pinocchio.SE3, another pose or three finite coordinates [m]",
            field,
        ) from error


def _common_gravity(robots: Mapping[str, Robot]) -> Array:
    each = {name: tuple(robot.gravity.tolist()) for name, robot in robots.items()}
    if len({*each.values()}) > 1:
        fault = f"gravity differs, {each}; expected the argument gravity"
        raise ProblemError(f"robots: {fault}", "gravity")
    return next(iter(robots.values())).gravity


def _all_kinematic(robots: Mapping[str, Robot]) -> bool:
    """Whether all robots are kinematic; a mixture of both kinds is an error."""
    kinematic = [name for name, robot in robots.items() if robot.kinematic]
    if kinematic and len(kinematic) < len(robots):
        raise ProblemError(
            f"robots: {', '.join(kinematic)} of {', '.join(robots)} are kinematic, "
            "expected all of them or none: load the others with kinematic=True, too",
            "robots",
        )
    return bool(kinematic)


def _joined_table(robots: Mapping[str, Robot], linkage: Linkage) -> JointTable:
    """Values of the joints of all robots, one robot after the other."""
    tables = [robot._table().columns for robot in robots.values()]
    columns = {key: np.concatenate([own[key] for own in tables]) for key in tables[0]}
    return JointTable(linkage, columns)


def _joined_motion_limits(
    robots: Mapping[str, Robot], joint_names: Sequence[str]
) -> MotionLimits | None:
    """Motion limits of all robots; the effort scale is the smallest of theirs."""
    joined: MotionLimits | None = None
    for part, robot in robots.items():
        own = robot.motion_limits
        if own is not None:
            names = {joint: f"{part}/{joint}" for joint in robot.joint_names}
            joined = own.renamed(names, robot.joint_names).over(joined, joint_names)
    return joined


def _joined_semantics(robots: Mapping[str, Robot], path: Path) -> SemanticDescription:
    """Link pairs that each robot leaves unchecked, and group states that all have."""
    pairs, never = list[Pair](), list[Pair]()
    for part, robot in robots.items():
        apart = () if robot.srdf is None else robot.srdf.never_touch
        for own, joined in ((_unchecked_pairs(robot), pairs), (apart, never)):
            joined += [(f"{part}/{one}", f"{part}/{other}") for one, other in own]
    states = [robot.group_states for robot in robots.values()]
    common = {
        ("", state): {
            f"{part}/{joint}": position
            for part, own in zip(robots, states, strict=True)
            for joint, position in own[state].items()
        }
        for state in states[0]
        if all(state in own for own in states)
    }
    return SemanticDescription(tuple(pairs), common, path, never_touch=tuple(never))


def _unchecked_pairs(robot: Robot) -> Sequence[Pair]:
    """Link pairs of a robot that are not checked for collision."""
    if robot.srdf is not None and robot.srdf.disabled_pairs:
        return robot.srdf.disabled_pairs
    # Without a list in the SRDF neighbours are left out, which takes the whole tree.
    # The selection of pairs does not depend on the decomposition of the meshes.
    links = [body.name for body in link_bodies(robot, "hull")]
    pairs = own_pairs(robot, "convex", frozenset()).tolist()
    watched = {frozenset((links[i], links[k])) for i, k in pairs}
    every = combinations(sorted({*links}), 2)
    return [pair for pair in every if frozenset(pair) not in watched]


def _check_bases(robot: Robot, bases: Mapping[str, pin.SE3]) -> None:
    """Check that links fixed to the world of one robot do not penetrate another's."""
    for (one, here), (other, there) in combinations(bases.items(), 2):
        depth = _base_overlap(robot, f"{one}/", f"{other}/")
        apart = float(np.linalg.norm(here.translation - there.translation))
        if depth is None and apart <= SAME_PLACE:
            fault = f"are at one place, {np.round(here.translation, 4).tolist()}"
        elif depth is not None and depth > OVERLAP:
            fault = f"overlap by {depth:.4g} m"
        else:
            continue
        raise ProblemError(
            f"robots: the bases of {one!r} and {other!r} {fault}; expected bases that "
            "are apart",
            "robots",
        )


def _base_overlap(robot: Robot, first: str, second: str) -> float | None:
    """Overlap of the fixed links of two robots [m]; None if one has no shapes."""
    fixed = [body for body in link_bodies(robot, "convex") if not body.joint]
    first_bodies = [i for i, body in enumerate(fixed) if body.name.startswith(first)]
    second_bodies = [i for i, body in enumerate(fixed) if body.name.startswith(second)]
    pairs = np.array(list(product(first_bodies, second_bodies)))
    if not pairs.size:
        return None
    bases = PairDistances(robot, (fixed, pairs))
    return -float(np.min(bases.distances(np.zeros((1, robot.n)))))
