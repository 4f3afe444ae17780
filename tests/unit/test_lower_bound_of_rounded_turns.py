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


def test_bound_of_segments_holds_for_the_other_turn_of_an_angle() -> None:
    """Regression: from 3 rad, -3 rad is 6 rad away, and 0.28 rad from 3 rad less a
    turn; the bound was 9 s, and the motion took 4 s.
    """
    arm = tm.load_robot(
        "planar3r",
        position_lower=[-4.0, -2.0, -2.0],
        position_upper=[3.2, 2.0, 2.0],
        velocity=[1.0, 10.0, 10.0],
        gravity=(0.0, 0.0, 0.0),
    )
    goals = [tm.JointGoal([q, 0.0, 0.0], wrap=["joint1"]) for q in (3.0, -3.0)]
    segments = [tm.Segment(goal, stop=True) for goal in goals]
    problem = tm.Problem(arm, [0.0, 0.0, 0.0], segments=segments)
    bound, solution = tm.lower_bound(problem), tm.plan(problem, effort="quick")
    assert solution.success and solution.T < 4.5
    # The least way is 3 rad and another 0.28 rad.
    assert 2.0 * np.pi - 3.0 - 1e-6 < bound.T < solution.T


def test_energy_bound_of_segments_holds_for_the_other_turn_of_an_angle() -> None:
    """Regression: the bound of heavy rotors was 12.0 s, and the motion took 11.1 s."""
    arm = tm.load_robot(
        "planar3r",
        position_lower=[-4.0, -2.0, -2.0],
        position_upper=[3.2, 2.0, 2.0],
        velocity=50.0,
        effort=5.0,
        armature=20.0,
        gravity=(0.0, 0.0, 0.0),
    )
    goals = [tm.JointGoal([q, 0.0, 0.0], wrap=["joint1"]) for q in (3.0, -3.0)]
    segments = [tm.Segment(goal, stop=True) for goal in goals]
    problem = tm.Problem(arm, [0.0, 0.0, 0.0], segments=segments)
    bound, solution = tm.lower_bound(problem), tm.plan(problem, effort="quick")
    assert solution.success and 0.5 * solution.T < bound.T <= solution.T
