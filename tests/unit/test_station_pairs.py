"""Pairs of names given to stations and tours are checked at once."""

from __future__ import annotations

from typing import Any

import pytest

import tominpmp as tm
from tominpmp.cell.tours.station import Rules


@pytest.mark.parametrize("wrong", [3, "hand", [("hand",)], [("hand", 2)], [("", "a")]])
def test_may_touch_of_a_station_must_be_pairs_of_names(wrong: Any) -> None:
    with pytest.raises(tm.ProblemError, match=r"may_touch") as caught:
        tm.Station("drill", tm.JointGoal([0.0]), may_touch=wrong)
    assert caught.value.field == "station.may_touch"


@pytest.mark.parametrize("wrong", [3, "drill", [("drill",)], [("drill", 2)]])
def test_wrong_precedence_is_rejected_with_its_field(wrong: Any) -> None:
    stations = [tm.Station("drill", tm.JointGoal([0.0]))]
    with pytest.raises(tm.ProblemError, match="precedence") as caught:
        Rules.of(stations, wrong)
    assert caught.value.field == "precedence"
