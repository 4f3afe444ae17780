"""Which robot: where it is read from, and what is different from its files."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache

from tominpmp.datasheets import published_values
from tominpmp.exceptions import OptionsError, RobotLoadError, TominpmpWarning
from tominpmp.robot import Robot, RobotSource, load_robot, read_source

# More joints than this do not fit on a page, nor can they be planned while one drags.
MOST_JOINTS = 16


@dataclass(frozen=True)
class RobotChoice:
    """A robot as it is loaded.

    Attributes:
        source: Name of a robot, or path of a URDF file.
        group: Group of the SRDF file whose joints move; None for all.
        locked: Joints that do not move, and where they are [rad or m].
        datasheet: Whether the limits are those that the maker publishes.
    """

    source: str
    group: str | None = None
    locked: tuple[tuple[str, float], ...] = ()
    datasheet: bool = False

    def arguments(self) -> dict[str, object]:
        """Arguments of ``load_robot`` beside the source, without those not needed."""
        found: dict[str, object] = {}
        if self.datasheet:
            found["limits"] = "datasheet"
        if self.group is not None:
            found["group"] = self.group
        if self.locked:
            found["locked_joints"] = dict(self.locked)
        return found


@lru_cache(maxsize=8)
def loaded(choice: RobotChoice) -> Robot:
    """Load a robot, once.

    Raises:
        RobotLoadError: If its files cannot be read, or it has too many joints.
        OptionsError: If there is no such group or data sheet.
        JointNotFound: If a locked joint is unknown.
    """
    with warnings.catch_warnings():
        # What is odd about a description was said when it was chosen.
        warnings.simplefilter("ignore", TominpmpWarning)
        robot = load_robot(choice.source, **choice.arguments())  # type: ignore[arg-type]
    if robot.n > MOST_JOINTS:
        raise RobotLoadError(
            f"{robot.name} has {robot.n} joints that move, expected {MOST_JOINTS} at "
            "most: choose a group of joints, if its SRDF file has any",
            robot.urdf_path,
        )
    return robot


@lru_cache(maxsize=8)
def _said(source: str) -> RobotSource:
    """What the files of a robot say, read once.

    Raises:
        RobotLoadError: If there is no such robot, or its files are wrong.
    """
    return read_source(source)


def group_names(source: str) -> tuple[str, ...]:
    """Groups of joints that a robot's SRDF file has and that can move.

    Raises:
        RobotLoadError: If there is no such robot, or its files are wrong.
    """
    said = _said(source).semantics
    if said is None:
        return ()
    return tuple(name for name, group in said.groups.groups.items() if group.joints)


def has_datasheet(source: str) -> bool:
    """Whether the limits that the maker publishes are known.

    Raises:
        RobotLoadError: If there is no such robot, or its files are wrong.
    """
    files = _said(source)
    try:
        published_values(files.names, [j.name for j in files.description.joints])
    except OptionsError:
        return False
    return True
