"""What was given for a robot, and what follows from it before a model is made."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tominpmp.datasheets import OVERRIDES, published_limits, published_values
from tominpmp.description.groups import Group, JointGroups, group_locks
from tominpmp.description.linkage import Linkage
from tominpmp.description.robot_inputs import RobotInput, read_robot_input
from tominpmp.exceptions import OptionsError, brief
from tominpmp.motion_limits import MotionLimits

# What the argument ``limits`` may be.
DATASHEET = "datasheet"


@dataclass(frozen=True)
class RobotSource(RobotInput):
    """What the files of a robot, or what was given instead of them, say."""

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
        self, group: Group | None, locked_joints: Mapping[str, float] | None
    ) -> Linkage:
        """Find which joints are locked and which follow others.

        Args:
            group: Group of joints that move, as to :func:`load_robot`; None for all.
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
        locks = group_locks(groups, states, self.description, group, locked_joints)
        return Linkage.resolve(joints, locks)

    def other_values(
        self,
        joint_names: Sequence[str],
        published: Mapping[str, Mapping[str, float]],
    ) -> dict[str, dict[str, Any]]:
        """Values that no URDF file says, and published ones, by field and joint."""
        rotors = {} if self.semantics is None else self.semantics.rotor_inertias
        known: dict[str, Mapping[str, Any]] = {"armature": rotors, **self.values}
        known |= published
        return {
            key: {name: known[key][name] for name in joint_names if name in known[key]}
            for key in OVERRIDES
            if key in known
        }


def read_source(
    source: object,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    srdf: str | os.PathLike[str] | None = None,
    geometry: object = None,
) -> RobotSource:
    """Read what was given for a robot, as to :func:`load_robot`.

    Raises:
        RobotLoadError: If there is no such robot, or its files are wrong.
    """
    found = read_robot_input(source, package_dirs, srdf, geometry)
    return RobotSource(found.files, found.description, found.semantics, found.values)
