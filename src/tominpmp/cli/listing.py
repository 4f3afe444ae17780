"""The command ``info``: what a robot consists of."""

from __future__ import annotations

import json
import math
import textwrap
from typing import Any

import typer
from rich.console import Console
from rich.table import Table

from tominpmp.cli.request import RobotRequest
from tominpmp.motion_limits import UNITS
from tominpmp.robot import Robot

# Width of the labels of the rows below the table.
LABEL = 14
# Wider than any table.
UNBOUNDED = 1000


def robot_data(robot: Robot) -> dict[str, Any]:
    """What there is to tell about a robot, in types that JSON knows.

    Infinite limits are None.
    """
    limits = robot.limits
    kinds = {joint.name: joint.kind for joint in robot.description.joints}
    columns = {
        "position_lower": limits.position_lower,
        "position_upper": limits.position_upper,
        "velocity": limits.velocity,
        "effort_lower": limits.effort_lower,
        "effort_upper": limits.effort_upper,
        "damping": robot.damping,
        "armature": robot.armature,
        "friction": robot.friction,
    }
    beyond = robot.motion_limits
    for quantity in UNITS:
        if beyond is not None and getattr(beyond, quantity) is not None:
            columns[quantity] = beyond.by_joint(quantity, robot.joint_names)
    joints = [
        {"name": name, "kind": kinds[name]}
        | {key: _finite(column[i]) for key, column in columns.items()}
        for i, name in enumerate(robot.joint_names)
    ]
    said = robot.srdf
    states = {} if said is None else said.group_states
    followers = [
        joint.name
        for joint in robot.description.joints
        if joint.mimic is not None and joint.name not in robot.locked_joints
    ]
    return {
        "name": robot.name,
        "urdf": str(robot.urdf_path),
        "srdf": None if robot.srdf is None else str(robot.srdf.path),
        "gravity": robot.gravity.tolist(),
        "joints": joints,
        "locked_joints": dict(robot.locked_joints),
        "mimic_joints": followers,
        "passive_joints": list(robot.passive_joints),
        "groups": {
            name: list(group.joints)
            for name, group in ({} if said is None else said.groups.groups).items()
        },
        "group_states": {name: dict(state) for name, state in states.items()},
        "frames": list(robot.frame_names),
        "collision_geometries": int(robot.collision_model.ngeoms),
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def run_info(request: RobotRequest, as_json: bool) -> None:
    """Show a robot.

    Raises:
        TominpmpError: If it cannot be loaded.
    """
    robot = request.load()
    data = robot_data(robot)
    typer.echo(json.dumps(data, indent=2, allow_nan=False) if as_json else _text(data))


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
        "collision": [f"{data['collision_geometries']} geometries"],
        "frames": data["frames"],
        "URDF": [data["urdf"]],
        "SRDF": [data["srdf"] or "none"],
    }
    lines = [f"{data['name']}: {count} joint{'' if count == 1 else 's'}", ""]
    lines += _table_lines(data["joints"])
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


def _table_lines(joints: list[dict[str, Any]]) -> list[str]:
    """Write the table of joints; nothing is left out to fit a screen."""
    console = Console(width=UNBOUNDED)
    with console.capture() as captured:
        console.print(_joint_table(joints))
    return [line.rstrip() for line in captured.get().rstrip().splitlines()]


def _joint_table(joints: list[dict[str, Any]]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("joint")
    table.add_column("kind")
    headings: tuple[str, ...] = (
        "lower",
        "upper",
        "velocity",
        "effort",
        "damping",
        "armature",
    )
    further = [quantity for quantity in UNITS if joints and quantity in joints[0]]
    headings += ("friction", *(name.replace("_", " ") for name in further))
    for heading in headings:
        table.add_column(heading, justify="right")
    for joint in joints:
        low, high = joint["effort_lower"], joint["effort_upper"]
        effort = f"{high:g}" if high == -low else f"{low:g} to {high:g}"
        table.add_row(
            joint["name"],
            joint["kind"],
            _number(joint["position_lower"], "-inf"),
            _number(joint["position_upper"]),
            _number(joint["velocity"]),
            effort,
            _number(joint["damping"]),
            _number(joint["armature"]),
            _number(joint["friction"]),
            *(_number(joint[quantity]) for quantity in further),
        )
    return table


def _number(value: float | None, infinite: str = "inf") -> str:
    return infinite if value is None else f"{value:.5g}"
