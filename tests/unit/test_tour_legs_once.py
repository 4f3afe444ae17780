"""Legs of a tour are planned only once."""

from __future__ import annotations

import tominpmp as tm
from tests.sample_arms import make_arm, slide


def test_configurations_given_as_goals_are_not_refined() -> None:
    """Rounding would otherwise make other configurations, whose legs would be planned
    again.
    """
    robot = make_arm(slide(2.0), effort=10.0)
    few = {"intervals": 8, "refine": None, "effort": "quick", "starts": 1}
    goals = [
        tm.AnyGoal([tm.JointGoal([x]), tm.JointGoal([x + 0.1])]) for x in (0.4, 0.8)
    ]
    tour = tm.plan_tour(robot, [0.0], goals, exact=True, **few)
    assert tour.success
    # Five configurations, in two pairs for one station each: 5 * 4 - 2 * 2 legs.
    assert tour.legs_planned <= 16
