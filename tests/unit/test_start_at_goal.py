"""A start that meets the goal already: an answer, whatever is to be refined."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm

START = [0.5, 1.7, -1.7]


def goals() -> list[tm.Goal]:
    from tominpmp.kinematics import RobotKinematics

    robot = tm.load_robot("planar3r")
    tip = RobotKinematics(robot).placement(np.array(START), "tip").translation
    return [
        tm.PositionGoal("tip", tip, tolerance=0.05),
        tm.PositionGoal("tip", tip + 0.01, tolerance=0.05),
        tm.JointRegionGoal(START, tolerance=0.1),
        tm.JointRegionGoal([x + 0.05 for x in START], tolerance=0.1),
    ]


@pytest.mark.parametrize("number", range(4))
@pytest.mark.parametrize("refine", ["switching", "grid"])
def test_a_start_within_the_goal(number: int, refine: str) -> None:
    problem = tm.Problem(tm.load_robot("planar3r"), START, goals()[number])
    solution = tm.plan(problem, tm.Options(intervals=8, starts=1, refine=refine))
    assert solution.success
    assert 0.0 < solution.T < 1e-4
    assert "nothing to refine" in solution.message
