"""Annotated types of constructors are the types that the constructors accept."""

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
# Records that the library makes, not its users.
MADE_BY_THE_LIBRARY = {
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


def test_fields_are_checked_and_converted_by_their_annotations() -> None:
    rod = Rod(2)
    assert (rod.length, rod.width) == (2.0, 1.0)
    assert type(rod.length) is type(rod.width) is float
    with pytest.raises(tm.ProblemError, match=r"length is -1, .* number \[m\]"):
        Rod(-1)
    with pytest.raises(FrozenInstanceError):
        rod.length = 3.0  # type: ignore[misc]


def test_redeclared_fields_are_checked_as_in_the_base_class() -> None:
    assert Beam(1).width == 2.0
    with pytest.raises(tm.ProblemError, match="width is 0"):
        Beam(1, 0)


@pytest.mark.parametrize("name", sorted({*RECORDS} - MADE_BY_THE_LIBRARY))
def test_constructors_are_annotated_with_more_than_arrays(name: str) -> None:
    arguments = inspect.signature(getattr(tm, name).__init__).parameters.values()
    kinds = [re.sub(r"Converted\[.*\]", "", str(item.annotation)) for item in arguments]
    assert all("Array" not in kind for kind in kinds)


def test_code_blocks_of_a_document_become_one_module() -> None:
    text = "A\n```python\na = 1\n```\nB\n```sh\nls\n```\n```python\nb = a\n```\n"
    assert readme_module(text).endswith("a = 1\n\nb = a\n")
    with pytest.raises(SystemExit):
        readme_module("nothing")
