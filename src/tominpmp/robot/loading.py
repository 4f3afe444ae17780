"""Loading robots: files, the caller's values, and the model made of both."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from tominpmp.datasheets import OVERRIDES, published_limits, published_values
from tominpmp.description.files import RobotFiles, check_folders, find_robot
from tominpmp.description.groups import JointGroups, group_locks, warn_of_passive
from tominpmp.description.inertials import warn_of_inertia
from tominpmp.description.joint_table import JointTable
from tominpmp.description.joint_values import JointValues, check_gravity
from tominpmp.description.linkage import Linkage
from tominpmp.description.model import (
    build_model,
    check_inertia,
    configured_model,
    expansion,
)
from tominpmp.description.srdf import SemanticDescription, read_semantics
from tominpmp.description.urdf import UrdfDescription, read_urdf
from tominpmp.exceptions import OptionsError, RobotLoadError, brief
from tominpmp.motion_limits import MotionLimits
from tominpmp.robot.robot import Robot

# Standard gravity in two decimals, as Pinocchio has it [m/s^2].
DEFAULT_GRAVITY = (0.0, 0.0, -9.81)
# What the argument ``limits`` may be.
DATASHEET = "datasheet"


@dataclass(frozen=True)
class RobotSource:
    """What the files of a robot say.

    Attributes:
        files: The files.
        description: The URDF file.
        semantics: The SRDF file, if there is one.
    """

    files: RobotFiles
    description: UrdfDescription
    semantics: SemanticDescription | None

    @property
    def names(self) -> tuple[str | None, ...]:
        """Names of the robot: asked for, in its description, of the file."""
        return self.files.name, self.description.name, self.files.urdf.stem

    def published(self, limits: str | None) -> dict[str, dict[str, float]]:
        """Values of the maker's data sheet by quantity and joint name, if asked for.

        Raises:
            OptionsError: If limits are neither "datasheet" nor None, or there is no
                sheet.
        """
        if limits is None:
            return {}
        if limits != DATASHEET:
            raise OptionsError(
                f"limits is {brief(limits)}, expected {DATASHEET!r} or None", "limits"
            )
        joints = [joint.name for joint in self.description.joints]
        return published_values(self.names, joints)

    def motion_limits(
        self, published: Mapping[str, Mapping[str, float]], joint_names: Sequence[str]
    ) -> MotionLimits | None:
        """Limits of accelerations and the like: published, else the URDF file's."""
        described: dict[str, dict[str, float]] = {"acceleration": {}, "jerk": {}}
        for joint in self.description.joints:
            for quantity, values in described.items():
                value = getattr(joint, quantity)
                if value < math.inf:
                    values[joint.name] = value
        own = published_limits(described, joint_names)
        theirs = published_limits(published, joint_names)
        return own if theirs is None else theirs.over(own, joint_names)

    def linkage(
        self, group: str | None, locked_joints: Mapping[str, float] | None
    ) -> Linkage:
        """Find which joints are locked and which follow others.

        Args:
            group: Group of joints that move; None for all.
            locked_joints: Positions of joints that are not to move [rad or m].

        Raises:
            OptionsError: If there is no such group, or a position is wrong.
            JointNotFound: If a joint is unknown.
        """
        joints = self.description.joints
        locked_joints = {} if locked_joints is None else locked_joints
        # First what the caller gave, with its errors.
        linkage = Linkage.resolve(joints, locked_joints)
        if group is None:
            return linkage
        said = self.semantics
        groups = JointGroups() if said is None else said.groups
        states = {} if said is None else said.group_states
        locks = group_locks(groups, states, joints, group, locked_joints)
        return Linkage.resolve(joints, locks)


def read_source(
    name_or_path: str | os.PathLike[str],
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    srdf: str | os.PathLike[str] | None = None,
) -> RobotSource:
    """Read the files of a robot, given as to :func:`load_robot`.

    Raises:
        RobotLoadError: If there is no such robot, or its files are wrong.
    """
    files = find_robot(name_or_path)
    description = read_urdf(files.urdf, check_folders(package_dirs))
    semantics = read_semantics(files.srdf if srdf is None else srdf, description)
    return RobotSource(files, description, semantics)


def load_robot(
    name_or_path: str | os.PathLike[str],
    *,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    srdf: str | os.PathLike[str] | None = None,
    limits: str | None = None,
    group: str | None = None,
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
    """Load a robot from its URDF file.

    Values per joint are one number for all, an array in joint order, or a mapping of
    joint names for some; they replace what the file says.

    Args:
        name_or_path: A bundled robot (``"planar3r"``), one of the package
            example-robot-data (``"panda"``, ``"ur5"``), or the path of a URDF file.
        package_dirs: Folders in which to look for ``package://``; those above the file
            and of ROS are looked through anyway.
        srdf: Semantic description; by default the one that lies beside the file or in
            the folder ``../srdf`` and has its name.
        limits: ``"datasheet"`` for those that the maker publishes (accelerations,
            jerks, torque rates, and speeds and torques instead of the file's); the
            arguments below go before them. See :mod:`tominpmp.datasheets`.
        group: Group of the SRDF file, as ``"panda_arm"``, whose joints move. The others
            are locked: where ``locked_joints`` has them, else where a group state of
            the file has them, else at zero. The base stands still.
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
    source = read_source(name_or_path, package_dirs, srdf)
    linkage = source.linkage(group, locked_joints)
    linkage.warn_of_limits(source.description.joints)
    model = build_model(source.description, linkage.locked)
    joint_names, matrix, offset = expansion(model, linkage.followers)
    urdf = source.files.urdf
    if not joint_names:
        raise RobotLoadError(f"{urdf}: no joint is left that moves", urdf)
    published = source.published(limits)
    table = JointTable.from_description(joint_names, source.description.joints, linkage)
    not_free = linkage.reasons()
    table = table.overridden(not_free, **_other_values(source, joint_names, published))
    table = table.overridden(
        not_free,
        damping=damping,
        armature=armature,
        friction=friction,
        effort=effort,
        velocity=velocity,
        position_lower=position_lower,
        position_upper=position_upper,
    )
    table.check_complete(urdf)
    own = source.description.gravity or DEFAULT_GRAVITY
    checked = check_gravity(own if gravity is None else gravity)
    robot = Robot(
        name=source.files.name or source.description.name,
        model=configured_model(model, table, checked, matrix, offset),
        joint_names=joint_names,
        limits=table.limits(),
        damping=table.damping,
        armature=table.armature,
        friction=table.friction,
        gravity=checked,
        expansion_matrix=matrix,
        expansion_offset=offset,
        locked_joints=linkage.locked,
        srdf=source.semantics,
        description=source.description,
        motion_limits=source.motion_limits(published, joint_names),
    )
    check_inertia(robot.model, table, matrix, offset, urdf)
    warn_of_inertia(robot.model, source.description.xml, urdf)
    if source.semantics is not None:
        motors = set(robot.joint_names) - set(robot.passive_joints)
        warn_of_passive(source.semantics.groups.passive, motors)
    _ = robot.collision_model  # a mesh that cannot be read is to be told of now
    return robot


def _other_values(
    source: RobotSource,
    joint_names: Sequence[str],
    published: Mapping[str, Mapping[str, float]],
) -> dict[str, dict[str, float]]:
    """Values of the SRDF file, and published ones, by field and joint name."""
    rotors = {} if source.semantics is None else source.semantics.rotor_inertias
    known = {"armature": rotors, **published}
    return {
        key: {name: known[key][name] for name in joint_names if name in known[key]}
        for key in OVERRIDES
        if key in known
    }
