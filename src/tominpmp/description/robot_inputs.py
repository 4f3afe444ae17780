"""What a robot may be given as, beside a name or the path of a URDF file.

A text that is a URDF file, a ``yourdfpy.URDF``, a ``pinocchio.Model`` with or without
geometry (also as Pinocchio and example-robot-data return them), and the modules of the
package robot_descriptions, or their names.
"""

from __future__ import annotations

import difflib
import importlib
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pinocchio as pin

from tominpmp.description.files import (
    RobotFiles,
    check_folders,
    find_robot,
    find_srdf,
    robot_names,
)
from tominpmp.description.from_pinocchio import DescribedModel, describe_model
from tominpmp.description.srdf import SemanticDescription, read_semantics
from tominpmp.description.tree import UrdfDescription
from tominpmp.description.urdf import read_parsed, read_urdf
from tominpmp.exceptions import RobotLoadError, brief

# How names in the package robot_descriptions end.
MODULE_ENDING = "_description"
EXPECTED = (
    "the name of a robot, the path or the text of a URDF file, a pinocchio.Model, a "
    "yourdfpy.URDF or a module of robot_descriptions"
)


@dataclass(frozen=True)
class RobotInput:
    """What was given for a robot, read.

    Attributes:
        files: The files; names in angle brackets where there are none.
        description: What a URDF file says.
        semantics: What an SRDF file says, if there is one.
        values: Values by argument of ``load_robot`` and joint name that neither says.
    """

    files: RobotFiles
    description: UrdfDescription
    semantics: SemanticDescription | None
    values: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def read_robot_input(
    source: object,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    srdf: str | os.PathLike[str] | None = None,
    geometry: object = None,
) -> RobotInput:
    """Read what was given for a robot.

    Args:
        source: What ``load_robot`` takes.
        package_dirs: Folders in which to look for ``package://``.
        srdf: Path or text of an SRDF file.
        geometry: Geometry of a ``pinocchio.Model``, see ``load_robot``.

    Raises:
        RobotLoadError: If it is nothing that a robot can be read from.
    """
    folders = check_folders(package_dirs)
    parts = _pinocchio_parts(source, geometry)
    if parts is not None:
        described = describe_model(*parts, package_dirs=folders)
        return _of_model(described, srdf)
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
    return RobotInput(files, description, semantics)


def _of_model(
    described: DescribedModel, srdf: str | os.PathLike[str] | None
) -> RobotInput:
    description, said = described.description, described.semantics
    semantics = said if srdf is None else read_semantics(srdf, description)
    files = RobotFiles(description.path, None)
    return RobotInput(files, description, semantics, {"effort": described.effort})


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
