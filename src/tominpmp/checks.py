"""Checks of callers' arguments, made where the arguments enter the library.

Each check returns the value in the form in which it is stored, or raises an error of
the library that names the argument, shows its value on one line and describes the
expected one. A check looks at nothing but the argument, and comes before any work is
done with it: an error that arises later is no fault of the caller, and is raised
unchanged.

Points, rotations, poses and values by joint come as NumPy arrays, SciPy's ``Rotation``
and ``RigidTransform``, ``pinocchio.SE3`` and its quaternions, matrices, pairs of a
position and a rotation, messages of ROS and mappings. They are converted to plain
numbers here, and nowhere else. A value of any other kind is returned unchanged, for the
calling function to accept or to refuse with its own message.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from types import EllipsisType
from typing import Annotated, Any, TypeAlias, TypeGuard, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import (
    Array,
    Check,
    Converted,
    array_or_nan,
    frozen_array,
    is_single,
    number_or_nan,
)
from tominpmp.exceptions import (
    JointNotFound,
    ProblemError,
    SceneError,
    TominpmpError,
    brief,
    closest,
    counted,
)

T = TypeVar("T")
#: Makes an error from a message and the name of an argument.
MakeError = Callable[[str, str | None], TominpmpError]

# Largest size of a finite number, and smallest limit: their squares and reciprocals are
# numbers that are neither infinite nor zero.
HUGE, TINY = 1e150, 1e-150
# Largest coordinate, and largest position of a locked joint: inertias that it moves
# would overflow; larger ones are taken for a mistake [m or rad].
FARTHEST = 1e6
# Integers from here on exceed NumPy's 64 bits.
INT64_END = 2**63
FLAG = "True or False"
#: Content of arrays with one number for each joint, in messages.
JOINTS = "numbers, one for each joint"


def wrong(
    value: object, name: str, expected: str, error: MakeError = ProblemError
) -> TominpmpError:
    """Error that names an argument, shows its value and describes the expected one.

    Args:
        value: The argument.
        name: Its name.
        expected: Description of valid values.
        error: Makes the error from the message and the name.
    """
    return error(f"{name} is {brief(value)}, expected {expected}", name)


@contextmanager
def raised_as(error: MakeError) -> Iterator[None]:
    """Raise errors about arguments and obstacles in this block as another class.

    Args:
        error: Makes the error from the message and the name of the argument.
    """
    try:
        yield
    except (ProblemError, SceneError) as found:
        raise error(str(found), getattr(found, "field", None)) from found.__cause__


def instance(
    value: T,
    kinds: type | tuple[type, ...],
    name: str,
    expected: str = "",
    field: str | None = None,
) -> T:
    """Check the type of an argument; by default the error names the expected type.

    Args:
        value: The argument.
        kinds: Its type, or several types.
        name: Its name in messages.
        expected: Description of valid values.
        field: Name of the argument as an attribute of the error; None for its name in
            messages.

    Raises:
        ProblemError: If it is of another type.
    """
    if not isinstance(value, kinds):
        if not expected and isinstance(kinds, type):
            word = kinds.__name__
            expected = f"an {word}" if word[0] in "AEIOU" else f"a {word}"
        raise ProblemError(str(wrong(value, name, expected)), field or name)
    return value


def flag(value: object, name: str) -> bool:
    """Check a truth value.

    Raises:
        ProblemError: If it is not a truth value.
    """
    return bool(instance(value, (bool, np.bool_), name, FLAG))


def text(value: str, name: str, expected: str = "a text") -> str:
    """Check a text that must not be empty.

    Raises:
        ProblemError: If it is not a text, or empty.
    """
    if not isinstance(value, str) or not value:
        raise wrong(value, name, expected)
    return value


def choice(value: T, known: Sequence[object], name: str, expected: str = "") -> T:
    """Check that an argument is one of the known texts, or None if that is known, too.

    Raises:
        ProblemError: If the argument is not among them.
    """
    if not isinstance(value, str | None) or value not in known:
        expected = expected or f"one of: {', '.join(map(str, known))}"
        raise wrong(value, name, expected)
    return value


def number(
    value: object,
    name: str,
    expected: str = "a number",
    least: float = -math.inf,
    above: float = -math.inf,
    most: float = math.inf,
    *,
    infinite: bool = False,
) -> float:
    """Check a number in a range, of 1e150 at most; ``infinite`` allows any size.

    Raises:
        ProblemError: If it is not a number, or out of range.
    """
    converted = value if type(value) is float else number_or_nan(value)
    in_range = least <= converted <= most and (above == -math.inf or converted > above)
    if not in_range or not (infinite or abs(converted) <= HUGE):
        too_large = in_range and math.isfinite(converted)
        size = f", of at most {HUGE:g} in size" if too_large else ""
        raise wrong(value, name, expected + size)
    return converted


def positive(value: object, name: str, unit: str = "", most: float = math.inf) -> float:
    """Check a positive number, with its unit in the message.

    Raises:
        ProblemError: If it is not a positive number, or too large.
    """
    expected = "a positive number" + (f" [{unit}]" if unit else "")
    expected += "" if math.isinf(most) else f", {most:.4g} at most"
    return number(value, name, expected, above=0.0, most=most)


def non_negative(
    value: object, name: str, unit: str = "", below: float = math.inf
) -> float:
    """Check a number of zero or more, below a bound, with its unit in the message.

    Raises:
        ProblemError: If it is not a number, negative, too large, or infinite.
    """
    bounded = f"a number >= 0 and < {below:.4g}"
    expected = "a finite number >= 0" if math.isinf(below) else bounded
    expected += f" [{unit}]" if unit else ""
    return number(value, name, expected, least=0.0, most=math.nextafter(below, 0.0))


def _is_whole(value: object) -> TypeGuard[int]:
    """Whether a caller's value is an integer; truth values do not count as integers."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def whole(
    value: object,
    name: str,
    least: int = 0,
    most: float = INT64_END - 1,
    expected: str = "",
) -> int:
    """Check an integer in a range.

    Raises:
        ProblemError: If it is not an integer, or out of range.
    """
    if not _is_whole(value) or not least <= value <= most:
        beyond = _is_whole(value) and value > most
        top = f", at most {most}" if beyond or most < INT64_END - 1 else ""
        raise wrong(value, name, expected or f"an integer >= {least}{top}")
    return int(value)


def array(
    value: Any, name: str, shape: tuple[int | EllipsisType | None, ...], content: str
) -> Array:
    """Check the shape of an array of numbers; an array of floats is not copied.

    Args:
        value: The array, or nested sequences that NumPy makes an array of.
        name: Its name.
        shape: Its shape: None for any length, an ellipsis first for any leading axes.
        content: Description of the entries along its last axis.

    Raises:
        ProblemError: If it is not an array of numbers, or of another shape.
    """
    floats = isinstance(value, np.ndarray) and value.dtype == np.float64
    numbers = value if floats else array_or_nan(value)
    if numbers.ndim == 0 and np.isnan(numbers):
        count = f"{shape[-1]} " if isinstance(shape[-1], int) else ""
        raise wrong(value, name, count + content)
    if numbers.shape != shape and not _fits(numbers.shape, shape):
        layout = str(shape).replace("None", "m").replace("Ellipsis", "...")
        raise ProblemError(
            f"{name} has shape {numbers.shape}, expected {layout}: {content}", name
        )
    return numbers


def _fits(actual: tuple[int, ...], expected: tuple[Any, ...]) -> bool:
    if expected[0] is ...:
        expected = expected[1:]
        actual = actual[max(len(actual) - len(expected), 0) :]
    return len(actual) == len(expected) and all(
        b is None or a == b for a, b in zip(actual, expected, strict=True)
    )


def names(value: Any, called: str = "joint_names") -> tuple[str, ...]:
    """Check joint names, which must not repeat, and return them as a tuple.

    Raises:
        ProblemError: If they are not names, or a name is repeated.
    """
    listed = isinstance(value, Sequence | np.ndarray) and not is_single(value)
    good = listed and all(isinstance(name, str) and name for name in value)
    names = tuple(str(name) for name in value) if good else ()
    if not names or len(set(names)) < len(names):
        raise wrong(value, called, "names of joints, all of them different")
    return names


def known_joints(names: Iterable[str], joints: Sequence[str], called: str) -> None:
    """Check that names are names of joints.

    Args:
        names: The names.
        joints: Names of the joints.
        called: Name of the argument that holds the names, in messages.

    Raises:
        JointNotFound: If a name is not the name of a joint.
    """
    for name in names:
        if name not in joints:
            raise JointNotFound(name, joints, called)


def one_per_joint(values: Array, name: str, joints: Sequence[str]) -> None:
    """Check that there is one number for each joint.

    Raises:
        ProblemError: If there are more or fewer numbers than joints.
    """
    if values.size != len(joints):
        count = counted(values.size, "number")
        expected = f"{len(joints)}, one for each of: {', '.join(joints)}"
        raise ProblemError(f"{name} has {count}, expected {expected}", name)


#: A point or another vector in space: three numbers, or an object with x, y and z.
VectorLike: TypeAlias = ArrayLike | Mapping[str, float]
#: A 3x3 matrix, a quaternion (x, y, z, w), or a ``Rotation`` of SciPy.
RotationLike: TypeAlias = ArrayLike | Mapping[str, float] | Any
#: A ``pinocchio.SE3``, a 4x4 matrix, or a pair of a position and a rotation.
PoseLike: TypeAlias = ArrayLike | tuple[Any, Any] | Mapping[str, Any] | Any
#: One number for each joint in the order of the robot, or numbers by joint name.
JointsLike: TypeAlias = ArrayLike | Mapping[str, float]

POSE = (
    "a pinocchio.SE3, a 4x4 matrix, or a pair of a position [m] and a rotation "
    "(3x3 matrix, quaternion xyzw or scipy's Rotation)"
)
# Names of the two parts of a pose in mappings.
POSITION_KEYS = ("position", "translation", "xyz")
ROTATION_KEYS = ("rotation", "orientation", "quaternion", "xyzw", "quat")
# Largest deviation of a given position of a locked joint from its position [rad or m].
LOCK_TOLERANCE = 1e-6
# Largest deviation of the squared length of a unit vector from 1.
UNIT_TOLERANCE = 1e-15


def plain_rotation(value: object) -> object:
    """A rotation, or a list of rotations, as matrices or quaternions (x, y, z, w)."""
    if isinstance(value, type) or isinstance(value, np.ndarray):
        return value
    if isinstance(value, list | tuple) and value and not _is_number(value[0]):
        return [plain_rotation(item) for item in value]
    for name in ("as_matrix", "coeffs", "toRotationMatrix"):
        method = _attribute(value, name)
        if callable(method):
            try:
                return np.asarray(method())
            except Exception:  # foreign methods may raise anything
                return value
    return _by_axes(value, "xyzw")


def split_pose(value: object) -> tuple[object, object] | None:
    """Position and rotation of a pose, as plain numbers; None if it is not a pose.

    An array is a 4x4 matrix, or seven numbers: a position and a quaternion.
    """
    if isinstance(value, type):
        return None
    parts = _by_names(value)
    if parts is None and isinstance(value, list | tuple) and len(value) == 2:
        parts = None if _is_number(value[0]) else (value[0], value[1])
    if parts is None:
        array = array_or_nan(value)
        if array.shape == (4, 4) and np.array_equal(array[3], [0.0, 0.0, 0.0, 1.0]):
            return array[:3, 3], array[:3, :3]
        return (array[:3], array[3:]) if array.shape == (7,) else None
    position, rotation = parts
    return _by_axes(position, "xyz"), plain_rotation(rotation)


def _by_names(value: object) -> tuple[object, object] | None:
    """Position and rotation of a pose, by their keys or attributes."""
    if isinstance(value, Mapping):
        places = [key for key in POSITION_KEYS if key in value]
        turns = [key for key in ROTATION_KEYS if key in value]
        if len(places) == len(turns) == 1 and len(value) == 2:
            return value[places[0]], value[turns[0]]
        return None
    for place, turn in (("translation", "rotation"), ("position", "orientation")):
        parts = _attribute(value, place), _attribute(value, turn)
        if all(part is not None and not callable(part) for part in parts):
            return parts
    return None


def _by_axes(value: object, names: str) -> object:
    """Numbers by the names of axes, if a value has these and no others."""
    if isinstance(value, Mapping):
        same = set(value) == set(names)
        return [value[name] for name in names] if same else value
    if isinstance(value, np.ndarray | list | tuple | type):
        return value
    numbers = [_attribute(value, name) for name in names]
    has_w = "w" not in names and _attribute(value, "w") is not None
    return numbers if all(map(_is_number, numbers)) and not has_w else value


def vector(
    value: object,
    name: str,
    expected: str,
    size: int | None = None,
    *,
    most: float = sys.float_info.max,
) -> Array:
    """Check a caller's vector.

    Args:
        value: The caller's value.
        name: Its name in messages.
        expected: Description of valid values.
        size: Number of its elements; None for any number.
        most: Largest size of an element; infinite if elements may be infinite.

    Raises:
        ProblemError: If it is not a vector, or has the wrong size or invalid elements.
    """
    array = array_or_nan(_by_axes(value, "xyz") if size == 3 else value)
    if array.ndim != 1 or size not in (None, array.size):
        raise wrong(value, name, expected)
    if not np.all(np.abs(array) <= most):
        special = {math.inf: "none of them NaN", sys.float_info.max: "all finite"}
        which = special.get(most, f"all finite, within {most:g}")
        raise wrong(array.tolist(), name, f"{expected}, {which}")
    return array


def direction(value: object, name: str) -> Array:
    """Check a caller's direction, of any nonzero length, and scale it to unit length.

    Raises:
        ProblemError: If it is not a vector of three numbers, or zero.
    """
    expected = "three numbers, not all zero"
    unit = vector(value, name, expected, 3)
    largest = float(np.max(np.abs(unit)))
    if largest == 0.0:
        raise wrong(unit.tolist(), name, expected)
    # A unit vector is not scaled again: saving and loading would change its last bits.
    if largest > 1.0 or abs(float(unit @ unit) - 1.0) > UNIT_TOLERANCE:
        unit = unit / largest  # so that no square overflows
        unit = unit / np.linalg.norm(unit)
    return frozen_array(unit)


def of_type(kinds: type | tuple[type, ...], expected: str) -> Check:
    """Check of the type of a value, by :func:`instance`."""
    return lambda value, name: instance(value, kinds, name, expected)


# Field types that a Record checks.
FrameName: TypeAlias = Annotated[str, partial(text, expected="the name of a frame")]
Metres: TypeAlias = Annotated[float, partial(positive, unit="m")]
Amount: TypeAlias = Annotated[float, non_negative]
Seconds: TypeAlias = Annotated[float, partial(non_negative, unit="s")]
Direction: TypeAlias = Annotated[Converted[VectorLike, Array], direction]
_point = partial(vector, expected="three coordinates [m]", size=3)
Point: TypeAlias = Annotated[Converted[VectorLike, Array], _point]
PointOrNone: TypeAlias = Annotated[Converted[VectorLike | None, Array | None], _point]
#: A centre of mass, whose squares are finite.
Centre: TypeAlias = Annotated[Converted[VectorLike, Array], partial(_point, most=HUGE)]
#: A corner of a box, whose coordinates may be infinite.
Corner: TypeAlias = Annotated[
    Converted[VectorLike, Array], partial(_point, most=math.inf)
]


def _attribute(value: object, name: str) -> Any:
    try:
        return getattr(value, name, None)
    except Exception:  # foreign properties may raise anything
        return None


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


# -- values by joint -------------------------------------------------------------------


def by_joint(value: object, quantity: str = "position") -> dict[str, object] | None:
    """Values by joint name; None for a value without joint names.

    Args:
        value: A mapping, a row with an index of names (pandas), or a message with
            ``name``, ``position`` and ``velocity`` (ROS).
        quantity: The field of a message that is meant: "position", "velocity" or
            "acceleration", which no message has.
    """
    if isinstance(value, Mapping):
        return dict(value) or None
    if isinstance(value, np.ndarray | list | tuple | str | bytes | type):
        return None
    names = _attribute(value, "name")
    numbers = _attribute(value, quantity)
    if isinstance(names, Sequence) and not isinstance(names, str):
        if numbers is not None and len(names) == np.size(numbers):
            return dict(zip(names, np.asarray(numbers).tolist(), strict=True))
        return None
    labelled = _attribute(value, "to_dict")
    if callable(labelled) and _attribute(value, "index") is not None:
        values = labelled()
        valid = isinstance(values, dict) and all(isinstance(key, str) for key in values)
        return values if valid else None
    return None


def named_row(value: object, name: str) -> tuple[tuple[str, ...] | None, object]:
    """Joint names and their values, in the given order; None as names for a plain row.

    Raises:
        ProblemError: If names are not texts, or empty.
    """
    values = by_joint(value)
    if values is None:
        return None, value
    if not all(isinstance(joint, str) and joint for joint in values):
        raise wrong(value, name, "numbers, or numbers by joint name")
    return tuple(values), [_number(x, joint, name) for joint, x in values.items()]


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
        name: Name of the values in messages.
        others: Positions of joints that do not move, by name, which may be among the
            values; None if no other joints are allowed.
        missing: Value of joints that are not named; None if all must be named.

    Returns:
        Shape (n,).

    Raises:
        ProblemError: If a joint is missing or unknown, a value is not a number, or the
            value of a joint that does not move is not its position.
    """
    expected = f"expected a value for each of: {', '.join(joints)}"
    for joint, value in values.items():
        if joint in joints:
            continue
        if others is None or joint not in others:
            other = brief(joint) + closest(joint, joints)
            raise ProblemError(f"{name} has a value for {other}, {expected}", name)
        if not abs(_number(value, joint, name) - others[joint]) <= LOCK_TOLERANCE:
            at = f"{others[joint]:g}{' [rad or m]' if others[joint] else ''}"
            fault = f"is {brief(value)}, but it is locked at {at}"
            raise ProblemError(f"{name}: joint {joint!r} {fault}", name)
    lacking = ", ".join(joint for joint in joints if joint not in values)
    if lacking and missing is None:
        raise ProblemError(f"{name} has no value for {lacking}, {expected}", name)
    return np.array([_number(values.get(j, missing), j, name) for j in joints])


def _number(value: object, joint: str, name: str) -> float:
    with raised_as(lambda message, _: ProblemError(message, name)):
        return number(value, f"{name}: joint {joint!r}", infinite=True)
