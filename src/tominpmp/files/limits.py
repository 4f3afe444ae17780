"""Limits in YAML files: MoveIt's, and those of motors and controllers.

MoveIt's ``joint_limits.yaml`` contains limits that a URDF lacks or sets too wide. The
limits of motors and controllers are set joint by joint:

::

    effort_scale: 0.95          # share of the torque limits that motions may use
    effort_rate: 1000           # joints without a value of their own [N m/s]
    joints:
      panda_joint1:
        acceleration: 15        # [rad/s^2]
        jerk: 7500              # [rad/s^3]
        effort_curve:           # largest torque over speed, joined by straight lines
          speed: [0, 1, 2.175]  # [rad/s], from 0
          effort: [87, 87, 40]  # [N m]
      panda_joint2:
        effort_curve: {stall: 87, no_load_speed: 3}             # linear droop
      panda_joint3:
        effort_curve: {effort: 87, power: 100, top_speed: 2.2}  # power limit

Acceleration, jerk and effort rate may stand at the top level, for all joints, and at a
joint, where they take precedence.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypeAlias

from tominpmp.arrays import Record, record
from tominpmp.checks import flag, instance, names, number
from tominpmp.description.fields import Field
from tominpmp.description.paths import checked_path
from tominpmp.description.tree import warn_of
from tominpmp.description.yaml_reader import read_yaml
from tominpmp.exceptions import JointNotFound, ProblemError, ScenarioError, brief
from tominpmp.files.records import blaming, keys_in_brief
from tominpmp.motion_limits import (
    EffortCurve,
    LimitKind,
    MotionLimits,
    kinds_of,
    limits_by_joint,
)
from tominpmp.robot.robot import Robot, RobotSource, load_robot, read_source

_SCALINGS = ("default_velocity_scaling_factor", "default_acceleration_scaling_factor")
# By quantity: the key that says whether it is limited, and the key of the limit.
_KEYS = {
    "velocity": ("has_velocity_limits", "max_velocity"),
    "acceleration": ("has_acceleration_limits", "max_acceleration"),
    "jerk": ("has_jerk_limits", "max_jerk"),
    "effort": ("has_effort_limits", "max_effort"),
    "position_lower": ("has_position_limits", "min_position"),
    "position_upper": ("has_position_limits", "max_position"),
}
# Pilz' planner has a separate limit for deceleration, which is negative.
_SLOWING = ("has_deceleration_limits", "max_deceleration")
# Key for continuous joints, which the URDF file determines.
_TURNS = "angle_wraparound"
# Constructors of a curve and their keys, by the first key.
CURVES: dict[str, tuple[Callable[..., EffortCurve], tuple[str, ...]]] = {
    "stall": (EffortCurve.droop, ("stall", "no_load_speed")),
    "power": (EffortCurve.power, ("effort", "power", "top_speed")),
}


def _read_only(value: Mapping[str, float], name: str) -> Mapping[str, float]:
    """Check limits by joint name, and make the mapping read-only."""
    table = instance(value, Mapping, name, "limits by joint name")
    limits = {k: number(v, f"{name} of joint {k!r}") for k, v in table.items()}
    return MappingProxyType(limits)


ByJoint: TypeAlias = Annotated[Mapping[str, float], _read_only]


@record
class MoveItLimits(Record):
    """Limits by joint name, as far as a ``joint_limits.yaml`` has them.

    Attributes:
        path: The file.
        velocity: Largest speeds [rad/s or m/s].
        acceleration: Largest accelerations [rad/s^2 or m/s^2].
        jerk: Largest jerks [rad/s^3 or m/s^3].
        effort: Largest torques [N m or N].
        position_lower: Lower position limits [rad or m].
        position_upper: Upper position limits [rad or m].
        velocity_scaling: Factor by which MoveIt scales speeds if a request sets no
            factor; 0.1 in many files.
        acceleration_scaling: The same for accelerations.
    """

    path: Path
    velocity: ByJoint = field(default_factory=dict)
    acceleration: ByJoint = field(default_factory=dict)
    jerk: ByJoint = field(default_factory=dict)
    effort: ByJoint = field(default_factory=dict)
    position_lower: ByJoint = field(default_factory=dict)
    position_upper: ByJoint = field(default_factory=dict)
    velocity_scaling: float = 1.0
    acceleration_scaling: float = 1.0

    def overrides(self, *, scaled: bool = False) -> dict[str, dict[str, float]]:
        """Arguments for :func:`~tominpmp.load_robot` and ``with_changes``.

        Args:
            scaled: Whether the speeds are scaled by ``velocity_scaling``.

        Returns:
            Values by joint name for velocity, effort, position_lower and
            position_upper, as far as the file has them. Accelerations and jerks are in
            :meth:`motion_limits`.
        """
        factor = self.velocity_scaling if flag(scaled, "scaled") else 1.0
        arguments = {"velocity": {k: factor * v for k, v in self.velocity.items()}}
        for name in ("effort", "position_lower", "position_upper"):
            arguments[name] = dict(getattr(self, name))
        return {name: values for name, values in arguments.items() if values}

    def motion_limits(
        self, joint_names: Sequence[str], *, scaled: bool = False
    ) -> MotionLimits | None:
        """Limits of accelerations and jerks; None if the file has neither.

        Args:
            joint_names: Joints that move; limits of other joints are dropped.
            scaled: Whether accelerations are scaled by ``acceleration_scaling``.
        """
        joint_names = names(joint_names)
        factor = self.acceleration_scaling if flag(scaled, "scaled") else 1.0
        scaled_ones = {k: factor * v for k, v in self.acceleration.items()}
        values = {"acceleration": scaled_ones, "jerk": self.jerk}
        return limits_by_joint(values, joint_names)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that have a limit."""
        return tuple(dict.fromkeys(joint for k in _KEYS for joint in getattr(self, k)))


def load_limited_robot(
    path: str | Path | None,
    robot: str | os.PathLike[str] | RobotSource,
    **arguments: Any,
) -> Robot:
    """Load a robot with the limits of a ``joint_limits.yaml``, including accelerations.

    Limits of joints that do not move are dropped; limits of joints that the robot
    lacks, or that follow others, are dropped with a warning.

    Args:
        path: The file; None for the robot's own limits only.
        robot: Source of the robot, as for :func:`~tominpmp.load_robot`, or its
            result of reading.
        **arguments: Further arguments of ``load_robot``; values per joint take
            precedence over the file.

    Raises:
        TominpmpError: As raised by :func:`load_joint_limits` and
            :func:`~tominpmp.load_robot`.
    """
    if path is None:
        return load_robot(robot, **arguments)
    moveit = load_joint_limits(path)
    file_arguments = {"package_dirs", "srdf", "xacro_args"}
    files = {k: arguments[k] for k in file_arguments & arguments.keys()}
    stated = {quantity: getattr(moveit, quantity) for quantity in _KEYS}
    source = replace(read_source(robot, **files), stated=stated)
    loaded = load_robot(source, **arguments)
    _warn_of_joints(moveit, loaded)
    return loaded


def _warn_of_joints(limits: MoveItLimits, robot: Robot) -> None:
    joints = {joint.name: joint for joint in robot.description.joints}
    unknown = [brief(joint) for joint in limits.joints if joint not in joints]
    moving = [joint for joint in limits.joints if joint not in robot.locked_joints]
    led = [joint for joint in moving if joint in joints and joints[joint].mimic]
    scalings = limits.velocity_scaling, limits.acceleration_scaling
    factors = [
        f"{key} ({value:g})"
        for key, value in zip(_SCALINGS, scalings, strict=True)
        if value < 1.0
    ]
    remarks = {
        "the robot has no joints {}": unknown,
        "limits of joints that follow others are not used: {}": led,
        "the limits are not scaled by {}": factors,
    }
    warn_of(remarks, limits.path)


def load_joint_limits(path: str | Path) -> MoveItLimits:
    """Read a ``joint_limits.yaml``.

    A limit counts unless the file disables it (``has_velocity_limits: false``); then
    the limit of the URDF remains. If a deceleration is limited too, the smaller of the
    two limits holds for both. Keys that are not read cause a warning. The table
    ``joint_limits`` may be among the parameters of a node, as ``ros2 param dump`` and
    files of controllers have it.

    Args:
        path: The file.

    Returns:
        The limits.

    Raises:
        ScenarioError: If the file cannot be read or is wrong; names the key.
    """
    path = checked_path(path, "path", ScenarioError)
    document = Field(read_yaml(path), path)
    table, *others = _tables_of_limits(document) or [document]
    for other in others:
        fault = f"is in the table {table.key}, too, expected one of them"
        other.get("joint_limits").fail(fault)
    joints = table.need("joint_limits").table()
    values: dict[str, dict[str, float]] = {name: {} for name in _KEYS}
    notes = [k for k in table.table() if k not in ("joint_limits", *_SCALINGS)]
    for joint, limits in joints.items():
        for name, keys in _KEYS.items():
            value = _limit(limits, *keys)
            if value is not None:
                values[name][joint] = value
        low, high = (values[f"position_{end}"].get(joint) for end in ("lower", "upper"))
        if low is not None and high is not None and low > high:
            fault = f"is {low:g}, expected at most max_position, {high:g}"
            limits.get("min_position").fail(fault)
        slowing = _limit(limits, *_SLOWING)
        if slowing is not None:
            slowing = abs(slowing)
            own = values["acceleration"].get(joint, slowing)
            values["acceleration"][joint] = min(own, slowing)
            if own != slowing:
                notes.append(f"the larger of {limits.key}.max_(ac|de)celeration")
        notes += _unread(limits)
    warn_of({"not used: {}": keys_in_brief(notes)}, path)
    speed, acceleration = (_share(table.get(key)) for key in _SCALINGS)
    with blaming(table):
        return MoveItLimits(
            path, **values, velocity_scaling=speed, acceleration_scaling=acceleration
        )


def _tables_of_limits(table: Field) -> list[Field]:
    """Tables with the key ``joint_limits``, which parameters of ROS nodes enclose."""
    items = table.table()
    if "joint_limits" in items:
        return [table]
    inner = (item for item in items.values() if isinstance(item.value, dict))
    return [found for item in inner for found in _tables_of_limits(item)]


def _limit(limits: Field, flag: str, key: str) -> float | None:
    """A limit, if the file has it; required if the flag is set."""
    flagged = limits.get(flag)
    if flagged.given and not flagged.flag():
        return None
    value = limits.need(key) if flagged.given else limits.get(key)
    if not value.given:
        return None
    if key == _SLOWING[1] and value.number() == 0.0:
        value.fail("is 0, expected a number less than zero")
    if key in (_SLOWING[1], "min_position", "max_position"):
        return value.number()
    return value.number("a number greater than zero", above=0.0)


def _unread(limits: Field) -> list[str]:
    """Keys of a joint with a value that is not used."""
    known = {key for keys in (*_KEYS.values(), _SLOWING, (_TURNS,)) for key in keys}
    unread = [item.key for key, item in limits.table().items() if key not in known]
    turns = limits.get(_TURNS)
    if turns.given and turns.flag():
        unread.append(f"{turns.key} (the URDF says whether a joint is continuous)")
    return unread


def load_motion_limits(path: str | Path, robot: Robot) -> MotionLimits:
    """Read limits of accelerations, jerks and torques from a YAML file.

    Args:
        path: The file; its format is described at the top of the module.
        robot: The robot. The file may include its locked joints, whose limits are
            dropped.

    Returns:
        The limits, for the joints that move.

    Raises:
        ScenarioError: If the file cannot be read or is wrong: the message names the
            key, the value and the expected one.
    """
    path = checked_path(path, "path", ScenarioError)
    instance(robot, Robot, "robot")
    document = Field(read_yaml(path), path)
    kinds = kinds_of(MotionLimits, numbers=True)
    if not document.given:
        document.fail(f"is empty, expected {', '.join(kinds)}, effort_scale or joints")
    document.only("effort_scale", "joints", *kinds)
    share = _share(document.get("effort_scale"))
    values: dict[str, dict[str, Any]] = {
        name: dict.fromkeys(robot.joint_names, _positive(item, kind))
        for name, kind in kinds.items()
        if (item := document.get(name)).value is not None
    }
    joints = document.get("joints")
    for joint, limits in joints.table().items() if joints.value is not None else ():
        moves = joint in robot.joint_names
        if not moves and joint not in robot.locked_joints:
            limits.fail(str(JointNotFound(joint, robot.joint_names)))
        limits.only("effort_curve", *kinds)
        for name, item in limits.table().items():
            curve = name == "effort_curve"
            read: Any = read_curve(item) if curve else _positive(item, kinds[name])
            if moves:
                own = values.setdefault("effort_curves" if curve else name, {})
                own[joint] = read
    with blaming(document):
        return MotionLimits(**values, effort_scale=share)


def _share(item: Field) -> float:
    expected = "a share greater than 0, at most 1"
    return item.number(expected, default=1.0, above=0.0, most=1.0)


def _positive(item: Field, kind: LimitKind) -> float:
    return item.number(f"a positive number [{kind.unit}]", above=0.0, infinite=True)


def read_curve(item: Field) -> EffortCurve:
    """Read a curve of torque over speed in any of its forms.

    Raises:
        ScenarioError: If it has none of these forms.
    """
    table = item.table()
    forms = (form for key, form in CURVES.items() if key in table)
    make, keys = next(forms, (EffortCurve, ("speed", "effort")))
    item.only(*keys)
    values = [item.need(name).value for name in keys]
    try:
        return make(*values)
    except ProblemError as error:
        item.get(error.field or "").fail(str(error))
