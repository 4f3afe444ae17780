"""Data sheets of arms, as published by their makers: limits that URDF files lack.

Limits that URDF files set wrongly are included. There is one TOML file per arm, and
each number has its source document. Unpublished values are omitted. Sheets are found by
the name of a robot and by its joints, whose names may have a prefix:
``left_panda_joint1``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

from tominpmp.description.fields import parse_toml
from tominpmp.exceptions import OptionsError, brief
from tominpmp.motion_limits import MotionLimits, kinds_of

FOLDER = Path(__file__).parent
# Quantities of sheets that are columns of a robot's joint table and arguments of
# load_robot, and all quantities of sheets, with motion limits.
SHEET_COLUMNS = ("position_lower", "position_upper", "velocity", "effort", "armature")
QUANTITIES = (*SHEET_COLUMNS, *kinds_of(MotionLimits, numbers=True))


@dataclass(frozen=True)
class Datasheet:
    """Published data of an arm.

    Attributes:
        title: Maker and model.
        names: Names of the arm in descriptions.
        joints: Suffixes of the names of its joints.
        values: Published values of the joints in SI units, by quantity (velocity,
            effort, acceleration, jerk, effort_rate, armature, position_lower,
            position_upper).
    """

    title: str
    names: tuple[str, ...]
    joints: tuple[str, ...]
    values: Mapping[str, tuple[float, ...]]

    def by_joint(self, joint_names: Sequence[str]) -> dict[str, dict[str, float]]:
        """Values by quantity, and by the joint names of a robot.

        Returns:
            The values; empty if the robot lacks a joint of the sheet.
        """
        by_quantity: dict[str, dict[str, float]] = {}
        for prefix in _prefixes(joint_names, self.joints):
            for quantity, values in self.values.items():
                numbers = zip(self.joints, values, strict=True)
                named = {f"{prefix}{joint}": value for joint, value in numbers}
                by_quantity.setdefault(quantity, {}).update(named)
        return by_quantity


@cache
def datasheets() -> tuple[Datasheet, ...]:
    """All available data sheets, sorted by title."""
    sheets = [read_datasheet(path) for path in FOLDER.glob("*.toml")]
    return tuple(sorted(sheets, key=lambda sheet: sheet.title))


def read_datasheet(path: Path) -> Datasheet:
    """Read a data sheet.

    Raises:
        ScenarioError: If it is wrong; names the key.
    """
    table = parse_toml(path.read_bytes(), path)
    table.only("title", "names", "joints", "sources", *QUANTITIES)
    joints = tuple(item.text() for item in table.need("joints").items())
    values = {
        quantity: tuple(table.get(quantity).need("values").numbers(len(joints)))
        for quantity in QUANTITIES
        if table.get(quantity).given
    }
    return Datasheet(
        title=table.need("title").text(),
        names=tuple(item.text() for item in table.need("names").items()),
        joints=joints,
        values=MappingProxyType(values),
    )


def find_datasheet(
    names: Iterable[str], joint_names: Sequence[str]
) -> Datasheet | None:
    """Find the data sheet of a robot; among several, the one with the most joints.

    The names are those of ``UrdfDescription.known_as``.
    """
    words = [_words(name) for name in names]
    fitting = [
        sheet
        for sheet in datasheets()
        if any(_words(name) in own for own in words for name in sheet.names)
        and _prefixes(joint_names, sheet.joints)
    ]
    return max(fitting, key=lambda sheet: len(sheet.joints), default=None)


def published_values(
    names: Sequence[str], joint_names: Sequence[str], *, needed: bool
) -> dict[str, dict[str, float]]:
    """Values of the data sheet of a robot by quantity and joint name.

    Args:
        names: Names of the robot, see :func:`find_datasheet`.
        joint_names: Names of its joints.
        needed: Whether a missing sheet is an error; otherwise there are no values.

    Raises:
        OptionsError: If a sheet is needed and not found; lists the known sheets.
    """
    sheet = find_datasheet(names, joint_names)
    if sheet is None and not needed:
        return {}
    if sheet is None:
        known = ", ".join(f"{sheet.title} ({sheet.names[0]})" for sheet in datasheets())
        raise OptionsError(
            f"limits: no data sheet for {brief(names[0])} with joints "
            f"{', '.join(joint_names[:7])}{', ...' if len(joint_names) > 7 else ''}; "
            f"known: {known}. A sheet is found by the robot's name and its joints",
            "limits",
        )
    return sheet.by_joint(joint_names)


@cache
def _words(name: str) -> str:
    """Words of a name, with a space before and after each."""
    return re.sub(r"[\W_]+", " ", f" {name.lower()} ")


def _prefixes(joint_names: Sequence[str], joints: Sequence[str]) -> list[str]:
    """Prefixes of joint names with which a robot has all joints of a sheet."""
    first, names = joints[0], set(joint_names)
    prefixes = [name[: -len(first)] for name in joint_names if name.endswith(first)]
    return [p for p in prefixes if all(f"{p}{joint}" in names for joint in joints)]
