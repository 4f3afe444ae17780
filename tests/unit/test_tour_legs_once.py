"""Legs of a tour are planned once, whatever asks for them again."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.cell.tours import legs
from tominpmp.cell.tours.legs import LegPlanner
from tominpmp.status import Status


def planner() -> LegPlanner:
    robot = make_arm(slide(2.0), effort=10.0)
    problem = tm.Problem(robot, [0.0], tm.JointGoal([1.0]))
    options = tm.Options(intervals=8, refine=None, effort="quick")
    stations = tuple(tm.Station(f"{k}", tm.JointGoal([k])) for k in (1.0, 2.0))
    return LegPlanner(problem, stations, options)


def test_a_leg_is_planned_once() -> None:
    own, (a, b) = planner(), np.array([[0.0], [1.0]])
    first = own.leg(None, 0, a, b)
    assert first is not None and first.success
    assert own.leg(None, 0, a.copy(), b.copy()) is first
    assert own.planned == 1
    assert own.leg(0, 1, b, 2.0 * b) is not first
    assert own.planned == 2


def test_a_leg_that_was_interrupted_is_planned_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    own, (a, b) = planner(), np.array([[0.0], [1.0]])
    states = [Status.INTERRUPTED, Status.STALLED]

    class Found:
        def __init__(self) -> None:
            self.status = states.pop(0)

    monkeypatch.setattr(legs, "plan", lambda *_: Found())
    assert own.leg(None, 0, a, b).status is Status.INTERRUPTED  # type: ignore[union-attr]
    assert own.leg(None, 0, a, b).status is Status.STALLED  # type: ignore[union-attr]
    assert own.leg(None, 0, a, b).status is Status.STALLED  # type: ignore[union-attr]
    assert own.planned == 2


def test_configurations_that_are_given_are_not_refined() -> None:
    """Rounding makes no other configuration, whose legs would be planned again."""
    robot = make_arm(slide(2.0), effort=10.0)
    few = {"intervals": 8, "refine": None, "effort": "quick", "starts": 1}
    goals = [
        tm.AnyGoal([tm.JointGoal([x]), tm.JointGoal([x + 0.1])]) for x in (0.4, 0.8)
    ]
    tour = tm.plan_tour(robot, [0.0], goals, exact=True, **few)
    assert tour.success
    # Of five places, two of them of the same station twice: 5 * 4 - 2 * 2.
    assert tour.legs_planned <= 16
