"""What callers have for points, rotations, poses and values by joint.

NumPy arrays, SciPy's ``Rotation`` and ``RigidTransform``, ``pinocchio.SE3`` and its
quaternions, matrices, pairs of a position and a rotation, messages of ROS and mappings
are brought into plain numbers here, and nowhere else. What is none of these is left as
it is: whoever asked for it knows what to say of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import (
    Array,
    array_or_nan,
    frozen_array,
    real_array,
    real_number,
)
from tominpmp.checks import wrong
from tominpmp.exceptions import ProblemError, brief, closest

#: A point or another vector in space: three numbers, or what has x, y and z.
VectorLike: TypeAlias = "ArrayLike | Mapping[str, float]"
#: A 3x3 matrix, a quaternion (x, y, z, w), or a ``Rotation`` of SciPy.
RotationLike: TypeAlias = "ArrayLike | Mapping[str, float] | Any"
#: A ``pinocchio.SE3``, a 4x4 matrix, or a pair of a position and a rotation.
PoseLike: TypeAlias = "ArrayLike | tuple[Any, Any] | Mapping[str, Any] | Any"
#: One number for each joint in the order of the robot, or numbers by joint name.
JointsLike: TypeAlias = "ArrayLike | Mapping[str, float]"

POSE = (
    "a pinocchio.SE3, a 4x4 matrix, or a pair of a position [m] and a rotation "
    "(3x3 matrix, quaternion xyzw or scipy's Rotation)"
)
# What the keys of a pose are called.
PLACES = ("position", "translation", "xyz")
TURNS = ("rotation", "orientation", "quaternion", "xyzw", "quat")
# A locked joint that is given may be this far from where it is [rad or m].
SAME = 1e-6
# What the square of a unit vector may be off by.
ROUNDING = 1e-15


def plain_vector(value: object) -> object:
    """A point as numbers: of what has x, y and z, these."""
    return _by_axes(value, "xyz")


def plain_rotation(value: object) -> object:
    """A rotation, or a row of them, as matrices or quaternions (x, y, z, w)."""
    if isinstance(value, type) or isinstance(value, np.ndarray):
        return value
    if isinstance(value, list | tuple) and value and not _is_number(value[0]):
        return [plain_rotation(item) for item in value]
    for name in ("as_matrix", "coeffs", "toRotationMatrix"):
        method = _attribute(value, name)
        if callable(method):
            try:
                return np.asarray(method())
            except Exception:  # of a stranger's method
                return value
    return _by_axes(value, "xyzw")


def split_pose(value: object) -> tuple[object, object] | None:
    """Position and rotation of a pose, as plain numbers; None if it is no pose."""
    if isinstance(value, type):
        return None
    found = _by_names(value)
    if found is None and isinstance(value, list | tuple) and len(value) == 2:
        found = value[0], value[1]
    if found is None:
        return _of_array(value)
    position, rotation = found
    return plain_vector(position), plain_rotation(rotation)


def _by_names(value: object) -> tuple[object, object] | None:
    """What is called the position and the rotation of a pose."""
    if isinstance(value, Mapping):
        places = [key for key in PLACES if key in value]
        turns = [key for key in TURNS if key in value]
        if len(places) == len(turns) == 1 and len(value) == 2:
            return value[places[0]], value[turns[0]]
        return None
    for place, turn in (("translation", "rotation"), ("position", "orientation")):
        found = _attribute(value, place), _attribute(value, turn)
        if all(part is not None and not callable(part) for part in found):
            return found
    return None


def _of_array(value: object) -> tuple[object, object] | None:
    """Position and rotation in a matrix, or in seven numbers."""
    array = array_or_nan(value)
    if array.shape == (4, 4) and np.array_equal(array[3], [0.0, 0.0, 0.0, 1.0]):
        return array[:3, 3], array[:3, :3]
    if array.shape == (7,):
        return array[:3], array[3:]
    return None


def _by_axes(value: object, names: str) -> object:
    """Numbers of what has them by the names of axes, and no others."""
    if isinstance(value, Mapping):
        same = set(value) == set(names)
        return [value[name] for name in names] if same else value
    if isinstance(value, np.ndarray | list | tuple | type):
        return value
    found = [_attribute(value, name) for name in names]
    more = "w" not in names and _attribute(value, "w") is not None
    return found if all(map(_is_number, found)) and not more else value


def vector(
    value: object,
    name: str,
    expected: str,
    size: int | None = None,
    *,
    infinite: bool = False,
) -> Array:
    """Check a caller's vector.

    Args:
        value: What the caller gave.
        name: What it is, for the message.
        expected: What it should be.
        size: How many numbers; None for any.
        infinite: Whether they may be infinite.

    Raises:
        ProblemError: If it is none.
    """
    try:
        array = real_array(plain_vector(value) if size == 3 else value)
    except ValueError as error:
        raise wrong(value, name, expected) from error
    if array.ndim != 1 or size not in (None, array.size):
        raise ProblemError(f"{name} has shape {array.shape}, expected {expected}", name)
    if np.any(np.isnan(array)) or not (infinite or np.all(np.isfinite(array))):
        which = "none of them NaN" if infinite else "all finite"
        raise wrong(array.tolist(), name, f"{expected}, {which}")
    return array


def direction(value: object, name: str) -> Array:
    """Check a caller's direction, of any length but zero, and make it one of length 1.

    Raises:
        ProblemError: If it is none.
    """
    expected = "three numbers, not all zero"
    found = vector(value, name, expected, 3)
    largest = float(np.max(np.abs(found)))
    if largest == 0.0:
        raise wrong(found.tolist(), name, expected)
    # Divided again, as by saving and loading, a unit vector would change.
    if largest > 1.0 or abs(float(found @ found) - 1.0) > ROUNDING:
        found = found / largest  # so that no square overflows
        found = found / np.linalg.norm(found)
    return frozen_array(found)


def _attribute(value: object, name: str) -> Any:
    try:
        return getattr(value, name, None)
    except Exception:  # of a stranger's property
        return None


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


# -- values by joint -------------------------------------------------------------------


def by_joint(value: object) -> dict[str, object] | None:
    """Values by the names of joints; None if there are no names.

    Mappings, rows with an index of names (pandas) and messages with ``name`` and
    ``position`` (ROS) have them.
    """
    if isinstance(value, Mapping):
        return dict(value) or None
    if isinstance(value, np.ndarray | list | tuple | str | bytes | type):
        return None
    names, positions = _attribute(value, "name"), _attribute(value, "position")
    if isinstance(names, Sequence) and not isinstance(names, str):
        if positions is not None and len(names) == np.size(positions):
            return dict(zip(names, np.asarray(positions).tolist(), strict=True))
        return None
    labelled = _attribute(value, "to_dict")
    if callable(labelled) and _attribute(value, "index") is not None:
        found = labelled()
        text = isinstance(found, dict) and all(isinstance(key, str) for key in found)
        return found if text else None
    return None


def named_row(value: object, name: str) -> tuple[tuple[str, ...] | None, object]:
    """Names of joints and their values, in the order given; no names for a plain row.

    Raises:
        ProblemError: If names are none.
    """
    found = by_joint(value)
    if found is None:
        return None, value
    if not all(isinstance(joint, str) and joint for joint in found):
        raise wrong(value, name, "numbers, or numbers by joint name")
    return tuple(found), [_number(x, joint, name) for joint, x in found.items()]


def in_order(
    values: Mapping[str, object],
    joints: Sequence[str],
    name: str,
    *,
    others: Mapping[str, float] | None = None,
    missing: float | None = None,
) -> Array:
    """Values by joint name as an array in the order of the joints.

    Args:
        values: The values.
        joints: Names of the joints.
        name: What it is, for messages.
        others: Joints that do not move, with their positions, which may be given too;
            None if they are not to be looked at.
        missing: Value of joints that are not named; None if all have to be.

    Returns:
        Shape (n,).

    Raises:
        ProblemError: If a joint is missing or unknown, a value is no number, or one
            that does not move is elsewhere.
    """
    for joint, value in values.items():
        if joint not in joints:
            _check_other(joint, value, joints, name, others)
    lacking = [joint for joint in joints if joint not in values]
    if lacking and missing is None:
        raise ProblemError(
            f"{name} says nothing about {', '.join(lacking)}, expected a value for "
            f"each of: {', '.join(joints)}",
            name,
        )
    return np.array([_number(values.get(j, missing), j, name) for j in joints])


def _number(value: object, joint: str, name: str) -> float:
    try:
        return real_number(value)
    except ValueError as error:
        raise ProblemError(
            f"{name}: joint {joint!r} is {brief(value)}, expected a number", name
        ) from error


def _check_other(
    joint: object,
    value: object,
    joints: Sequence[str],
    name: str,
    others: Mapping[str, float] | None,
) -> None:
    """Check a value of a joint that is none of those asked for."""
    if others is None or joint not in others:
        raise ProblemError(
            f"{name} has a value for {brief(joint)}{closest(joint, joints)}, expected "
            f"one for each of: {', '.join(joints)}",
            name,
        )
    at = others[str(joint)]
    if not abs(_number(value, str(joint), name) - at) <= SAME:
        raise ProblemError(
            f"{name}: joint {joint!r} is {brief(value)}, but it is locked at {at:g}",
            name,
        )
