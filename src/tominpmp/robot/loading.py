"""Loading robots: files, the caller's values, and the model made of both."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.description.groups import Group, warn_of_passive
from tominpmp.description.inertials import check_inertia, warn_of_inertia
from tominpmp.description.joint_table import JointTable
from tominpmp.description.joint_values import JointValues, check_gravity
from tominpmp.robot.robot import Robot, assembled
from tominpmp.robot.sources import read_source

#: A name, a path, a text, a ``pinocchio.Model`` (alone or with geometry), a
#: ``yourdfpy.URDF`` or a module of robot_descriptions.
RobotLike: TypeAlias = (
    "str | bytes | os.PathLike[str] | pin.Model | tuple[Any, ...] | Any"
)

# Standard gravity in two decimals, as Pinocchio has it [m/s^2].
DEFAULT_GRAVITY = (0.0, 0.0, -9.81)


def load_robot(
    source: RobotLike,
    *,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    srdf: str | os.PathLike[str] | None = None,
    geometry: pin.GeometryModel | Sequence[pin.GeometryModel | None] | None = None,
    limits: str | None = None,
    group: Group | None = None,
    locked_joints: Mapping[str, float] | None = None,
    gravity: ArrayLike | None = None,
    damping: JointValues | None = None,
    armature: JointValues | None = None,
    friction: JointValues | None = None,
    effort: JointValues | None = None,
    velocity: JointValues | None = None,
    position_lower: JointValues | None = None,
    position_upper: JointValues | None = None,
) -> Robot:
    """Load a robot from its URDF file, or from what another library made of it.

    Values per joint are one number for all, an array in joint order, or a mapping of
    joint names for some; they replace what the file says.

    Args:
        source: A bundled robot (``"planar3r"``), one of the package example-robot-data
            (``"panda"``, ``"ur5"``), the path or the text of a URDF file; a
            ``pinocchio.Model``, alone, as the tuple that ``buildModelsFromUrdf``
            returns or as a ``RobotWrapper``; a ``yourdfpy.URDF``; a module of the
            package robot_descriptions or its name (``"panda_description"``).
        package_dirs: Folders in which to look for ``package://``; those above the file
            and of ROS are looked through anyway.
        srdf: Path or text of a semantic description; by default the one that lies
            beside the file or in the folder ``../srdf`` and has its name.
        geometry: Of a ``pinocchio.Model``: a ``GeometryModel`` to collide with, or two
            of them, to collide with and to look at. Its collision pairs, unless they
            are none or all, say which links are watched against each other; its
            reference configurations are group states.
        limits: ``"datasheet"`` for those that the maker publishes (accelerations,
            jerks, torque rates, and speeds and torques instead of the file's); the
            arguments below go before them. See :mod:`tominpmp.datasheets`.
        group: Group of the SRDF file, as ``"panda_arm"``, whose joints move; or a
            link, for the chain from the base to it; two links, for the chain from one
            to the other; or names of joints. The others are locked: where
            ``locked_joints`` has them, else where a group state of the file has them,
            else at zero. The base stands still.
        locked_joints: Positions [rad or m] of joints that are not to move; outside
            their limits they cause a warning. Joints that follow them are locked too.
        gravity: Gravity in the world, shape (3,) [m/s^2]; by default what the file
            says, else 9.81 along -z.
        damping: Viscous friction [N m s/rad or N s/m].
        armature: Rotor inertia seen at the joint [kg m^2 or kg].
        friction: Dry (Coulomb) friction [N m or N].
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
    given = read_source(source, package_dirs, srdf, geometry)
    linkage = given.linkage(group, locked_joints)
    linkage.warn_of_limits(given.description.joints)
    published, urdf = given.published(limits), given.files.urdf
    reasons = linkage.reasons()

    def table_for(joint_names: tuple[str, ...]) -> JointTable:
        table = JointTable.from_description(
            joint_names, given.description.joints, linkage
        )
        table = table.overridden(reasons, **given.other_values(joint_names, published))
        table = table.overridden(
            reasons,
            damping=damping,
            armature=armature,
            friction=friction,
            effort=effort,
            velocity=velocity,
            position_lower=position_lower,
            position_upper=position_upper,
        )
        table.check_complete(urdf)
        return table

    own = given.description.gravity or DEFAULT_GRAVITY
    robot = assembled(
        name=given.files.name or given.description.name,
        description=given.description,
        linkage=linkage,
        table_for=table_for,
        gravity=check_gravity(own if gravity is None else gravity),
        srdf=given.semantics,
    )
    further = given.motion_limits(published, robot.joint_names)
    robot = replace(robot, motion_limits=further)
    table, ties = robot._table(), (robot.expansion_matrix, robot.expansion_offset)
    check_inertia(robot.model, table, *ties, given.description)
    warn_of_inertia(robot.model, given.description)
    if given.semantics is not None:
        motors = set(robot.joint_names) - set(robot.passive_joints)
        warn_of_passive(given.semantics.groups.passive, motors)
    _ = robot.collision_model  # a mesh that cannot be read is to be told of now
    return robot
