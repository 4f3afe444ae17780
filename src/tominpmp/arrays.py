"""The array type of the library, and records that hold arrays.

Problem data are frozen: their arrays are read-only, so that a problem remains valid
once it has been checked.
"""

from __future__ import annotations

import copy
import copyreg
import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tominpmp.exceptions import brief, shortened

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
#: Type of an attribute that is None only after a failure: code that has a successful
#: solution need not test it. Annotations name the usual type, too, for type checkers.
MaybeNone: TypeAlias = Any

#: Takes a caller's value and its name in messages; returns the value to be stored.
Check = Callable[[Any, str], Any]

_T = TypeVar("_T")
_R = TypeVar("_R", bound="Record")
_Input = TypeVar("_Input", contravariant=True)
_Stored = TypeVar("_Stored", covariant=True)

# Longest range that is converted: it may denote far more numbers than fit in memory.
MOST_NUMBERS = 10_000_000
# Characters that a record's line spends on its fields; largest array written out in it.
LINE = 150
FEW_NUMBERS = 12


def _read_only(values: ArrayLike, _: str = "") -> NDArray[Any]:
    array = np.array(values)
    array.setflags(write=False)
    return array


def frozen_array(values: ArrayLike) -> Array:
    """Copy values into a read-only array of floats.

    Returns:
        A new array of the same shape that cannot be written to.
    """
    return _read_only(np.asarray(values, dtype=np.float64))


# Field types of which a Record stores a read-only copy.
FrozenArray: TypeAlias = Annotated[Array, _read_only]
FrozenFlags: TypeAlias = Annotated[BoolArray, _read_only]


def array_or_nan(values: object) -> Array:
    """Take a caller's numbers as a read-only array of floats.

    Unlike NumPy, this refuses numeric strings, truth values and None.

    Returns:
        A new read-only array; NaN and infinities are accepted. A single NaN if the
        values are not real numbers in a regular array.
    """
    endless = isinstance(values, range) and len(values) > MOST_NUMBERS
    try:
        array = np.asarray(None if endless else values)
    except Exception:  # ragged lists, and objects that pretend to be arrays
        array = np.asarray(None)
    real = not array.size or array.dtype.kind in "iuf"
    return frozen_array(array if real else np.nan)


def number_or_nan(value: object) -> float:
    """A caller's number as by :func:`array_or_nan`; NaN if it refuses the value."""
    array = array_or_nan(value)
    return float(array) if array.shape == () else float("nan")


def to_number(word: str) -> float:
    """The number that a word of a file is.

    Returns:
        The number, which may be infinite; NaN for "nan".

    Raises:
        ValueError: If the word is not a number. Python alone allows 1_0, and digits of
            other scripts than ASCII.
    """
    if "_" in word or not word.isascii():
        raise ValueError(f"{brief(word)} is not a number")
    return float(word)


def pair_or_nan(value: object) -> tuple[float, float]:
    """A caller's pair of numbers as by :func:`array_or_nan`; NaN if it refuses them."""
    pair = array_or_nan(value)
    first, second = pair.tolist() if pair.shape == (2,) else [float("nan")] * 2
    return first, second


def is_single(value: object) -> bool:
    """Whether a caller's value is a single number, or an object that is not a sequence.

    Ranges count as sequences without being written out, whatever their length; so do
    lists, whatever their elements.
    """
    return not isinstance(value, range | list | tuple) and np.ndim(value) == 0  # type: ignore[arg-type]


def comparable(value: Any) -> Any:
    """Turn a value of a record into a value to compare and hash.

    An array of numbers becomes its shape and bytes, a mapping the set of its items. A
    number that is undefined (NaN) is equal to itself. Other values remain unchanged.
    """
    # Poses of Pinocchio are compared by their matrices.
    value = getattr(value, "homogeneous", value)
    if isinstance(value, np.ndarray):
        return value.shape, (value + 0.0).tobytes()  # -0.0 becomes 0.0
    if isinstance(value, Mapping):
        return frozenset((key, comparable(item)) for key, item in value.items())
    return None if isinstance(value, float) and value != value else value


class Converted(Generic[_Input, _Stored]):
    """Type of a field whose constructor accepts more types than the field stores.

    It exists for type checkers: ``Converted[VectorLike, Array]`` accepts a vector in
    any form when a record is made, and is an array when the field is read.
    """

    def __get__(self, record: object, kind: Any, /) -> _Stored:
        """Type of the stored value; read by type checkers only, never called."""
        raise NotImplementedError

    def __set__(self, record: object, value: _Input, /) -> None:
        """Type of the value that a caller may pass."""
        raise NotImplementedError


def default(value: object) -> Any:
    """Default of a converted field, in a form that a caller may pass."""
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


def changed_fields(record: Any) -> dict[str, Any]:
    """Arguments of a dataclass that differ from their defaults, by name."""
    changed = {}
    for item in fields(record):
        value, factory = getattr(record, item.name, None), item.default_factory
        value = dict(value) if isinstance(value, MappingProxyType) else value
        usual = item.default if factory is MISSING else factory()
        if isinstance(value, np.ndarray) and isinstance(usual, tuple):
            usual = np.array(usual, value.dtype)
        same = type(value) is type(usual) and comparable(value) == comparable(usual)
        if item.init and value is not usual and not same:
            changed[item.name] = value
    return changed


def in_brief(value: object) -> str:
    """Show a value of a record; long arrays by their shape only."""
    if isinstance(value, np.ndarray) and value.size > FEW_NUMBERS:
        return f"<array of shape {value.shape}>"
    return brief(value.tolist() if isinstance(value, np.ndarray) else value)


def _frozen_mapping(values: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(values)


# Python neither copies nor pickles read-only mappings by itself.
copyreg.pickle(MappingProxyType, lambda mapping: (_frozen_mapping, (dict(mapping),)))


class Record:
    """Base of the frozen dataclasses with arrays, such as :func:`record` makes.

    Records are equal if they are of one class and all fields are equal, arrays element
    by element; fields declared with ``compare=False`` do not count. Arrays and mappings
    remain read-only when a record is copied or passed to another process. The ``repr``
    of a record is one line with the fields that differ from their defaults,
    abbreviated.

    A field is checked and converted if its annotation names an ``Annotated`` type with
    a :data:`Check`, as ``Direction`` is, or such a type or None (``Direction | None``).
    The checks of a base class hold in subclasses as well, even if they declare the
    field again. None is not checked where it is the default.
    """

    # Prefix of the field names in messages.
    _owner: ClassVar[str] = ""
    _field_checks: ClassVar[Mapping[str, tuple[Check, ...]]] = MappingProxyType({})

    def __init_subclass__(cls, **options: Any) -> None:
        """Keep dataclasses from generating ``__repr__``; collect checks of fields."""
        super().__init_subclass__(**options)
        if "__repr__" not in cls.__dict__:
            setattr(cls, "__repr__", cls.__repr__)  # noqa: B010
        own = {name: field_type(cls, name) for name in inspect.get_annotations(cls)}
        more = {k: v.__metadata__ for k, v in own.items() if hasattr(v, "__metadata__")}
        cls._field_checks = {**cls._field_checks, **more}

    def __post_init__(self) -> None:
        """Check and convert the fields, in their order."""
        for item in fields(self):  # type: ignore[arg-type]
            name, value = item.name, getattr(self, item.name)
            if value is not None or item.default is not None:
                for check in self._field_checks.get(name, ()):
                    value = check(value, self._owner + name)
                    self._keep(**{name: value})

    def __repr__(self) -> str:
        """Name of the class, and the arguments that differ from their defaults."""
        shown = {item.name for item in fields(self) if item.repr}  # type: ignore[arg-type]
        changed = changed_fields(self).items()
        parts = [f"{k}={in_brief(value)}" for k, value in changed if k in shown]
        return f"{type(self).__name__}({shortened(', '.join(parts), LINE)})"

    def _keep(self, **values: Any) -> None:
        """Set fields of a record under construction, past its being frozen."""
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _altered(self: _R, *cached: str, **values: Any) -> _R:
        """A copy with other values, unchecked, without the named cached properties."""
        other = copy.copy(self)
        for name in cached:
            other.__dict__.pop(name, None)
        other._keep(**values)
        return other

    def _values(self) -> tuple[Any, ...]:
        """Values to compare and hash: the fields, arrays as shapes and numbers."""
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
        """Restore a copy; NumPy does not preserve that its arrays were read-only."""
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        self.__dict__.update(state)


def field_type(kind: type, name: str) -> Any:
    """Type of a field, without None if that is the other type it may have.

    Returns:
        The type; the text of its annotation if that is more than a name.
    """
    for base in kind.__mro__:
        declared = inspect.get_annotations(base).get(name)
        if declared is not None:
            known = vars(sys.modules[base.__module__])
            if isinstance(declared, str):
                return known.get(declared.removesuffix(" | None"), declared)
            return declared
    return None
