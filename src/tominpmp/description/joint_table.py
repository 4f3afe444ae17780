"""Limits, friction and rotor inertia of the joints that move freely."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tominpmp.arrays import Array, Record, array_or_nan
from tominpmp.description.joint_values import (
    JointValues,
    check_order,
    check_sign,
    override,
)
from tominpmp.description.linkage import Linkage
from tominpmp.description.tree import JointDescription, Mimic
from tominpmp.exceptions import ProblemError, RobotLoadError, brief, warn_caller


@dataclass(frozen=True, eq=False)
class JointLimits(Record):
    """Limits of the n joints of a robot, as read-only arrays of shape (n,).

    Attributes:
        position_lower: Lower position limits [rad or m], possibly infinite.
        position_upper: Upper position limits [rad or m], possibly infinite.
        velocity: Largest speeds in either direction [rad/s or m/s], possibly infinite.
        effort_lower: Lower torque limits [N m or N].
        effort_upper: Upper torque limits [N m or N]; equal to the lower one on a
            passive joint.
    """

    position_lower: Array
    position_upper: Array
    velocity: Array
    effort_lower: Array
    effort_upper: Array

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        for f in fields(self):
            value = getattr(self, f.name)
            array = array_or_nan(value)
            if array.ndim != 1:
                raise ProblemError(
                    f"limits: {f.name} is {brief(value)}, expected a row of numbers",
                    f.name,
                )
            object.__setattr__(self, f.name, array)
        if len({getattr(self, f.name).size for f in fields(self)}) > 1:
            sizes = {f.name: getattr(self, f.name).size for f in fields(self)}
            raise ProblemError(f"limits: lengths differ: {sizes}", "limits")


#: A row of :class:`JointTable`; NaN where a value is not known.
ROW = np.dtype(
    [
        ("position_lower", np.float64),  # [rad or m]
        ("position_upper", np.float64),  # [rad or m]
        ("velocity", np.float64),  # [rad/s or m/s]
        ("effort", np.float64, 2),  # the lower and the upper limit [N m or N]
        ("damping", np.float64),  # viscous friction [N m s/rad or N s/m]
        ("armature", np.float64),  # rotor inertia seen at the joint [kg m^2 or kg]
        ("friction", np.float64),  # dry friction [N m or N]
    ]
)


@dataclass(frozen=True, eq=False)
class JointTable:
    """Values per joint; ``table["velocity"]`` is a column of them.

    Attributes:
        joint_names: Names of the n joints.
        rows: One row of :data:`ROW` for each, shape (n,).
    """

    joint_names: tuple[str, ...]
    rows: NDArray[np.void]

    def __getitem__(self, column: str) -> Array:
        """Values of all joints, shape (n,), or (n, 2) for the effort."""
        return np.array(self.rows[column], dtype=np.float64)

    @classmethod
    def from_description(
        cls,
        joint_names: Sequence[str],
        joints: Sequence[JointDescription],
        linkage: Linkage,
    ) -> JointTable:
        r"""Collect what a URDF file says about the joints that are free.

        A joint that follows, :math:`q_f = m q + o`, passes its position and velocity
        limits and its friction, viscous :math:`m^2 d_f` and dry :math:`|m| f_f`, on
        to the joint that it follows. Its effort limit has no meaning: the motor is at
        the leader.

        Args:
            joint_names: Free joints, in the order of the model.
            joints: All joints of the description.
            linkage: Which of them follow.
        """
        by_name = {joint.name: joint for joint in joints}
        rows = []
        for name in joint_names:
            joint = by_name[name]
            for follower, mimic in linkage.followers.items():
                if mimic.leader == name:
                    joint = _led(joint, by_name[follower], mimic)
            # A limit of zero is how descriptions say that they do not know it.
            velocity = joint.velocity if joint.velocity > 0 else math.nan
            effort = joint.effort if 0 < joint.effort < math.inf else math.nan
            limits = (joint.lower, joint.upper, velocity, (-effort, effort))
            rows.append((*limits, joint.damping, joint.armature, joint.friction))
        return cls(tuple(joint_names), np.array(rows, dtype=ROW))

    @classmethod
    def of_limits(
        cls,
        joint_names: Sequence[str],
        limits: JointLimits,
        damping: Array,
        armature: Array,
        friction: Array,
    ) -> JointTable:
        """Table of a robot as it is."""
        rows = np.zeros(len(joint_names), dtype=ROW)
        for name in ("position_lower", "position_upper", "velocity"):
            rows[name] = getattr(limits, name)
        rows["effort"] = np.column_stack([limits.effort_lower, limits.effort_upper])
        rows["damping"], rows["armature"] = damping, armature
        rows["friction"] = friction
        return cls(tuple(joint_names), rows)

    def overridden(
        self, not_free: Mapping[str, str], **values: JointValues | None
    ) -> JointTable:
        """Replace values by those a caller gave.

        Args:
            not_free: Joints of the robot that are not in the table, and why.
            **values: By field of the table; ``None`` changes nothing.

        Raises:
            OptionsError: If a value is wrong.
            JointNotFound: If a joint is unknown.
        """
        names, rows = self.joint_names, self.rows.copy()
        given = {k: value for k, value in values.items() if value is not None}
        for option, value in given.items():
            rows[option] = override(option, value, self[option], names, not_free)
        table = JointTable(names, rows)
        for option in ("damping", "armature", "friction", "velocity"):
            if option in given:
                speed = option == "velocity"
                check_sign(option, rows[option], names, positive=speed, infinite=speed)
        if "effort" in given:
            low, high = rows["effort"].T
            check_order("effort", low, high, names, equal=True)
            check_sign("effort", np.abs(rows["effort"]).max(axis=1), names)
        for option in ("position_lower", "position_upper"):
            if option in given:
                check_order(option, *table.ends, names)
        return table

    @property
    def ends(self) -> tuple[Array, Array]:
        """Lower and upper position limits, shape (n,) each [rad or m]."""
        return self["position_lower"], self["position_upper"]

    def only(self, joint_names: Sequence[str]) -> JointTable:
        """Table of some of the joints, in the order of their names."""
        rows = [self.joint_names.index(name) for name in joint_names]
        return JointTable(tuple(joint_names), self.rows[rows])

    def limits(self) -> JointLimits:
        """The limits alone."""
        return JointLimits(*self.ends, self["velocity"], *self["effort"].T)

    def check_complete(self, path: Path) -> None:
        """Check that every joint has all limits, and room to move.

        Raises:
            RobotLoadError: Naming all joints, and the arguments that mend it.
        """
        complaints = []
        for quantity in ("effort", "velocity"):
            array = self[quantity].reshape(len(self.joint_names), -1)
            joints = self._names(np.any(np.isnan(array), axis=1))
            if joints:
                complaints.append(
                    f"no {quantity} limit for {', '.join(joints)}: give "
                    f"{quantity}={example_values(joints)}"
                )
        # True also where a limit is NaN.
        ends = zip(self.joint_names, *self.ends, strict=True)
        joints = [name for name, lower, upper in ends if not lower < upper]
        if joints:
            values = example_values(joints)
            complaints.append(
                f"no position limits, or no room between them, for "
                f"{', '.join(joints)}: give position_lower={values} and "
                f"position_upper={values}, or lock them"
            )
        if complaints:
            raise RobotLoadError(f"{path}: {'; '.join(complaints)}", path)

    def _names(self, chosen: NDArray[np.bool_]) -> list[str]:
        return [name for name, c in zip(self.joint_names, chosen, strict=True) if c]


def example_values(joints: Sequence[str]) -> str:
    """Write the beginning of an argument with values for some joints."""
    return "{" + ", ".join(f"{joint!r}: ..." for joint in joints) + "}"


def _led(
    joint: JointDescription, follower: JointDescription, mimic: Mimic
) -> JointDescription:
    """Describe a joint so that its limits and friction include a follower's."""
    m = mimic.multiplier
    joint = replace(
        joint,
        damping=joint.damping + m**2 * follower.damping,
        friction=joint.friction + abs(m) * follower.friction,
        armature=joint.armature + m**2 * follower.armature,
    )
    if m == 0.0:
        return joint
    if follower.velocity > 0:
        # In this order a limit that is not known (NaN) remains so.
        joint = replace(joint, velocity=min(joint.velocity, follower.velocity / abs(m)))
    # Limits left out or degenerate are common on joints that follow.
    if follower.lower < follower.upper:
        ends = [(x - mimic.offset) / m for x in (follower.lower, follower.upper)]
        lower, upper = max(joint.lower, min(ends)), min(joint.upper, max(ends))
        if joint.lower < joint.upper and not lower < upper:
            warn_caller(
                f"the position limits [{follower.lower:g}, {follower.upper:g}] of "
                f"joint {follower.name} leave joint {joint.name}, which it follows, "
                "no room; they are ignored"
            )
            return joint
        joint = replace(joint, lower=lower, upper=upper)
    return joint
