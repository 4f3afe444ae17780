"""What makers publish about their arms: limits that URDF files lack or have wrong.

One TOML file an arm, each number with the document that it comes from. What is not
published is not in it. Sheets are found by the name of a robot and by its joints, whose
names may have a prefix: ``left_panda_joint1``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

from tominpmp.description.fields import Field
from tominpmp.exceptions import OptionsError, brief
from tominpmp.motion_limits import MotionLimits, kinds_of

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib  # type: ignore[no-redef, import-not-found, unused-ignore]

FOLDER = Path(__file__).parent
# Quantities that are arguments of load_robot, and those of motion limits.
OVERRIDES = ("position_lower", "position_upper", "velocity", "effort", "armature")
QUANTITIES = (*OVERRIDES, *kinds_of(MotionLimits, numbers=True))


@dataclass(frozen=True)
class Source:
    """Where a number comes from.

    Attributes:
        document: The maker's document.
        address: Where it is to be had.
    """

    document: str
    address: str


@dataclass(frozen=True)
class Datasheet:
    """What is published about an arm.

    Attributes:
        title: Maker and model.
        names: Words by which descriptions of it are named.
        joints: Ends of the names of its joints.
        values: By quantity (velocity, effort, acceleration, jerk, effort_rate,
            armature, position_lower, position_upper) the values of the joints, in SI
            units; only what is published.
        sources: Source of each quantity.
    """

    title: str
    names: tuple[str, ...]
    joints: tuple[str, ...]
    values: Mapping[str, tuple[float, ...]]
    sources: Mapping[str, Source]

    def by_joint(self, joint_names: Sequence[str]) -> dict[str, dict[str, float]]:
        """Values by quantity, and by the names that the joints have in a robot.

        Returns:
            Empty if the robot has not all the joints of the sheet.
        """
        found: dict[str, dict[str, float]] = {}
        for prefix in _prefixes(joint_names, self.joints):
            for quantity, values in self.values.items():
                numbers = zip(self.joints, values, strict=True)
                named = {f"{prefix}{joint}": value for joint, value in numbers}
                found.setdefault(quantity, {}).update(named)
        return found


@cache
def datasheets() -> tuple[Datasheet, ...]:
    """All data sheets there are, by title."""
    sheets = [read_datasheet(path) for path in FOLDER.glob("*.toml")]
    return tuple(sorted(sheets, key=lambda sheet: sheet.title))


def read_datasheet(path: Path) -> Datasheet:
    """Read a data sheet.

    Raises:
        ScenarioError: If it is wrong, with the key.
    """
    table = Field(tomllib.loads(path.read_text(encoding="utf-8")), path)
    table.only("title", "names", "joints", "sources", *QUANTITIES)
    joints = tuple(item.text() for item in table.need("joints").items())
    known = {
        key: Source(item.need("document").text(), item.need("address").text())
        for key, item in table.need("sources").table().items()
    }
    values, sources = {}, {}
    for quantity in QUANTITIES:
        entry = table.get(quantity)
        if not entry.given:
            continue
        entry.only("values", "source")
        values[quantity] = tuple(entry.need("values").numbers(len(joints)))
        source = entry.need("source")
        if source.text() not in known:
            source.fail(f"is no source; there are: {', '.join(known)}")
        sources[quantity] = known[source.text()]
    return Datasheet(
        title=table.need("title").text(),
        names=tuple(item.text() for item in table.need("names").items()),
        joints=joints,
        values=MappingProxyType(values),
        sources=MappingProxyType(sources),
    )


def find_datasheet(
    names: Iterable[str | None], joint_names: Sequence[str]
) -> Datasheet | None:
    """Find the data sheet of a robot; of several, that with the most joints.

    Names are those asked for, in its description, and of its file.
    """
    words = [_words(name) for name in names if name]
    fitting = [
        sheet
        for sheet in datasheets()
        if any(_holds(own, _words(name)) for own in words for name in sheet.names)
        and _prefixes(joint_names, sheet.joints)
    ]
    return max(fitting, key=lambda sheet: len(sheet.joints), default=None)


def published_values(
    names: Iterable[str | None], joint_names: Sequence[str], *, needed: bool = True
) -> dict[str, dict[str, float]]:
    """Values of the data sheet of a robot by quantity and joint name.

    Raises:
        OptionsError: If there is none and one is needed, with those there are.
    """
    names = [name for name in names if name]
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
def _words(name: str) -> tuple[str, ...]:
    return tuple(word for word in re.split(r"[\W_]+", name.lower()) if word)


def _holds(words: tuple[str, ...], wanted: tuple[str, ...]) -> bool:
    """Whether words stand in a row among others."""
    n = len(wanted)
    return any(words[i : i + n] == wanted for i in range(len(words) - n + 1))


def _prefixes(joint_names: Sequence[str], joints: Sequence[str]) -> list[str]:
    """What may stand before the names of the joints, so that a robot has them all."""
    first, names = joints[0], set(joint_names)
    found = [name[: -len(first)] for name in joint_names if name.endswith(first)]
    return [p for p in found if all(f"{p}{joint}" in names for joint in joints)]
