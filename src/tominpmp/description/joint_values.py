"""Values per joint in the forms in which callers give them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, array_or_nan, real_array
from tominpmp.checks import by_joint, in_order
from tominpmp.exceptions import JointNotFound, OptionsError, ProblemError, brief

#: One value for all joints, one for each in joint order, or some by joint name.
JointValues: TypeAlias = ArrayLike | Mapping[str, ArrayLike]


def override(
    option: str,
    values: JointValues,
    current: Array,
    joint_names: Sequence[str],
    not_free: Mapping[str, str],
) -> Array:
    """Replace values per joint by those a caller gave.

    Args:
        option: Name of the argument, for messages.
        values: A number for all joints, an array in joint order, or numbers by joint
            name; joints not named keep their value.
        current: Present values, shape (n,), or (n, 2) where a joint has a lower and an
            upper value; then a pair may stand for each number, and a number x means
            (-x, x).
        joint_names: Names of the joints, length n.
        not_free: Joints of the robot that have no value, and why.

    Returns:
        The values, same shape as ``current``.

    Raises:
        OptionsError: If a value is no number, or there are too many or too few.
        JointNotFound: If a name is not that of a joint.
    """
    result = np.array(current, dtype=np.float64)
    n, pairs = len(joint_names), current.ndim == 2
    if isinstance(values, Mapping):
        for name, value in values.items():
            if name in not_free:
                raise OptionsError(f"{option}: joint {name} {not_free[name]}", option)
            if name not in joint_names:
                raise JointNotFound(name, joint_names)
            result[joint_names.index(name)] = _joint_value(option, name, value, pairs)
        return result
    array = _numeric(option, values)
    if array.ndim == 0:
        array = np.full(n, float(array))
    if array.shape != (n,) and not (pairs and array.shape == (n, 2)):
        forms = f"{n} numbers, pairs (lower, upper)" if pairs else f"{n} numbers"
        raise OptionsError(
            f"{option}: got an array of shape {array.shape}, expected one number, "
            f"{forms} in the order {', '.join(joint_names)}, or a mapping of joint "
            "names",
            option,
        )
    for i, name in enumerate(joint_names):
        result[i] = _joint_value(option, name, array[i].tolist(), pairs)
    return result


def _numeric(option: str, value: ArrayLike) -> Array:
    """Convert to an array of numbers."""
    try:
        return real_array(value)
    except ValueError as error:
        raise OptionsError(
            f"{option}: got {brief(value)}, expected numbers", option
        ) from error


def _joint_value(option: str, name: str, value: ArrayLike, pairs: bool) -> Array:
    """Check the value of one joint: a number or, if ``pairs``, lower and upper."""
    array = _numeric(option, value)
    if pairs and array.ndim == 0 and not array < 0:
        array = np.array([-array, array])
    if array.shape != ((2,) if pairs else ()) or np.isnan(array).any():
        wanted = "a number from 0, or (lower, upper)" if pairs else "a number"
        raise OptionsError(
            f"{option}: joint {name} got {brief(value)}, expected {wanted}", option
        )
    return array


def check_sign(
    option: str,
    values: Array,
    joint_names: Sequence[str],
    *,
    positive: bool = False,
    infinite: bool = False,
) -> None:
    """Refuse negative values, zero if they must be positive, and infinity."""
    for name, value in zip(joint_names, values, strict=True):
        wrong = value < 0 or (positive and value == 0)
        if wrong or (math.isinf(value) and not infinite):
            kind = "a number" if infinite else "a finite number"
            sign = "greater than zero" if positive else "from 0"
            raise OptionsError(
                f"{option}: joint {name} got {value:g}, expected {kind} {sign}", option
            )


def check_order(
    option: str,
    low: Array,
    high: Array,
    joint_names: Sequence[str],
    *,
    equal: bool = False,
) -> None:
    """Refuse a lower value above (unless ``equal`` also at) the upper one."""
    for name, a, b in zip(joint_names, low, high, strict=True):
        if a > b or (a == b and not equal):
            raise OptionsError(
                f"{option}: joint {name} has the lower limit {a:g} and the upper "
                f"limit {b:g}, expected the lower one to be less",
                option,
            )


def check_gravity(gravity: ArrayLike) -> Array:
    """Check that gravity is a vector."""
    vector = array_or_nan(gravity)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise OptionsError(
            f"gravity: got {brief(gravity)}, expected three finite numbers [m/s^2]",
            "gravity",
        )
    return vector


def _part_row(values: object, joints: Sequence[str], part: str) -> Array:
    """Values of the joints of one robot, which may be given by their own names."""
    named = by_joint(values)
    if named is None:
        return real_array(values)
    own = [joint.removeprefix(f"{part}/") for joint in joints]
    return in_order(named, own, part)


def stack_parts(
    joints: Sequence[str], names: Sequence[str], values: Mapping[str, object]
) -> Array:
    """Put values of the joints of several robots into one array.

    The names of the joints have that of their robot before each.

    Raises:
        ProblemError: If a robot is missing or unknown, or a length is wrong.
    """
    known = ", ".join(names) or "none; it was not combined from several"
    for name in (*values, *names):
        if name not in names or name not in values:
            state = "given" if name not in names else "missing"
            raise ProblemError(
                f"values for {brief(name)} are {state}; the robots are: {known}", name
            )
    out = np.empty(len(joints))
    for name in names:
        rows = [i for i, joint in enumerate(joints) if joint.startswith(f"{name}/")]
        try:
            given = _part_row(values[name], [joints[i] for i in rows], name)
        except ValueError:
            given = np.empty((0, 0))
        if given.shape != (len(rows),):
            raise ProblemError(
                f"{name} has shape {given.shape}, expected {len(rows)} numbers, one "
                f"for each of: {', '.join(joints[i] for i in rows)}",
                name,
            )
        out[rows] = given
    return out
