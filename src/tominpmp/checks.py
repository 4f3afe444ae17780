"""What callers give, looked at where it comes in.

Each function returns the value as it is kept, or raises an error of the library that
names the argument, shows its value on one line and says what was expected. Nothing but
the argument is looked at, and before anything is done with it: what fails later is no
fault of a caller, and is raised as it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import EllipsisType
from typing import Any, TypeGuard, TypeVar

import numpy as np

from tominpmp.arrays import Array, number_or_nan, real_array
from tominpmp.exceptions import ProblemError, TominpmpError, brief

T = TypeVar("T")
#: An error of a message and the name of an argument.
MakeError = Callable[[str, str], TominpmpError]

# Whole numbers from here on are none of NumPy's.
LARGEST = 2**63
FLAG = "True or False"
#: What arrays that have a number for each joint hold.
JOINTS = "numbers, one for each joint"


def wrong(
    value: object, name: str, expected: str, error: MakeError = ProblemError
) -> TominpmpError:
    """The error that says what an argument is, and what was expected.

    Args:
        value: The argument.
        name: Its name.
        expected: What was expected, in words.
        error: Makes the error of a message and the name; so below.
    """
    return error(f"{name} is {brief(value)}, expected {expected}", name)


def instance(
    value: T, kinds: type | tuple[type, ...], name: str, expected: str = ""
) -> T:
    """Check the type of an argument; what is expected is by default that type.

    Raises:
        ProblemError: If it is of another type.
    """
    if not isinstance(value, kinds):
        if not expected and isinstance(kinds, type):
            word = kinds.__name__
            expected = f"an {word}" if word[0] in "AEIOU" else f"a {word}"
        raise wrong(value, name, expected)
    return value


def of_kind(value: object, kinds: type, name: str, expected: str) -> None:
    """Check the type of an argument whose value says less than its type, if wrong.

    Raises:
        ProblemError: If it is of another type.
    """
    if not isinstance(value, kinds):
        kind = type(value).__name__
        raise ProblemError(f"{name} is a {kind}, expected {expected}", name)


def flag(value: object, name: str) -> bool:
    """Check a truth value.

    Raises:
        ProblemError: If it is none.
    """
    return bool(instance(value, (bool, np.bool_), name, FLAG))


def text(
    value: str,
    name: str,
    expected: str = "a text",
    error: MakeError = ProblemError,
) -> str:
    """Check a text, which is not empty.

    Raises:
        ProblemError: If it is none.
    """
    if not isinstance(value, str) or not value:
        raise wrong(value, name, expected, error)
    return value


def choice(
    value: T,
    known: Sequence[object],
    name: str,
    expected: str = "",
    error: MakeError = ProblemError,
) -> T:
    """Check that an argument is one of some texts, or None where that is one of them.

    Raises:
        ProblemError: If it is none of them.
    """
    if not isinstance(value, str | None) or value not in known:
        expected = expected or f"one of: {', '.join(map(str, known))}"
        raise wrong(value, name, expected, error)
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
    error: MakeError = ProblemError,
) -> float:
    """Check a number in a range; it may be infinite only where that is said.

    Raises:
        ProblemError: If it is none, or out of range.
    """
    found = value if type(value) is float else number_or_nan(value)
    ranged = least <= found <= most and (above == -math.inf or found > above)
    if not ranged or not (infinite or math.isfinite(found)):
        raise wrong(value, name, expected, error)
    return found


def positive(
    value: object,
    name: str,
    unit: str = "",
    most: float = math.inf,
    error: MakeError = ProblemError,
) -> float:
    """Check a positive number of a unit.

    Raises:
        ProblemError: If it is none, or too large.
    """
    expected = "a positive number" + (f" [{unit}]" if unit else "")
    expected += "" if math.isinf(most) else f", {most:.4g} at most"
    return number(value, name, expected, above=0.0, most=most, error=error)


def is_whole(value: object) -> TypeGuard[int]:
    """Whether a caller's value is a whole number; truth values are none."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def whole(
    value: object,
    name: str,
    least: int = 0,
    most: float = LARGEST - 1,
    expected: str = "",
    *,
    error: MakeError = ProblemError,
) -> int:
    """Check a whole number in a range.

    Raises:
        ProblemError: If it is none, or out of range.
    """
    if not is_whole(value) or not least <= value <= most:
        beyond = is_whole(value) and value > most
        top = f", at most {most}" if beyond or most < LARGEST - 1 else ""
        raise wrong(value, name, expected or f"an integer >= {least}{top}", error)
    return int(value)


def array(
    value: Any, name: str, shape: tuple[int | EllipsisType | None, ...], content: str
) -> Array:
    """Check an array of numbers by its shape; one of floats is not copied.

    Args:
        value: The array, or what NumPy makes one of.
        name: Its name.
        shape: Its shape: None for any length, and an ellipsis first for any more axes.
        content: What its last axis holds, in words.

    Raises:
        ProblemError: If it is none, or of another shape.
    """
    if isinstance(value, np.ndarray) and value.dtype == np.float64:
        found = value
    else:
        try:
            found = real_array(value)
        except ValueError as error:
            count = f"{shape[-1]} " if isinstance(shape[-1], int) else ""
            raise wrong(value, name, count + content) from error
    if found.shape != shape and not _fits(found.shape, shape):
        words = {None: "m", ...: "..."}
        axes = ", ".join(str(words.get(item, item)) for item in shape)  # type: ignore[arg-type]
        layout = f"({axes},)" if len(shape) == 1 else f"({axes})"
        raise ProblemError(
            f"{name} has shape {found.shape}, expected {layout}: {content}", name
        )
    return found


def _fits(found: tuple[int, ...], shape: tuple[Any, ...]) -> bool:
    if shape[0] is ...:
        shape = shape[1:]
        found = found[max(len(found) - len(shape), 0) :]
    return len(found) == len(shape) and all(
        b is None or a == b for a, b in zip(found, shape, strict=True)
    )
