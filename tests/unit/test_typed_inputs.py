"""What type checkers are told of constructors is what the constructors take."""

from __future__ import annotations

import inspect
import re
from dataclasses import FrozenInstanceError, is_dataclass
from functools import partial
from typing import Annotated, TypeAlias

import pytest

import tominpmp as tm
from tominpmp.arrays import Converted, Record, default, record
from tominpmp.checks import positive
from tools.type_check_documents import readme_module

RECORDS = [
    name
    for name in tm.__all__
    if inspect.isclass(getattr(tm, name)) and is_dataclass(getattr(tm, name))
]
# Made by the library, not by its users.
KEPT = {
    *("Certificate", "ClearanceProof", "ExportCheck", "JointLimits", "LowerBound"),
    *("MotionLimits", "Options", "Robot", "Samples", "Trajectory", "Verification"),
    *("ImprovedPlacement", "Visit"),
}


Length: TypeAlias = Annotated[
    Converted[float | str, float], partial(positive, unit="m")
]


@record
class Rod(Record):
    length: Length
    width: Length = default(1)


@record
class Beam(Rod):
    width: float = 2.0


def test_fields_are_checked_and_converted_as_their_types_say() -> None:
    rod = Rod(2)
    assert (rod.length, rod.width) == (2.0, 1.0)
    assert type(rod.length) is type(rod.width) is float
    with pytest.raises(tm.ProblemError, match=r"length is -1, .* number \[m\]"):
        Rod(-1)
    with pytest.raises(FrozenInstanceError):
        rod.length = 3.0  # type: ignore[misc]


def test_fields_that_are_declared_again_are_checked_as_in_the_base_class() -> None:
    assert Beam(1).width == 2.0
    with pytest.raises(tm.ProblemError, match="width is 0"):
        Beam(1, 0)


@pytest.mark.parametrize("name", sorted({*RECORDS} - KEPT))
def test_constructors_take_more_than_arrays(name: str) -> None:
    arguments = inspect.signature(getattr(tm, name).__init__).parameters.values()
    kinds = [re.sub(r"Converted\[.*\]", "", str(item.annotation)) for item in arguments]
    assert all("Array" not in kind for kind in kinds)


def test_the_blocks_of_a_document_are_one_module() -> None:
    text = "A\n```python\na = 1\n```\nB\n```sh\nls\n```\n```python\nb = a\n```\n"
    assert readme_module(text).endswith("a = 1\n\nb = a\n")
    with pytest.raises(SystemExit):
        readme_module("nothing")
