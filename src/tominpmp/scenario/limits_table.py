"""The limits of a scenario beyond those of the robot's description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from tominpmp.description.fields import Field
from tominpmp.exceptions import TominpmpError
from tominpmp.motion_limits import UNITS, EffortCurve, MotionLimits
from tominpmp.robot import Robot
from tominpmp.scenario.motion_limits import load_motion_limits
from tominpmp.scenario.records import make


def read_motion_limits(table: Field, robot: Robot) -> MotionLimits | None:
    """Read the limits.

    Args:
        table: Their table, keys as the fields of
            :class:`~tominpmp.motion_limits.MotionLimits`; may be left out. ``file``
            names a YAML file that the other keys go before, see
            :mod:`~tominpmp.scenario.motion_limits`.
        robot: The robot.

    Returns:
        The limits; None if there are none.

    Raises:
        ScenarioError: If the table is wrong.
    """
    if not table.given:
        return None
    table.only("file", *(field.name for field in fields(MotionLimits)))
    values = _of_file(table.get("file"), robot)
    for name, item in table.table().items():
        if name != "file":
            values[name] = _limit(name, item, values.get(name, {}))
    try:
        limits = MotionLimits(**values)
        limits.check(robot.joint_names)
    except TominpmpError as error:
        table.fail(str(error))
    return limits


def _of_file(item: Field, robot: Robot) -> dict[str, Any]:
    """Limits of the YAML file that a table refers to, relative to its own file."""
    if item.value is None:
        return {}
    limits = load_motion_limits(item.path.parent / item.text(), robot)
    found: dict[str, Any] = {"effort_scale": limits.effort_scale}
    if limits.effort_curves:
        found["effort_curves"] = dict(limits.effort_curves)
    for name in UNITS:
        own = getattr(limits, name)
        if own is not None:
            found[name] = dict(own)
    return found


def _limit(name: str, item: Field, before: Mapping[str, Any]) -> Any:
    if name == "effort_curves":
        curves = {
            joint: make(EffortCurve, curve.table(), curve, {})
            for joint, curve in item.table().items()
        }
        return {**before, **curves}
    if isinstance(item.value, dict):
        own = {k: v.number(infinite=True) for k, v in item.table().items()}
        return {**before, **own}
    return item.value


def beyond(
    limits: MotionLimits, others: MotionLimits | None, robot: Robot
) -> MotionLimits:
    """The same limits, so that they are what they are over those of the robot."""
    if others is None:
        return limits
    names = robot.joint_names
    freed: dict[str, Any] = {}
    for name in UNITS:
        own, below = limits.by_joint(name, names), others.by_joint(name, names)
        if np.any(np.isinf(own) & np.isfinite(below)):
            freed[name] = dict(zip(names, own.tolist(), strict=True))
    return replace(limits, **freed)
