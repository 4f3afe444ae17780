"""Conversion of obstacles, goals and options to tables of a file, and back.

A table names the class by its key ``type`` and has a key for every field; fields with
their default value are omitted. New shapes, goals and limits, including a caller's own,
need no change here as long as their fields are numbers, texts, arrays, placements,
paths, or records of these classes.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
import tomli_w

from tominpmp.arrays import changed_fields
from tominpmp.constraints.path import PathConstraint
from tominpmp.description.fields import Field
from tominpmp.exceptions import (
    ScenarioError,
    SceneError,
    TominpmpError,
    brief,
    unknown,
)
from tominpmp.goals.base import Goal
from tominpmp.motion_limits import EffortCurve, MotionLimits
from tominpmp.options import Options
from tominpmp.problem.segments import Segment
from tominpmp.robot.payload import Payload
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.motion import Motion, PoseFunction
from tominpmp.scene.obstacles import Obstacle
from tominpmp.scene.rotations import rotation_matrix
from tominpmp.scene.scene import Scene

T = TypeVar("T")

# Text for None where a field has another default; TOML has no null value.
NONE = "none"
# Classes whose tables have no key ``type``, and base classes whose tables have one.
UNNAMED = (EffortCurve, MotionLimits, Options, Payload, Scene, Segment)
NAMED: tuple[type[Any], ...] = (Goal, Obstacle, PathConstraint, Motion)
# A list of plain values without texts; string literals contain no line breaks.
_ROW = re.compile(r"\[\n([^][\"]*)\]")


@contextmanager
def blaming(item: Field) -> Iterator[None]:
    """Turn errors of the library within this block into errors about a file's value.

    Raises:
        ScenarioError: In place of any other error of the library, also of errors about
            another file, which the value names.
    """
    try:
        yield
    except TominpmpError as error:
        if isinstance(error, ScenarioError) and error.path == item.path:
            raise
        item.blame(error)


def keys_in_brief(keys: Iterable[str]) -> list[str]:
    """Keys of a caller's file for a warning: cut, control characters escaped."""
    return [brief(key).strip("'\"") for key in keys]


def classes(base: type[Any]) -> dict[str, type[Any]]:
    """Find the classes of a kind by their names in files, including a caller's own.

    The classes of this library are in modules next to that of the base class. The name
    of the kind is cut off the class name, unless it is a constraint: ``JointGoal`` is
    "joint", ``AllGoals`` is "all", ``ToolSpeed`` is "tool_speed". Motions by a function
    are excluded, as a file cannot hold them.

    Args:
        base: Base class of the kind.
    """
    _import_all(base.__module__.rpartition(".")[0])
    ending = "" if base is PathConstraint else f"{base.__name__}s?"
    named: list[tuple[str, type[Any]]] = []
    for kind in _derived(base):
        # Shared base classes are excluded: they are abstract, or not dataclasses.
        concrete = "__dataclass_fields__" in vars(kind) and kind is not PoseFunction
        if concrete and not getattr(kind, "__abstractmethods__", None):
            name = re.sub(rf"{ending}$", "", kind.__name__)
            named.append((re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower(), kind))
    # Names of this library keep their meaning if a caller defines the same name.
    named.sort(key=lambda pair: pair[1].__module__.startswith("tominpmp."))
    return dict(named)


@cache
def _import_all(package: str) -> None:
    """Import all modules of a package."""
    for item in iter_modules(import_module(package).__path__):
        import_module(f"{package}.{item.name}")


def _derived(base: type[Any]) -> Iterator[type[Any]]:
    """Subclasses of a class, sorted by module, whatever the order of the imports."""

    def order(kind: type[Any]) -> tuple[bool, str]:
        return kind.__module__ != base.__module__, kind.__module__

    for child in sorted(base.__subclasses__(), key=order):
        yield child
        yield from _derived(child)


def to_table(record: Any, folder: Path) -> Any:
    """Turn a value into a form that TOML can represent.

    Args:
        record: A record of a scenario, or any value that its fields may have.
        folder: Folder of the file; paths inside it are written relative to it.

    Raises:
        TypeError: If a value cannot be written.
    """
    if isinstance(record, pin.SE3):
        return _placement_table(record)
    if isinstance(record, np.ndarray | np.generic):
        return record.tolist()
    if isinstance(record, os.PathLike):
        return file_name(Path(record), folder)
    if isinstance(record, bool | int | float | str):
        return record
    if isinstance(record, Mapping):
        return {str(k): to_table(v, folder) for k, v in record.items()}
    if isinstance(record, list | tuple):
        return [to_table(item, folder) for item in record]
    if isinstance(record, Obstacle) and isinstance(record.motion, PoseFunction):
        raise TypeError(
            f"obstacle {record.name!r} is moved by a function, which a file cannot "
            "hold; ConstantVelocity and Waypoints can be written"
        )
    if isinstance(record, UNNAMED):
        return _field_table(record, folder)
    kinds = (classes(base) for base in NAMED if isinstance(record, base))
    named = {kind: name for found in kinds for name, kind in found.items()}
    if type(record) not in named:
        raise TypeError(f"a {type(record).__name__} cannot be written")
    table = {"type": named[type(record)]} | _field_table(record, folder)
    if isinstance(record, Mesh) and _is_as_in_file(record):
        table = {k: v for k, v in table.items() if k not in ("vertices", "triangles")}
    return table


def _is_as_in_file(mesh: Mesh) -> bool:
    """Whether a mesh has a file that still contains its vertices and triangles."""
    unread: dict[str, Any] = {"vertices": None, "triangles": None}
    try:
        return mesh.path is not None and mesh == replace(mesh, **unread)
    except SceneError:
        return False


def _field_table(record: Any, folder: Path) -> dict[str, Any]:
    """Turn the fields of a record that differ from their defaults into a table.

    Raises:
        TypeError: If a value cannot be written.
    """
    table: dict[str, Any] = {}
    for name, value in changed_fields(record).items():
        if name == "rotation" and isinstance(value, np.ndarray):
            table[name] = rotation_values(value)
        else:
            table[name] = NONE if value is None else to_table(value, folder)
    if table.get("dwell"):
        del table["stop"]  # a dwell implies a stop
    return table


def rotation_values(rotation: np.ndarray[Any, Any]) -> list[Any]:
    """Write a rotation as a quaternion if that reproduces it to the last bit."""
    quaternion = pin.Quaternion(np.array(rotation)).coeffs()
    for digits in (3, 9, 15, 17):
        rounded = np.round(quaternion, digits)
        if np.array_equal(rotation_matrix(rounded), rotation):
            return list(rounded.tolist())
    return list(rotation.tolist())


def _placement_table(placement: pin.SE3) -> dict[str, Any]:
    """Write a placement as position and rotation."""
    table: dict[str, Any] = {"position": placement.translation.tolist()}
    if not np.array_equal(placement.rotation, np.eye(3)):
        table["rotation"] = rotation_values(placement.rotation)
    return table


def file_name(path: Path, folder: Path) -> str:
    """Write a path: relative to the folder if it is inside or is it, else absolute."""
    path, folder = path.absolute(), folder.absolute()  # ".." may follow a link
    inside = path.is_relative_to(folder)
    return path.relative_to(folder).as_posix() if inside else str(path)


def from_table(table: Field, kinds: Mapping[str, type[Any]], noun: str) -> Any:
    """Make a record from its table; the key ``type`` selects one of the classes.

    Raises:
        ScenarioError: If the table is wrong.
    """
    kind = table.need("type")
    if not isinstance(kind.value, str) or kind.value not in kinds:
        kind.fail(unknown(noun, kind.value, list(kinds)))
    return make(kinds[kind.value], table, kinds, "type")


def make(kind: type[T], table: Field, kinds: Mapping[str, Any], *beside: str) -> T:
    """Make a record from the fields of a table.

    Args:
        kind: Class of the record.
        table: The table.
        kinds: Classes of tables in it, by the names that ``type`` may have there.
        *beside: Keys of the table that are not fields of the record.

    Raises:
        ScenarioError: If a field is unknown, missing or wrong.
    """
    known = {field.name: field for field in fields(kind) if field.init}  # type: ignore[arg-type]
    table.only(*known, *beside)
    values = {k: v for k, v in table.table().items() if k not in beside}
    for name, field in known.items():
        if field.default is MISSING and field.default_factory is MISSING:
            table.need(name)
    arguments = {
        name: _value(item, known[name], kinds) for name, item in values.items()
    }
    try:
        return kind(**arguments)
    except (TominpmpError, TypeError, ValueError, OverflowError) as error:
        blamed = [name for name in values if re.search(rf"\b{name}\b", str(error))]
        where = values[blamed[0]] if len(blamed) == 1 else table
        where.fail(str(error))


def _value(item: Field, field: Any, kinds: Mapping[str, Any]) -> Any:
    value = item.value
    if value == NONE and "None" in str(field.type):
        return None
    if isinstance(value, str) and "Path" in str(field.type):
        return item.path.parent / value
    if field.name == "motion":
        return from_table(item, classes(Motion), "motion")
    return _plain(item, kinds)


def _plain(item: Field, kinds: Mapping[str, Any]) -> Any:
    value = item.value
    if isinstance(value, dict):
        if "type" in value:
            return from_table(item, kinds, "class")
        if {"position", "rotation"} & value.keys():
            return _read_placement(item)
    if isinstance(value, list) and any(isinstance(entry, dict) for entry in value):
        return tuple(_plain(entry, kinds) for entry in item.items())
    return value


def _read_placement(item: Field) -> pin.SE3:
    """Read a placement: position, and rotation as quaternion or 3x3 matrix.

    Raises:
        ScenarioError: If it is not a placement.
    """
    item.only("position", "rotation")
    position = np.array(item.need("position").numbers(3))
    rotation = item.get("rotation")
    with blaming(rotation):
        return pin.SE3(np.array(rotation_matrix(rotation.value)), position)


def toml_text(table: Mapping[str, Any]) -> str:
    """Format a TOML document with tomli-w, but with rows of numbers on one line.

    Args:
        table: Texts, truth values, numbers, lists, and tables of them; a list of tables
            becomes an array of tables. Keys and lists keep their order, except that
            plain values come before tables, as TOML requires.

    Returns:
        The document, ending with a line break.
    """

    def on_one_line(row: re.Match[str]) -> str:
        return f"[{' '.join(row[1].split()).removesuffix(',')}]"

    return _ROW.sub(on_one_line, tomli_w.dumps(table))
