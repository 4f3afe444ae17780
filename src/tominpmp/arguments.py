"""Wrong arguments are told of: what a call fails of, if it fails of its arguments.

Methods that check what they are given say so themselves. All others trust their
annotations, as whoever plans calls them a thousand times a second; a caller outside of
the library who gives them something else is told which argument it is, what it was and
what was expected, instead of what went wrong of it ten lines further on. What fails of
sound arguments, or of a call from within, is a fault of ours and stays as it is.
"""

from __future__ import annotations

import functools
import inspect
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from typing import Any, Literal, NamedTuple, TypeGuard, TypeVar, get_args, get_origin

import numpy as np

from tominpmp.exceptions import LIBRARY, ProblemError, TominpmpError, brief

F = TypeVar("F", bound=Callable[..., Any])

# Methods beside those with a name of their own that callers reach by what they write.
OPERATORS = ("__call__", "__contains__")
# What the numbers of an array are, by the name that it has all over the library; n is
# the number of joints.
ROWS = ("q", "v", "a", "u", "way", "beside")
TIMES = ("t", "times", "begin", "end")
SHAPES = {
    "by": (3,), "first": (3,), "last": (3,), "point": (3,), "rotation": (3, 3),
}  # fmt: skip
# Ends of the names of functions that take several states at once.
SEVERAL = ("_rows", "sizes")
LARGEST = 2**63
# Rows of one type, the items of which are looked at where there are few.
ITEMS = re.compile(r"^(?:Sequence|list|tuple)\[([^,]+)(?:, \.\.\.)?\]$")
FEW_ITEMS = 1000


class _Known(NamedTuple):
    """What is known of a call.

    Attributes:
        names: What the module of the function knows by name.
        joints: How many joints there are, if that is known.
        several: Whether it takes several states at once.
    """

    names: Mapping[str, Any]
    joints: int | None = None
    several: bool = False


def told(function: F) -> F:
    """Let a function or method tell its callers of arguments that are wrong.

    Args:
        function: The function; its annotations say what is expected.

    Returns:
        The same, which raises ProblemError where it fails of what it is given by a
        caller outside of the library.
    """

    @functools.wraps(function)
    def call(*args: Any, **named: Any) -> Any:
        try:
            return function(*args, **named)
        except TominpmpError:
            raise
        except Exception as error:
            if not _from_within(sys._getframe(1)):
                _blame(function, args, named, error)
            raise

    return call  # type: ignore[return-value]


def told_of(kind: type[Any]) -> type[Any]:
    """Let all public methods that a class itself has tell of wrong arguments."""
    for name, item in list(vars(kind).items()):
        if name == "__post_init__":
            setattr(kind, name, _told_of_fields(item))
        elif name not in OPERATORS and name.startswith("_"):
            continue
        elif isinstance(item, classmethod | staticmethod):
            setattr(kind, name, type(item)(told(item.__func__)))
        elif inspect.isfunction(item) and _takes_anything(item):
            setattr(kind, name, told(item))
    return kind


def _takes_anything(function: Any) -> bool:
    code = function.__code__
    return code.co_argcount + code.co_kwonlyargcount > 1 or bool(code.co_flags & 0x0C)


class Told:
    """Base of classes whose methods tell of wrong arguments, with all subclasses."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Wrap the methods of a subclass."""
        super().__init_subclass__(**options)
        told_of(cls)


def _told_of_fields(function: F) -> F:
    """The same for what checks the fields of a dataclass."""

    @functools.wraps(function)
    def check(self: Any) -> None:
        try:
            function(self)
        except TominpmpError:
            raise
        except Exception as error:
            frame = sys._getframe(1)
            if frame.f_code.co_name == "__init__" and frame.f_back is not None:
                frame = frame.f_back
            if not _from_within(frame):
                _blame_fields(self, error)
            raise

    return check  # type: ignore[return-value]


def _from_within(frame: Any) -> bool:
    name = frame.f_globals.get("__name__")
    return isinstance(name, str) and name.partition(".")[0] == LIBRARY


def _blame(
    function: Callable[..., Any],
    args: tuple[Any, ...],
    named: Mapping[str, Any],
    error: Exception,
) -> None:
    """Raise what is wrong with the arguments, if anything is."""
    try:
        bound = inspect.signature(function).bind(*args, **named).arguments
    except TypeError:
        return  # too many or too few: Python says so itself
    owner = bound.pop("self", None)
    joints = _joint_count([owner, *bound.values()])
    annotations = function.__annotations__
    given = [(key, value, annotations.get(key, "Any")) for key, value in bound.items()]
    several = function.__name__.endswith(SEVERAL)
    names = vars(sys.modules[function.__module__])
    _raise_first(given, _Known(names, joints, several), error)


def _blame_fields(record: Any, error: Exception) -> None:
    """Raise what is wrong with the fields of a record, if anything is."""
    for kind in type(record).__mro__:
        annotations = vars(kind).get("__annotations__", {})
        own = vars(record)
        given = [
            (key, own[key], text) for key, text in annotations.items() if key in own
        ]
        _raise_first(given, _Known(vars(sys.modules[kind.__module__])), error)


def _raise_first(
    given: Sequence[tuple[str, Any, Any]], known: _Known, error: Exception
) -> None:
    """Raise for the first value that is not what it should be."""
    for check in (_type_fault, _shape_fault, _number_fault):
        for name, value, annotation in given:
            if not isinstance(annotation, str):
                continue
            expected = check(name, value, annotation, known)
            if expected:
                raise ProblemError(
                    f"{name} is {brief(value)}, expected {expected}", name
                ) from error


def _type_fault(_: str, value: Any, annotation: str, known: _Known) -> str:
    """What was expected, if the value is of none of the types of an annotation."""
    words = []
    for kind in _alternatives(annotation):
        sound, expected = _judged(value, kind, known.names)
        if sound:
            return ""
        words.append(expected)
    return " or ".join(dict.fromkeys(words))


def _shape_fault(name: str, value: Any, annotation: str, known: _Known) -> str:
    """What was expected, if an array has not the shape that its name says."""
    if "Array" not in annotation or not isinstance(value, np.ndarray):
        return ""
    if name in ROWS:
        return _row_fault(value, known)
    if name in TIMES and value.ndim != 1:
        return f"a row of times, not shape {value.shape}"
    if name in SHAPES and value.shape != SHAPES[name]:
        return f"shape {SHAPES[name]}, not {value.shape}"
    if name == "points" and (value.ndim != 2 or value.shape[1] != 3):
        return f"points in rows of three, not shape {value.shape}"
    return ""


def _row_fault(value: Any, known: _Known) -> str:
    """The same of numbers for each joint, of which there may be none."""
    n = known.joints
    fits = value.ndim > 0 and (n is None or value.shape[-1] in (0, n))
    if fits and value.ndim in ((2,) if known.several else (1, 2)):
        return ""
    shape = f"(m, {n or 'n'})" if known.several else f"({n or 'n'},)"
    return f"shape {shape}, a number for each joint, not {value.shape}"


def _number_fault(name: str, value: Any, annotation: str, _: _Known) -> str:
    """What was expected, if there are numbers that are none, or that count nothing."""
    if annotation == "int" and value < 0:
        return "a whole number >= 0"
    if "Array" not in annotation or value is None:
        return ""
    if name in ROWS and np.size(value) == 0:
        return "a number for each joint"
    if name in TIMES and np.size(value) == 0:
        return "a time at least"
    if not np.all(np.isfinite(np.asarray(value, np.float64))):
        return "finite numbers"
    return ""


def _alternatives(annotation: str) -> Iterator[str]:
    """The types that an annotation has, joined by bars."""
    depth, begin = 0, 0
    for at, sign in enumerate(annotation):
        depth += (sign in "[(") - (sign in "])")
        if sign == "|" and depth == 0:
            yield annotation[begin:at].strip()
            begin = at + 1
    yield annotation[begin:].strip()


def is_whole(value: object) -> TypeGuard[int]:
    """Whether a caller's value is a whole number; truth values are none."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _is_int(value: Any) -> bool:
    return is_whole(value) and abs(int(value)) < LARGEST


def _is_float(value: Any) -> bool:
    if isinstance(value, float | np.floating):
        return bool(value == value)
    return _is_int(value)


def _is_array(value: Any, kinds: str) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind in kinds


def _is_array_like(value: Any) -> bool:
    try:
        return np.asarray(value).dtype.kind in "iuf"
    except Exception:  # ragged lists, and objects that pretend to be arrays
        return False


def _is_row(value: Any) -> bool:
    if isinstance(value, str | bytes):
        return False
    return isinstance(value, Sequence) or (
        isinstance(value, np.ndarray) and value.ndim > 0
    )


def _are_texts(value: Any) -> bool:
    return _is_row(value) and all(isinstance(item, str) for item in value)


#: How values are judged, and what is said of those that are not so.
PLAIN: dict[str, tuple[Callable[[Any], bool], str]] = {
    "None": (lambda value: value is None, "None"),
    "bool": (lambda value: isinstance(value, bool | np.bool_), "True or False"),
    "int": (_is_int, "a whole number"),
    "float": (_is_float, "a number"),
    "str": (lambda value: isinstance(value, str), "text"),
    "Path": (lambda value: isinstance(value, PathLike), "a path"),
    "Array": (lambda value: _is_array(value, "iuf"), "an array of numbers"),
    "IntArray": (lambda value: _is_array(value, "iu"), "an array of whole numbers"),
    "BoolArray": (lambda value: _is_array(value, "b"), "an array of truth values"),
    "ArrayLike": (_is_array_like, "numbers"),
    "Sequence[str]": (_are_texts, "a row of names"),
    "tuple[str, ...]": (_are_texts, "a row of names"),
    "Sequence": (_is_row, "a row"),
    "list": (_is_row, "a row"),
    "tuple": (_is_row, "a row"),
    "Mapping": (lambda value: isinstance(value, Mapping), "a mapping"),
    "dict": (lambda value: isinstance(value, Mapping), "a mapping"),
    "Callable": (callable, "a function"),
}


def _judged(value: Any, kind: str, names: Mapping[str, Any]) -> tuple[bool, str]:
    """Whether a value is of a type, and what that is in words."""
    head = re.split(r"[\[(]", kind)[0].strip("'\" ")
    judge = PLAIN.get(kind) or PLAIN.get(head)
    if judge is not None and not judge[0](value):
        return False, judge[1]
    items = ITEMS.match(kind)
    if items and len(value) < FEW_ITEMS:
        kinds = list(_alternatives(items[1]))
        each = [[_judged(item, one, names) for one in kinds] for item in value]
        wrong = next((one for one in each if not any(sound for sound, _ in one)), None)
        if wrong is not None:
            return False, f"a row, each of it {wrong[0][1]}"
    if judge is not None:
        return True, ""
    if "." in head or head in ("", "Any", "object"):
        return True, ""
    known = names.get(head)
    if isinstance(known, type):
        return isinstance(value, known), _article(head)
    if get_origin(known) is Callable:
        return callable(value), "a function"
    if get_origin(known) is Literal:
        words = get_args(known)
        said = isinstance(value, str) and value in words
        return said, f"one of {', '.join(map(repr, words))}"
    if known is not None:
        return True, ""  # a name for several types, which is not looked into
    # Imported for type checkers alone: known by its name.
    names_of = {base.__name__ for base in type(value).__mro__}
    return head in names_of, _article(head)


def _article(name: str) -> str:
    return f"an {name}" if name[0] in "AEIOU" else f"a {name}"


def _joint_count(values: Sequence[Any]) -> int | None:
    """How many joints there are, where a value is of a robot or on one."""
    for value in values:
        for name in ("_kinematics", "kinematics", "robot"):
            try:
                value = getattr(value, name, value)
            except Exception:  # of one that is on no robot yet
                continue
        found = getattr(value, "joint_names", None)
        if isinstance(found, tuple):
            return len(found)
    return None
