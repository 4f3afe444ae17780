"""Loading robots: files, the caller's values, and the model made of both."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from numpy.typing import ArrayLike

from tominpmp.description.files import check_folders, find_robot
from tominpmp.description.joint_table import JointTable
from tominpmp.description.joint_values import JointValues, check_gravity
from tominpmp.description.linkage import Linkage
from tominpmp.description.model import (
    build_model,
    check_inertia,
    configured_model,
    expansion,
)
from tominpmp.description.srdf import read_semantics
from tominpmp.description.urdf import read_urdf
from tominpmp.exceptions import RobotLoadError
from tominpmp.robot.robot import Robot

# Standard gravity in two decimals, as Pinocchio has it [m/s^2].
DEFAULT_GRAVITY = (0.0, 0.0, -9.81)


def load_robot(
    name_or_path: str | os.PathLike[str],
    *,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    srdf: str | os.PathLike[str] | None = None,
    locked_joints: Mapping[str, float] | None = None,
    gravity: ArrayLike | None = None,
    damping: JointValues | None = None,
    armature: JointValues | None = None,
    effort: JointValues | None = None,
    velocity: JointValues | None = None,
    position_lower: JointValues | None = None,
    position_upper: JointValues | None = None,
) -> Robot:
    """Load a robot from its URDF file.

    Values per joint are one number for all, an array in joint order, or a mapping of
    joint names for some; they replace what the file says. Dry friction
    (``<dynamics friction="..."/>``) is not part of the model.

    Args:
        name_or_path: A bundled robot (``"planar3r"``), one of the package
            example-robot-data (``"panda"``, ``"ur5"``), or the path of a URDF file.
        package_dirs: Folders in which to look for ``package://``; those above the file
            and of ROS are looked through anyway.
        srdf: Semantic description; by default the one that lies beside the file or in
            the folder ``../srdf`` and has its name.
        locked_joints: Positions [rad or m] of joints that are not to move; outside
            their limits they cause a warning. Joints that follow them are locked too.
        gravity: Gravity in the world, shape (3,) [m/s^2]; by default what the file
            says, else 9.81 along -z.
        damping: Viscous friction [N m s/rad or N s/m].
        armature: Rotor inertia seen at the joint [kg m^2 or kg].
        effort: Effort limits [N m or N]: x for (-x, x), or pairs (lower, upper); zero
            makes a joint passive.
        velocity: Velocity limits [rad/s or m/s], possibly infinite.
        position_lower: Lower position limits [rad or m], possibly infinite.
        position_upper: Upper position limits [rad or m], possibly infinite.

    Returns:
        The robot.

    Raises:
        RobotLoadError: If there is no such robot, its files are wrong or a mesh is not
            there, or a joint lacks a limit or inertia that no argument gives.
        OptionsError: If the value of an argument is wrong.
        JointNotFound: If a joint is unknown.
    """
    files = find_robot(name_or_path)
    description = read_urdf(files.urdf, check_folders(package_dirs))
    linkage = Linkage.resolve(description.joints, locked_joints or {})
    linkage.warn_of_limits(description.joints)
    model = build_model(description, linkage.locked)
    joint_names, matrix, offset = expansion(model, linkage.followers)
    if not joint_names:
        raise RobotLoadError(f"{files.urdf}: no joint is left that moves", files.urdf)
    table = JointTable.from_description(
        joint_names, description.joints, linkage
    ).overridden(
        linkage.reasons(),
        damping=damping,
        armature=armature,
        effort=effort,
        velocity=velocity,
        position_lower=position_lower,
        position_upper=position_upper,
    )
    table.check_complete(files.urdf)
    own = description.gravity or DEFAULT_GRAVITY
    checked = check_gravity(own if gravity is None else gravity)
    robot = Robot(
        name=files.name or description.name,
        model=configured_model(model, table, checked, matrix, offset),
        joint_names=joint_names,
        limits=table.limits(),
        damping=table.damping,
        armature=table.armature,
        gravity=checked,
        expansion_matrix=matrix,
        expansion_offset=offset,
        locked_joints=linkage.locked,
        srdf=read_semantics(files.srdf if srdf is None else srdf, description),
        description=description,
    )
    check_inertia(robot.model, table, matrix, offset, files.urdf)
    _ = robot.collision_model  # a mesh that cannot be read is to be told of now
    return robot
