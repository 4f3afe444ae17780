"""Each type of constraint or obstacle in scenario files is a public class."""

from __future__ import annotations

from typing import Any

import pytest

import tominpmp as tm
from tominpmp.constraints.path import PathConstraint
from tominpmp.files.records import classes
from tominpmp.scene.obstacles import Obstacle


@pytest.mark.parametrize("base", [PathConstraint, Obstacle], ids=str)
def test_types_are_public_classes(base: type[Any]) -> None:
    found = classes(base)
    assert len(found) > 5
    private = [
        name
        for name, kind in found.items()
        if kind.__module__.startswith("tominpmp.")
        and getattr(tm, kind.__name__, None) is not kind
    ]
    assert private == []
