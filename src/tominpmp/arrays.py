"""The array type of the library, and records that hold arrays.

Problem data are frozen: the arrays in them cannot be written to, so that a problem that
was checked once stays as it was checked.
"""

from __future__ import annotations

import copy
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tominpmp.exceptions import brief, shortened

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
#: Marks what may be None although it is not where all is well: whoever has a solution
#: that is a success need not ask. Type checkers know the other type beside it.
MaybeNone: TypeAlias = Any

#: Takes a caller's value and its name in messages; returns the value that is kept.
Check = Callable[[Any, str], Any]

_T = TypeVar("_T")
_R = TypeVar("_R", bound="Record")
_Given = TypeVar("_Given", contravariant=True)
_Kept = TypeVar("_Kept", covariant=True)

# A range may stand for any number of numbers without holding them.
MOST_NUMBERS = 10_000_000
# Characters of the fields of a record, and numbers of an array in them.
LINE = 150
FEW_NUMBERS = 12


def frozen_array(values: ArrayLike) -> Array:
    """Copy values into a read-only array of floats.

    Returns:
        A new array of the same shape that cannot be written to.
    """
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def _read_only(values: ArrayLike, _: str) -> NDArray[Any]:
    array = np.array(values)
    array.setflags(write=False)
    return array


# Types of fields of which a Record keeps a read-only copy.
FrozenArray: TypeAlias = Annotated[Array, _read_only]
FrozenFlags: TypeAlias = Annotated[BoolArray, _read_only]


def real_array(values: object) -> Array:
    """Take a caller's numbers as a read-only array of floats.

    Unlike NumPy, this refuses text that looks like numbers, truth values and None.

    Returns:
        A new array that cannot be written to; NaN and infinities are let through.

    Raises:
        ValueError: If the values are not real numbers in a regular array.
    """
    try:
        if isinstance(values, range) and len(values) > MOST_NUMBERS:
            raise ValueError(f"more than {MOST_NUMBERS} numbers")
        array = np.asarray(values)
    except Exception as error:  # ragged lists, and objects that pretend to be arrays
        raise ValueError(f"{brief(values)} is not made of real numbers") from error
    if array.size and array.dtype.kind not in "iuf":
        raise ValueError(f"{brief(values)} is not made of real numbers")
    return frozen_array(array)


def real_number(value: object) -> float:
    """Take a caller's number as a float.

    Returns:
        The number; NaN and infinities are let through.

    Raises:
        ValueError: If it is not a single real number.
    """
    array = real_array(value)
    if array.shape != ():
        raise ValueError(f"{brief(value)} is not a single number")
    return float(array)


def array_or_nan(values: object) -> Array:
    """A caller's numbers as by :func:`real_array`; a single NaN if they are none."""
    try:
        return real_array(values)
    except ValueError:
        return frozen_array(np.nan)


def number_or_nan(value: object) -> float:
    """A caller's number as by :func:`real_number`; NaN if it is none."""
    try:
        return real_number(value)
    except ValueError:
        return float("nan")


def pair_or_nan(value: object) -> tuple[float, float]:
    """A caller's two numbers as by :func:`real_number`; NaN if they are not two."""
    try:
        first, second = map(number_or_nan, value)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        return float("nan"), float("nan")
    return first, second


def is_single(value: object) -> bool:
    """Whether a caller's value is one number, or anything that is no row of them.

    Ranges are rows however long they are, without being written out; so are lists of
    whatever they hold.
    """
    return not isinstance(value, range | list | tuple) and np.ndim(value) == 0  # type: ignore[arg-type]


def comparable(value: Any) -> Any:
    """Turn an array into its shape and numbers; other values remain."""
    # Poses of Pinocchio are compared by their matrices.
    value = getattr(value, "homogeneous", value)
    if isinstance(value, np.ndarray):
        return value.shape, tuple(value.ravel().tolist())
    return value


class Converted(Generic[_Given, _Kept]):
    """Type of a field for which callers may give more than what is kept of it.

    Type checkers know it by that: ``Converted[VectorLike, Array]`` is a vector in any
    form for who makes a record, and an array for who reads it.
    """

    def __get__(self, record: object, kind: Any, /) -> _Kept:
        """What is kept; only type checkers ask, as no field is such an object."""
        raise NotImplementedError

    def __set__(self, record: object, value: _Given, /) -> None:
        """What is given."""
        raise NotImplementedError


def default(value: object) -> Any:
    """Default of a converted field, as a caller would give it."""
    return value


if TYPE_CHECKING:
    from typing_extensions import dataclass_transform

    @dataclass_transform(
        frozen_default=True, eq_default=False, field_specifiers=(field,)
    )
    def record(kind: type[_T], /) -> type[_T]:
        """A frozen dataclass whose fields may be converted; for a :class:`Record`."""
else:
    record = dataclass(frozen=True, eq=False)


def record_line(record: Any) -> str:
    """Show a dataclass on one line: the fields that are not at their defaults."""
    parts = []
    for item in fields(record):
        value = getattr(record, item.name, None)
        if item.repr and value is not item.default:
            value = dict(value) if isinstance(value, MappingProxyType) else value
            made = item.default_factory
            default = item.default if made is MISSING else made()
            if not _same(value, default):
                parts.append(f"{item.name}={in_brief(value)}")
    return f"{type(record).__name__}({shortened(', '.join(parts), LINE)})"


def _same(value: object, default: object) -> bool:
    return type(value) is type(default) and comparable(value) == comparable(default)


def in_brief(value: object) -> str:
    """Show a value of a record: long arrays by their shape."""
    if isinstance(value, np.ndarray) and value.size > FEW_NUMBERS:
        return f"<array of shape {value.shape}>"
    if isinstance(value, np.ndarray):
        return brief(value.tolist())
    return brief(value)


class Record:
    """Base of frozen dataclasses that hold arrays: of those that :func:`record` makes.

    Records are equal if they are of one class and all fields are, arrays element by
    element; fields declared with ``compare=False`` do not count. Arrays remain
    read-only when a record is copied or passed to another process. A record shows
    itself on one line: its fields that are not at their defaults, each in brief.

    A field is checked, and turned into what is kept of it, where its type says how: is
    the name of an ``Annotated`` type with a :data:`Check`, as ``Direction`` is. What a
    base class checks is checked in subclasses that declare the field again, too.
    """

    # Stands before the names of the fields in messages.
    _owner: ClassVar[str] = ""
    _field_checks: ClassVar[Mapping[str, Check]] = MappingProxyType({})

    def __init_subclass__(cls, **options: Any) -> None:
        """Keep dataclasses from making another ``__repr__``; look for checks."""
        super().__init_subclass__(**options)
        if "__repr__" not in cls.__dict__:
            setattr(cls, "__repr__", cls.__repr__)  # noqa: B010
        cls._field_checks = {**cls._field_checks, **dict(_checks_of(cls))}

    def __post_init__(self) -> None:
        """Check and convert the fields."""
        for name, check in self._field_checks.items():
            self._keep(**{name: check(getattr(self, name), self._owner + name)})

    def __repr__(self) -> str:
        """Name of the class, and what was given."""
        return record_line(self)

    def _keep(self, **values: Any) -> None:
        """Set fields of a record that is being made, to what is kept in them."""
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _altered(self: _R, *forgotten: str, **values: Any) -> _R:
        """A copy with other values, unchecked, that has forgotten cached properties."""
        other = copy.copy(self)
        for name in forgotten:
            other.__dict__.pop(name, None)
        other._keep(**values)
        return other

    def _values(self) -> tuple[Any, ...]:
        """What is compared: the fields, with arrays as shapes and numbers."""
        values = (getattr(self, f.name) for f in fields(self) if f.compare)  # type: ignore[arg-type]
        return tuple(map(comparable, values))

    def __eq__(self, other: object) -> bool:
        """Whether the other record is of the same class and has the same values."""
        if type(other) is not type(self):
            return NotImplemented
        return self._values() == other._values()

    def __hash__(self) -> int:
        """Hash of the values."""
        return hash((type(self), self._values()))

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy; NumPy forgets that its arrays were read-only."""
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        self.__dict__.update(state)


def field_type(kind: type, name: str) -> Any:
    """The type of a field; the text of its annotation where that is no mere name."""
    for base in kind.__mro__:
        declared = inspect.get_annotations(base).get(name)
        if declared is not None:
            known = vars(sys.modules[base.__module__])
            named = isinstance(declared, str)
            return known.get(declared, declared) if named else declared
    return None


def _checks_of(kind: type) -> Iterator[tuple[str, Check]]:
    """Fields that a class declares by types with a check, and these checks."""
    for name in inspect.get_annotations(kind):
        for check in getattr(field_type(kind, name), "__metadata__", ()):
            yield name, check
