"""Torque reserves of a problem that leaves some of its torques unused already."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from robot_samples import chain

import tominpmp as tm
from tominpmp.physics.robustness import Disturbances, robustness

OPTIONS = tm.Options(intervals=8, effort="quick", starts=1)
CALM = Disturbances(payload=0, friction=0, delay=0, noise=0)
SHARE = tm.MotionLimits(effort_scale=0.8)


@pytest.fixture(scope="module")
def rail() -> tm.Problem:
    pytest.importorskip("mujoco")
    text = chain("").replace('type="revolute"', 'type="prismatic"')
    robot = tm.load_robot(text, gravity=(0, 0, 0), velocity=100.0)
    return tm.Problem(robot, [0.0], tm.JointGoal([1.0]), motion_limits=SHARE)


@pytest.mark.parametrize("segmented", [False, True])
def test_reserves_are_shares_of_what_motions_may_use(
    rail: tm.Problem, segmented: bool
) -> None:
    problem = rail
    if segmented:
        part = tm.Segment(tm.JointGoal([1.0]), motion_limits=SHARE)
        problem = tm.Problem(rail.robot, [0.0], segments=[part])
    how: dict[str, Any] = {"disturbances": CALM, "samples": 1, "reserves": (0.0, 0.15)}
    found = robustness(problem, OPTIONS, **how)
    # T is as the root of the force: 0.8, and 0.8 times 0.85 of it.
    assert found.T[1] / found.T[0] == pytest.approx(0.85**-0.5, rel=1e-3)
    if not segmented:
        assert found.effort_scale == 0.8
        above = replace(found, kept=np.array([0.0, 1.0])).message
        assert "15% of the 80% that motions may use (effort_scale=0.68)" in above


def test_the_cost_is_told_where_the_first_has_no_motion(rail: tm.Problem) -> None:
    how: dict[str, Any] = {"disturbances": CALM, "samples": 1, "reserves": (0.0,)}
    found = robustness(rail, OPTIONS, **how)
    one = {"reserves": [0.0, 0.1, 0.2], "T": [np.inf, 1.0, 1.1], "kept": [0, 0, 1]}
    told = replace(found, **one, errors=np.zeros(3))
    assert told.cost == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("disturbances", "a"), ("seed", "a"), ("seed", -1), ("samples", 10**400)],
)
def test_what_is_wrong_is_told_before_anything_is_planned(
    rail: tm.Problem, name: str, wrong: Any
) -> None:
    with pytest.raises(tm.ProblemError, match=f"{name} is "):
        robustness(rail, OPTIONS, **{name: wrong})


def test_loads_on_the_way_are_refused(rail: tm.Problem) -> None:
    frame = rail.robot.frame_names[-1]
    parts = [
        tm.Segment(tm.JointGoal([0.5]), stop=True),
        tm.Segment(tm.JointGoal([1.0]), payload=tm.Payload(0.1, frame)),
    ]
    problem = tm.Problem(rail.robot, [0.0], segments=parts)
    with pytest.raises(tm.ProblemError, match="a load changes during the motion"):
        robustness(problem, OPTIONS)
