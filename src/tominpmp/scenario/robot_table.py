"""The robot of a scenario: where it comes from and what differs from its files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.description.fields import Field
from tominpmp.description.files import find_robot, find_srdf
from tominpmp.description.joint_table import JointTable
from tominpmp.description.linkage import Linkage
from tominpmp.exceptions import RobotLoadError, ScenarioError, TominpmpError
from tominpmp.payload import Payload
from tominpmp.robot import DEFAULT_GRAVITY, Robot, load_robot
from tominpmp.scenario.joint_limits import MoveItLimits, load_joint_limits
from tominpmp.scenario.records import classes, field_table, file_name, make
from tominpmp.scene import Obstacle

# Overrides per joint, as load_robot has them.
OVERRIDES = (
    "position_lower",
    "position_upper",
    "velocity",
    "effort",
    "damping",
    "armature",
)
KEYS = (
    "name",
    "path",
    "srdf",
    "package_dirs",
    "joint_limits",
    "gravity",
    "locked_joints",
    "payloads",
    *OVERRIDES,
)


def read_robot(table: Field) -> tuple[Robot, MoveItLimits | None]:
    """Load the robot of a scenario.

    Args:
        table: Its table: ``name`` or ``path``; ``srdf``, ``package_dirs``,
            ``locked_joints``, ``gravity`` and the overrides of :func:`load_robot`;
            ``joint_limits``, a file of MoveIt; ``payloads``, a list of tables with the
            fields of :class:`~tominpmp.payload.Payload`. Paths are relative to the
            scenario.

    Returns:
        The robot, and what that file of MoveIt says.

    Raises:
        ScenarioError: If the table is wrong or the robot cannot be loaded.
    """
    table.only(*KEYS)
    name, path = table.get("name"), table.get("path")
    if name.given == path.given:
        table.fail("expected either the name or the path of a robot")
    folder = table.path.parent
    limits = None
    if table.get("joint_limits").given:
        file = Path(table.get("joint_limits").text()).expanduser()
        limits = load_joint_limits(folder / file)
    arguments: dict[str, Any] = {}
    for key in ("gravity", *OVERRIDES):
        if table.get(key).value is not None:
            arguments[key] = table.get(key).value
    try:
        robot = load_robot(
            name.text() if name.given else folder / Path(path.text()).expanduser(),
            package_dirs=[
                folder / Path(item.text()).expanduser()
                for item in table.get("package_dirs").items()
            ],
            srdf=(
                folder / Path(table.get("srdf").text()).expanduser()
                if table.get("srdf").given
                else None
            ),
            locked_joints=table.get("locked_joints").value or {},
            **_with_limits(limits, arguments),
        )
    except ScenarioError:
        raise
    except TominpmpError as error:
        option = getattr(error, "option", None)
        where = table.get(option) if option in KEYS else table
        where.fail(str(error))
    for item in table.get("payloads").items():
        payload = make(Payload, item.table(), item, classes(Obstacle))
        try:
            robot = robot.with_payload(payload)
        except TominpmpError as error:
            item.fail(str(error))
    return robot, limits


def _with_limits(
    limits: MoveItLimits | None, arguments: dict[str, Any]
) -> dict[str, Any]:
    """Add the limits of MoveIt's file, which the scenario's own go before."""
    for key, values in ({} if limits is None else limits.overrides()).items():
        own = arguments.get(key, {})
        if isinstance(own, Mapping):
            arguments[key] = {**values, **own}
    return arguments


def robot_table(robot: Robot, folder: Path) -> dict[str, Any]:
    """Write down how to load a robot.

    Args:
        robot: The robot.
        folder: Folder of the scenario.

    Returns:
        The table for :func:`read_robot`.

    Raises:
        TypeError: If the robot holds what cannot be written.
    """
    if robot.parts:
        raise TypeError(
            f"it was combined from several: {', '.join(robot.parts)}; expected one "
            "that was loaded"
        )
    table = _source(robot, folder)
    default = find_srdf(robot.urdf_path)
    if "name" in table:
        default = find_robot(robot.name).srdf
    if robot.srdf is not None and robot.srdf.path != default:
        table["srdf"] = file_name(robot.srdf.path, folder)
    if robot.package_dirs:
        table["package_dirs"] = [file_name(d, folder) for d in robot.package_dirs]
    gravity = robot.description.gravity or DEFAULT_GRAVITY
    if not np.array_equal(robot.gravity, gravity):
        table["gravity"] = robot.gravity.tolist()
    followers = {joint.name for joint in robot.description.joints if joint.mimic}
    locked = {k: v for k, v in robot.locked_joints.items() if k not in followers}
    if locked:
        table["locked_joints"] = locked
    kinds = classes(Obstacle)
    payloads = [field_table(payload, kinds, folder) for payload in robot.payloads]
    if payloads:
        table["payloads"] = payloads
    return table | _overrides(robot, locked)


def _source(robot: Robot, folder: Path) -> dict[str, Any]:
    try:
        if find_robot(robot.name).urdf == robot.urdf_path:
            return {"name": robot.name}
    except RobotLoadError:
        pass
    return {"path": file_name(robot.urdf_path, folder)}


def _overrides(robot: Robot, locked: Mapping[str, float]) -> dict[str, Any]:
    """Values per joint that are not those of the description."""
    joints, limits = robot.description.joints, robot.limits
    plain = JointTable.from_description(
        robot.joint_names, joints, Linkage.resolve(joints, locked)
    )
    values: dict[str, Array] = {
        "position_lower": limits.position_lower,
        "position_upper": limits.position_upper,
        "velocity": limits.velocity,
        "effort": np.column_stack([limits.effort_lower, limits.effort_upper]),
        "damping": robot.damping,
        "armature": robot.armature,
    }
    table: dict[str, Any] = {}
    for key, present in values.items():
        described = getattr(plain, key)
        changed = {
            name: present[i].tolist()
            for i, name in enumerate(robot.joint_names)
            if not np.array_equal(present[i], described[i])
        }
        if changed:
            table[key] = changed
    return table
