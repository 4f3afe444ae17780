"""Base placements of robots in a workcell: errors name the robot."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.combined_robots import base_placement

ORIGIN = (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "base",
    [
        (ORIGIN, (0.0, 0.0, 0.0, 0.0)),
        (ORIGIN, (np.nan, 0.0, 0.0, 1.0)),
        (ORIGIN, (1e-12, 0.0, 0.0, 0.0)),
        (ORIGIN, 2.0 * np.eye(3)),
        (0.0, np.inf, 0.0),
        "left",
    ],
)
def test_invalid_base_is_reported_with_the_name_of_the_robot(base: object) -> None:
    with pytest.raises(tm.ProblemError, match="the base of 'left'") as caught:
        base_placement("left", base)
    assert caught.value.field == "robots"


def test_base_placement_normalises_its_quaternion() -> None:
    found = base_placement("left", (ORIGIN, (0.0, 0.0, 3.0, 3.0)))
    turned = found.rotation @ [1.0, 0.0, 0.0]
    np.testing.assert_allclose(turned, [0.0, 1.0, 0.0], atol=1e-12)
