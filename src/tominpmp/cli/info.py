"""The command ``info``: what a robot consists of."""

from __future__ import annotations

import textwrap
from dataclasses import fields
from typing import Any, cast

from rich.console import Console

from tominpmp.cli.options import RobotOptions
from tominpmp.cli.problem import load_changed_robot
from tominpmp.cli.report import json_text, plain
from tominpmp.cli.terminal import say
from tominpmp.motion_limits import UNITS
from tominpmp.robot import Robot

# Width of the labels of the rows below the table.
LABEL = 14


def robot_data(robot: Robot) -> dict[str, Any]:
    """What there is to tell about a robot, in types that JSON knows.

    Infinite limits are None.
    """
    limits, beyond, semantics = robot.limits, robot.motion_limits, robot.srdf
    kinds = {joint.name: joint.kind for joint in robot.description.joints}
    columns = {item.name: getattr(limits, item.name) for item in fields(limits)}
    columns |= {key: getattr(robot, key) for key in ("damping", "armature", "friction")}
    for quantity in UNITS:
        if beyond is not None and getattr(beyond, quantity) is not None:
            columns[quantity] = beyond.by_joint(quantity, robot.joint_names)
    data = {
        "name": robot.name,
        "urdf": robot.urdf_path,
        "srdf": None if semantics is None else semantics.path,
        "gravity": robot.gravity,
        "joints": [
            {"name": name, "kind": kinds[name]}
            | {key: column[i] for key, column in columns.items()}
            for i, name in enumerate(robot.joint_names)
        ],
        "locked_joints": robot.locked_joints,
        "mimic_joints": [
            joint.name
            for joint in robot.description.joints
            if joint.mimic is not None and joint.name not in robot.locked_joints
        ],
        "passive_joints": robot.passive_joints,
        "groups": {}
        if semantics is None
        else {name: group.joints for name, group in semantics.groups.groups.items()},
        "group_states": {} if semantics is None else semantics.group_states,
        "frames": robot.frame_names,
        "collision_geometries": int(robot.collision_model.ngeoms),
    }
    return cast("dict[str, Any]", plain(data))


def run_info(robot: str, args: RobotOptions, as_json: bool) -> None:
    """Show a robot.

    Raises:
        TominpmpError: If it cannot be loaded.
    """
    data = robot_data(load_changed_robot(robot, args))
    say(json_text(data) if as_json else _text(data))


def _text(data: dict[str, Any]) -> str:
    """Write the data for people; fitted to the screen if there is one."""
    console = Console()
    width = console.width if console.is_terminal else None
    count = len(data["joints"])
    locked = [f"{name}={value:g}" for name, value in data["locked_joints"].items()]
    rows = {
        "gravity": [f"{value:g}" for value in data["gravity"]],
        "locked": locked,
        "mimic": data["mimic_joints"],
        "passive": data["passive_joints"],
        "groups": list(data["groups"]),
        "group states": list(data["group_states"]) or ["none"],
        "collision": [_counted(data["collision_geometries"])],
        "frames": data["frames"],
        "URDF": [data["urdf"]],
        "SRDF": [data["srdf"] or "none"],
    }
    lines = [f"{data['name']}: {count} joint{'' if count == 1 else 's'}", ""]
    lines += _table(data["joints"])
    lines += ["", "Units: rad, rad/s, N m; for prismatic joints m, m/s, N.", ""]
    lines += [_row(name, row, width) for name, row in rows.items() if row]
    return "\n".join(lines)


def _row(label: str, items: list[str], width: int | None) -> str:
    """Write a label and a list, wrapped if there is a width."""
    row = f"{label:<{LABEL}}{', '.join(items)}"
    if width is None or len(items) == 1:
        return row
    return textwrap.fill(
        row,
        max(width, 2 * LABEL),
        subsequent_indent=" " * LABEL,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _table(joints: list[dict[str, Any]]) -> list[str]:
    """Write the table of joints; nothing is left out to fit a screen."""
    heads = {key: key.replace("position_", "").replace("_", " ") for key in joints[0]}
    del heads["effort_lower"]
    heads |= {"name": "joint", "effort_upper": "effort"}
    rows = [list(heads.values())]
    for joint in joints:
        cells = {key: _cell(key, value) for key, value in joint.items()}
        low, high = joint["effort_lower"], joint["effort_upper"]
        if high is None or low != -high:
            cells["effort_upper"] = (
                f"{cells['effort_lower']} to {cells['effort_upper']}"
            )
        rows.append([cells[key] for key in heads])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for name, kind, *numbers in rows:
        words = [name.ljust(widths[0]), kind.ljust(widths[1])]
        words += [n.rjust(w) for n, w in zip(numbers, widths[2:], strict=True)]
        lines.append("  ".join(words))
    return lines


def _cell(key: str, value: Any) -> str:
    """Write a value; numbers that JSON does not know are infinite."""
    if value is None:
        return "-inf" if key.endswith("lower") else "inf"
    return value if isinstance(value, str) else f"{value:.5g}"


def _counted(count: int) -> str:
    return "1 geometry" if count == 1 else f"{count} geometries"
