"""Legs of a tour are planned once, whatever asks for them again."""

from __future__ import annotations

import tominpmp as tm
from tests.sample_arms import make_arm, slide


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
