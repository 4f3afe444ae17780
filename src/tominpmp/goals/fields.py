"""Fields of goals and constraints: how each is checked, declared beside its class."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, Record, comparable
from tominpmp.checks import positive, text, vector

# Takes a caller's value and its name in messages; returns the value that is kept.
Check = Callable[[Any, str], Any]
POINT = "three coordinates [m]"


class CheckedFields(Record):
    """A record whose classes declare how their fields are checked.

    Fields of base classes are checked first.
    """

    _checks: ClassVar[Mapping[str, Check]] = MappingProxyType({})
    # Stands before the names of the fields in messages.
    _owner: ClassVar[str] = ""

    def __post_init__(self) -> None:
        """Check and copy the values."""
        for kind in reversed(type(self).__mro__):
            for name, check in kind.__dict__.get("_checks", {}).items():
                value = check(getattr(self, name), self._owner + name)
                self._keep(**{name: value})

    def _values(self) -> tuple[Any, ...]:
        """What is compared: the fields, with poses and arrays as numbers."""
        found = (getattr(self, f.name) for f in fields(self))  # type: ignore[arg-type]
        return tuple(
            tuple(value.homogeneous.ravel().tolist())
            if isinstance(value, pin.SE3)
            else comparable(value)
            for value in found
        )


def checks(**each: Check) -> Mapping[str, Check]:
    """Checks of fields by their names."""
    return each


def frame_name(value: Any, name: str) -> str:
    """Check the name of a frame."""
    return text(value, name, "the name of a frame")


def coordinates(value: Any, name: str) -> Array:
    """Check a point, shape (3,) [m]."""
    return vector(value, name, POINT, 3)


def corner(value: Any, name: str) -> Array:
    """Check a corner of a box, which may be infinite, shape (3,) [m]."""
    return vector(value, name, POINT, 3, infinite=True)


def above_zero(unit: str, most: float = np.inf) -> Check:
    """Check of a number above zero in a unit."""
    return lambda value, name: positive(value, name, unit, most=most)


def optional(check: Check) -> Check:
    """Check of a value that may be None."""
    return lambda value, name: None if value is None else check(value, name)
