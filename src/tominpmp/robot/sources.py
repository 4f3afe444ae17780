"""What was given for a robot, read, and what follows from it before a model is made.

Beside a name or the path of a URDF file that may be a text that is one, a
``yourdfpy.URDF``, a ``pinocchio.Model`` with or without geometry (also as Pinocchio and
example-robot-data return them), and the modules of the package robot_descriptions, or
their names.
"""

from __future__ import annotations

import difflib
import importlib
import math
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pinocchio as pin

from tominpmp.datasheets import OVERRIDES, published_values
from tominpmp.description.files import (
    RobotFiles,
    check_folders,
    find_robot,
    find_srdf,
    robot_names,
)
from tominpmp.description.from_pinocchio import describe_model
from tominpmp.description.groups import Group, JointGroups, group_locks
from tominpmp.description.linkage import Linkage
from tominpmp.description.srdf import SemanticDescription, read_semantics
from tominpmp.description.tree import UrdfDescription
from tominpmp.description.urdf import read_parsed, read_urdf
from tominpmp.exceptions import OptionsError, RobotLoadError, brief
from tominpmp.motion_limits import MotionLimits, kinds_of, limits_by_joint

# What the argument ``limits`` may be.
DATASHEET = "datasheet"
# How names in the package robot_descriptions end.
MODULE_ENDING = "_description"
EXPECTED = (
    "the name of a robot, the path or the text of a URDF file, a pinocchio.Model, a "
    "yourdfpy.URDF or a module of robot_descriptions"
)


@dataclass(frozen=True)
class RobotSource:
    """What was given for a robot, read.

    Attributes:
        files: The files; names in angle brackets where there are none.
        description: What a URDF file says.
        semantics: What an SRDF file says, if there is one.
        values: Values by argument of ``load_robot`` and joint name that neither says.
        stated: Limits by quantity and joint name that go before all of these.
    """

    files: RobotFiles
    description: UrdfDescription
    semantics: SemanticDescription | None
    values: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    stated: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str | None, ...]:
        """Names of the robot: asked for, in its description, of the file."""
        return self.files.name, self.description.name, self.files.urdf.stem

    def published(self, limits: str | None) -> dict[str, dict[str, float]]:
        """Values by quantity and joint name: stated, else of the maker's data sheet.

        Args:
            limits: "datasheet" for those of the data sheet, too.

        Raises:
            OptionsError: If limits are neither "datasheet" nor None, or there is no
                sheet.
        """
        if limits not in (None, DATASHEET):
            raise OptionsError(
                f"limits is {brief(limits)}, expected {DATASHEET!r} or None", "limits"
            )
        joints = [joint.name for joint in self.description.joints]
        sheet = {} if limits is None else published_values(self.names, joints)
        return {
            quantity: {**sheet.get(quantity, {}), **self.stated.get(quantity, {})}
            for quantity in {**sheet, **self.stated}
        }

    def motion_limits(
        self, published: Mapping[str, Mapping[str, float]], joint_names: Sequence[str]
    ) -> MotionLimits | None:
        """Limits of accelerations and the like: published, else the URDF file's."""
        joints = self.description.joints
        described = {
            quantity: {
                joint.name: getattr(joint, quantity, math.inf) for joint in joints
            }
            for quantity in kinds_of(MotionLimits, numbers=True)
        }
        own = limits_by_joint(described, joint_names)
        theirs = limits_by_joint(published, joint_names)
        return own if theirs is None else theirs.over(own, joint_names)

    def linkage(
        self, group: Group | None, locked_joints: Mapping[str, float] | None
    ) -> Linkage:
        """Find which joints are locked and which follow others.

        Args:
            group: Group of joints that move, as to :func:`load_robot`; None for all.
            locked_joints: Positions of joints that are not to move [rad or m].

        Raises:
            OptionsError: If there is no such group, or a position is wrong.
            JointNotFound: If a joint is unknown.
        """
        joints = self.description.joints
        locked_joints = {} if locked_joints is None else locked_joints
        # First what the caller gave, with its errors.
        linkage = Linkage.resolve(joints, locked_joints)
        if group is None:
            return linkage
        said = self.semantics
        groups = JointGroups() if said is None else said.groups
        states = {} if said is None else said.group_states
        locks = group_locks(groups, states, self.description, group, locked_joints)
        return Linkage.resolve(joints, locks)

    def other_values(
        self,
        joint_names: Sequence[str],
        published: Mapping[str, Mapping[str, float]],
    ) -> dict[str, dict[str, Any]]:
        """Values that no URDF file says, and published ones, by field and joint."""
        rotors = {} if self.semantics is None else self.semantics.rotor_inertias
        known: dict[str, Mapping[str, Any]] = {"armature": rotors, **self.values}
        known |= published
        return {
            key: {name: known[key][name] for name in joint_names if name in known[key]}
            for key in OVERRIDES
            if key in known
        }


def read_source(
    source: object,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    srdf: str | os.PathLike[str] | None = None,
    geometry: object = None,
) -> RobotSource:
    """Read what was given for a robot; what was read already is taken as it is.

    Args:
        source: What ``load_robot`` takes.
        package_dirs: Folders in which to look for ``package://``.
        srdf: Path or text of an SRDF file.
        geometry: Geometry of a ``pinocchio.Model``, see ``load_robot``.

    Raises:
        RobotLoadError: If it is nothing that a robot can be read from.
    """
    if isinstance(source, RobotSource):
        return source
    folders = check_folders(package_dirs)
    parts = _pinocchio_parts(source, geometry)
    if parts is not None:
        description, semantics, effort = describe_model(*parts, package_dirs=folders)
        files = RobotFiles(description.path, srdf=None)
        if srdf is not None:
            semantics = read_semantics(srdf, description)
        return RobotSource(files, description, semantics, {"effort": effort})
    if geometry is not None:
        raise RobotLoadError(
            f"geometry is given beside {brief(source)}; it belongs to a pinocchio.Model"
        )
    text = _text(source)
    if text is not None:
        files = RobotFiles(Path(f"<text of {len(text)} bytes>"), None)
        description = read_urdf(files.urdf, folders, text)
    elif _is_yourdfpy(source):
        files = RobotFiles(Path(f"<yourdfpy.URDF {source.robot.name}>"), None)  # type: ignore[attr-defined]
        description = read_parsed(source, files.urdf, folders)
    else:
        files, more = _find(source)
        description = read_urdf(files.urdf, (*folders, *more))
    semantics = read_semantics(files.srdf if srdf is None else srdf, description)
    return RobotSource(files, description, semantics)


def _pinocchio_parts(
    source: object, geometry: object
) -> tuple[pin.Model, pin.GeometryModel | None, pin.GeometryModel | None] | None:
    """Model, collision and visual geometry; None if it is no model of Pinocchio."""
    shapes: list[Any] = []
    if isinstance(source, tuple) and source and isinstance(source[0], pin.Model):
        source, *shapes = source  # as buildModelsFromUrdf returns them
    wrapped = getattr(source, "model", None)
    if isinstance(wrapped, pin.Model):  # a RobotWrapper, as of example_robot_data
        shapes = [getattr(source, f"{kind}_model", None) for kind in _KINDS]
        source = wrapped
    if not isinstance(source, pin.Model):
        return None
    if geometry is not None:
        listed = isinstance(geometry, tuple | list)
        shapes = list(geometry) if listed else [geometry]  # type: ignore[call-overload]
    known = all(isinstance(item, pin.GeometryModel | None) for item in shapes)
    if not known or len(shapes) > len(_KINDS):
        raise RobotLoadError(
            f"geometry is {brief(geometry if geometry is not None else shapes)}, "
            "expected a pinocchio.GeometryModel to collide with, or two: to collide "
            "with and to look at"
        )
    collision, visual = [*shapes, None, None][:2]
    return source, collision, visual


_KINDS = ("collision", "visual")


def _text(source: object) -> bytes | None:
    """A text that is given instead of the name of a file; None if it is none."""
    if isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<"):
        # A declaration would name another encoding than that of the text given.
        return source.lstrip("\ufeff \t\r\n").encode("utf-8", "replace")
    if isinstance(source, bytes) and source.lstrip().startswith(b"<"):
        return source.lstrip()
    return None


def _is_yourdfpy(source: object) -> bool:
    """Whether it is a ``yourdfpy.URDF``, without importing that."""
    known = sys.modules.get("yourdfpy")
    return known is not None and isinstance(source, known.URDF)


def _find(source: object) -> tuple[RobotFiles, tuple[Path, ...]]:
    """Files of a robot by name, path or module, and folders of its packages."""
    if isinstance(source, str) and _is_module_name(source):
        return _of_module(_imported(source), source)
    named = isinstance(source, str | os.PathLike)
    if not named and getattr(source, "__name__", "").startswith("robot_descriptions"):
        return _of_module(source, str(getattr(source, "__name__", "")))
    if not named and isinstance(getattr(source, "URDF_PATH", None), str | os.PathLike):
        return _of_module(source, str(getattr(source, "__name__", "")))
    if not named:
        raise RobotLoadError(f"the robot is {brief(source)}, expected {EXPECTED}")
    return find_robot(source), ()  # type: ignore[arg-type]


def _is_module_name(name: str) -> bool:
    plain = name.isidentifier() and name.endswith(MODULE_ENDING)
    return plain and name not in robot_names()


def _imported(name: str) -> Any:
    """Import a module of robot_descriptions, which may fetch files at that."""
    try:
        importlib.import_module("robot_descriptions")
    except ImportError as error:
        raise RobotLoadError(
            f"there is no robot {brief(name)}; names that end with {MODULE_ENDING!r} "
            "are those of the package robot_descriptions: python -m pip install "
            "robot_descriptions"
        ) from error
    try:
        return importlib.import_module(f"robot_descriptions.{name}")
    except ModuleNotFoundError as error:
        close = difflib.get_close_matches(name, _module_names(), n=3)
        hint = f"; did you mean {' or '.join(close)}?" if close else ""
        raise RobotLoadError(
            f"the package robot_descriptions has no module {brief(name)}{hint}"
        ) from error
    except Exception as error:  # whatever fetching files may raise
        raise RobotLoadError(
            f"robot_descriptions.{name} cannot be had: {brief(str(error), 200)}"
        ) from error


def _module_names() -> list[str]:
    try:
        listed = importlib.import_module("robot_descriptions._descriptions")
        return list(listed.DESCRIPTIONS)
    except (ImportError, AttributeError, TypeError):
        return []


def _of_module(module: Any, name: str) -> tuple[RobotFiles, tuple[Path, ...]]:
    urdf = getattr(module, "URDF_PATH", None)
    if not isinstance(urdf, str | os.PathLike):
        other = [kind for kind in ("MJCF", "XACRO") if hasattr(module, f"{kind}_PATH")]
        has = f"has {' and '.join(other)} only" if other else "has none"
        raise RobotLoadError(
            f"the module {brief(name)} {has}, expected one with a URDF file (URDF_PATH)"
        )
    path = Path(urdf).absolute()
    folders = {
        Path(getattr(module, key)).absolute()
        for key in ("PACKAGE_PATH", "REPOSITORY_PATH")
        if isinstance(getattr(module, key, None), str | os.PathLike)
    }
    around = {p for folder in folders for p in (folder, folder.parent) if p.is_dir()}
    found = RobotFiles(path, find_srdf(path), name.rpartition(".")[2] or None)
    return found, tuple(sorted(around))
