"""What type checkers are told of constructors is what the constructors take."""

from __future__ import annotations

import inspect
import re
from dataclasses import is_dataclass

import pytest

import tominpmp as tm
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
