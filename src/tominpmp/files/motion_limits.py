"""Limits of motors and controllers from a YAML file, joint by joint.

::

    effort_scale: 0.95          # share of the torque limits that motions may use
    effort_rate: 1000           # every joint that has none of its own [N m/s]
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

Acceleration, jerk and effort rate may stand at the top, for all joints, and at a joint,
which goes before.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.checks import instance
from tominpmp.description.fields import Field
from tominpmp.description.paths import checked_path
from tominpmp.description.yaml_reader import read_yaml
from tominpmp.exceptions import JointNotFound, ScenarioError, TominpmpError
from tominpmp.motion_limits import UNITS, EffortCurve, MotionLimits
from tominpmp.robot import Robot

# Forms of a curve, by the first of their keys.
CURVES: dict[str, tuple[Any, tuple[str, ...]]] = {
    "stall": (EffortCurve.droop, ("stall", "no_load_speed")),
    "power": (EffortCurve.power, ("effort", "power", "top_speed")),
}


def load_motion_limits(path: str | Path, robot: Robot) -> MotionLimits:
    """Read limits of accelerations, jerks and torques from a YAML file.

    Args:
        path: The file; see the module for what is in it.
        robot: The robot. Joints of it that are locked may be in the file, and are left
            out.

    Returns:
        The limits, for the joints that move.

    Raises:
        ScenarioError: If the file cannot be read or is wrong: the message names the
            key, the value and what was expected.
    """
    path = checked_path(path, "path", ScenarioError)
    instance(robot, Robot, "robot")
    document = Field(read_yaml(path), path)
    document.only("effort_scale", "joints", *UNITS)
    if not document.given:
        document.fail(f"is empty, expected {', '.join(UNITS)}, effort_scale or joints")
    scale = document.get("effort_scale")
    share = 1.0 if scale.value is None else scale.number()
    if not 0.0 < share <= 1.0:
        scale.fail(f"is {share:g}, expected a share greater than 0, at most 1")
    values = {
        name: dict.fromkeys(robot.joint_names, _positive(item, name))
        for name in UNITS
        if (item := document.get(name)).value is not None
    }
    curves: dict[str, EffortCurve] = {}
    joints = document.get("joints")
    for joint, limits in joints.table().items() if joints.value is not None else ():
        moves = joint in robot.joint_names
        if not moves and joint not in robot.locked_joints:
            limits.fail(str(JointNotFound(joint, robot.joint_names)))
        limits.only("effort_curve", *UNITS)
        for name, item in limits.table().items():
            read: Any = _curve(item) if name == "effort_curve" else None
            if read is None:
                read = _positive(item, name)
            if moves and name == "effort_curve":
                curves[joint] = read
            elif moves:
                values.setdefault(name, {})[joint] = read
    return MotionLimits(**values, effort_scale=share, effort_curves=curves)


def _positive(item: Field, name: str) -> float:
    number = item.number(infinite=True)
    if not number > 0.0:
        item.fail(f"is {number:g}, expected a positive number [{UNITS[name]}]")
    return number


def _curve(item: Field) -> EffortCurve:
    """Curve of torque over speed in one of its forms."""
    given = item.table()
    for key, (make, names) in CURVES.items():
        if key in given:
            item.only(*names)
            numbers = [item.need(name).number() for name in names]
            for name, number in zip(names, numbers, strict=True):
                if not number > 0.0:
                    item.get(name).fail(f"is {number:g}, expected a positive number")
            curve: EffortCurve = make(*numbers)
            return curve
    item.only("speed", "effort")
    rows = [np.array(item.need(name).numbers()) for name in ("speed", "effort")]
    try:
        return EffortCurve(*rows)
    except TominpmpError as error:
        item.fail(str(error))
