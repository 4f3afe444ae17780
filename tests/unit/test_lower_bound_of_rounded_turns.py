"""Rotations by rounding errors add no time to lower bounds.

Regression: a goal pose that differs by the last digits from the pose at the start gave
an arm of sliding joints a lower bound of more than a minute, on some machines.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from sample_arms import make_arm, slide

import tominpmp as tm
from tominpmp.kinematics import RobotKinematics

ROUNDED = 1e-8  # angle that the arc cosine yields for an error of the last digit [rad]


@pytest.fixture(scope="module")
def rail() -> tm.Robot:
    return make_arm(slide(1.0), effort=10.0, velocity=1.0)


@pytest.mark.parametrize("kind", ["pose", "axis"])
def test_rounded_orientation_goal_keeps_the_bound_below_the_motion_time(
    rail: tm.Robot, kind: str
) -> None:
    there = RobotKinematics(rail).placement(np.array([0.2]), "tip")
    turned = pin.exp3(np.array([0.0, ROUNDED, 0.0])) @ there.rotation
    if kind == "pose":
        goal = tm.PoseGoal("tip", pin.SE3(turned, there.translation))
    else:
        x = (1.0, 0.0, 0.0)
        goal = tm.AxisGoal("tip", x, turned[:, 0], position=there.translation)
    solution = tm.plan(tm.Problem(rail, [0.0], goal), effort="quick", refine=None)
    assert solution.success
    assert solution.lower_bound is not None
    assert 0.0 < solution.lower_bound.T <= solution.T * (1.0 + 1e-6)


def test_rotation_beyond_rounding_is_part_of_the_bound() -> None:
    arm = tm.load_robot("planar3r")
    start = np.array([0.5, 1.7, -1.7])
    goal = tm.AxisGoal("tip", (1.0, 0.0, 0.0), (-1.0, 0.2, 0.0))
    bound = tm.lower_bound(tm.Problem(arm, start, goal))
    assert "rad to turn" in bound.reason and bound.T > 0.0
