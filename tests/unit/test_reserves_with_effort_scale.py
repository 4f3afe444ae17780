"""Torque reserves of problems whose motion limits have an effort scale."""

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
def test_reserves_are_shares_of_the_scaled_efforts(
    rail: tm.Problem, segmented: bool
) -> None:
    problem = rail
    if segmented:
        part = tm.Segment(tm.JointGoal([1.0]), motion_limits=SHARE)
        problem = tm.Problem(rail.robot, [0.0], segments=[part])
    how: dict[str, Any] = {"disturbances": CALM, "samples": 1, "reserves": (0.0, 0.15)}
    found = robustness(problem, OPTIONS, **how)
    # T is proportional to 1 / sqrt(force): to 0.8, and to 0.8 times 0.85 of it.
    assert found.T[1] / found.T[0] == pytest.approx(0.85**-0.5, rel=1e-3)
    if not segmented:
        assert found.effort_scale == 0.8
        above = replace(found, kept=np.array([0.0, 1.0])).message
        assert "15% of the 80% that motions may use (effort_scale=0.68)" in above


def test_cost_is_relative_to_the_least_reserve_with_a_motion(rail: tm.Problem) -> None:
    how: dict[str, Any] = {"disturbances": CALM, "samples": 1, "reserves": (0.0,)}
    found = robustness(rail, OPTIONS, **how)
    one = {"reserves": [0.0, 0.1, 0.2], "T": [np.inf, 1.0, 1.1], "kept": [0, 0, 1]}
    changed = replace(found, **one, errors=np.zeros(3))
    assert changed.cost == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("disturbances", "a"), ("seed", "a"), ("seed", -1), ("samples", 10**400)],
)
def test_wrong_arguments_are_refused_before_planning(
    rail: tm.Problem, name: str, wrong: Any
) -> None:
    with pytest.raises(tm.ProblemError, match=f"{name} is "):
        robustness(rail, OPTIONS, **{name: wrong})


def test_payload_that_changes_during_the_motion_is_refused(rail: tm.Problem) -> None:
    frame = rail.robot.frame_names[-1]
    parts = [
        tm.Segment(tm.JointGoal([0.5]), stop=True),
        tm.Segment(tm.JointGoal([1.0]), payload=tm.Payload(0.1, frame)),
    ]
    problem = tm.Problem(rail.robot, [0.0], segments=parts)
    with pytest.raises(tm.ProblemError, match="a load changes during the motion"):
        robustness(problem, OPTIONS)
