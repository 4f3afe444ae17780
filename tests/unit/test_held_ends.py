"""Ends of motions at goals on frames, where the motors have to hold the arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from sample_arms import DOWNWARD, make_arm, rod

import tominpmp as tm
from tominpmp.constraints.base import States
from tominpmp.exact.switching_refinement import KEPT
from tominpmp.transcription.problem_functions import ProblemFunctions

EFFORT = np.array([9.0, 5.0, 2.0])
START, THERE = [1.55, 0.08, 2.57], [-0.387, -0.464, 0.0]
# A configuration in which the first motor lacks torque for the weight of the arm.
UNHELD = [0.1, 0.0, 0.2]


def make(effort: np.ndarray = EFFORT, load: float = 0.0) -> tm.Robot:
    """Three links in a vertical plane, whose motors do not hold them everywhere."""
    links = rod(1.0, 0.5), rod(1.0, 0.4), rod(1.0, 0.3)
    arm = make_arm(*links, effort=effort, gravity=DOWNWARD, velocity=3.0)
    return arm.with_payload(tm.Payload(load, "tip", name="load")) if load else arm


def problem(arm: tm.Robot, goal: tm.Goal | None = None) -> tm.Problem:
    goal = tm.PositionGoal("tip", THERE) if goal is None else goal
    return tm.Problem(arm, START, goal, self_collision=False)


def holding(arm: tm.Robot, q: np.ndarray) -> float:
    """Largest torque that holds the arm, as a share of its limit."""
    data = arm.model.createData()
    torque = pin.computeGeneralizedGravity(arm.model, data, np.array(q))
    return float(np.max(np.abs(torque) / arm.limits.effort_upper))


@pytest.fixture(scope="module")
def held() -> tm.Solution:
    """A motion to a goal whose fastest end the motors could not hold."""
    return tm.plan(problem(make()), effort="quick", max_planning_time=60.0)


def test_arm_ends_where_its_motors_hold_it(held: tm.Solution) -> None:
    """It was braked by torques within limits where its weight exceeds them by 7 %."""
    assert held.success, held.message
    assert holding(make(), held.trajectory.q[-1]) <= 1.0 + 1e-5
    assert held.certificate.ok


def test_several_segments_end_where_motors_hold_the_arm() -> None:
    """A goal on the way at which the arm stops counts, one that it passes does not."""
    there = tm.PositionGoal("tip", THERE)
    for stop in (True, False):
        segments = [tm.Segment(there, stop=stop), tm.Segment(tm.JointGoal(START))]
        task = replace(problem(make()), goal=None, segments=segments)
        solution = tm.plan(task, effort="quick", max_planning_time=60.0)
        assert solution.success, solution.message
        between = solution.trajectory(solution.segments[0].end).q
        assert (holding(make(), between) <= 1.0 + 1e-5) is stop


def test_replay_names_the_motor_that_cannot_hold_the_end(held: tm.Solution) -> None:
    """A motion of any origin ends at rest, so its end is checked as a plan's is."""
    weaker = make(EFFORT * [0.97, 1.0, 1.0])
    verdict = tm.verify(problem(weaker), held.trajectory, tm.Tolerances(limits=0.02))
    kinds = {item.kind: str(item) for item in verdict.violations}
    assert "joint joint1 is " in kinds["holding torque"]
    assert "beyond its holding torque limit" in kinds["holding torque"]
    tolerant = tm.Tolerances(limits=0.04)
    verdict = tm.verify(problem(weaker), held.trajectory, tolerant)
    assert not verdict.worst["holding torque"].violated


def test_start_moves_to_a_held_end_of_the_same_goal() -> None:
    """A goal that the start meets where it is not held was refused, with its rivals."""
    arm = make()
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, np.array(UNHELD))
    here = tm.PositionGoal("tip", data.oMf[arm.model.getFrameId("tip")].translation)
    assert holding(arm, UNHELD) > 1.0
    away = tm.AnyGoal([here, tm.JointGoal([-1.5, 0.0, 0.0])])
    task = tm.Problem(arm, UNHELD, away, self_collision=False)
    solution = tm.plan(task, effort="quick", max_planning_time=60.0)
    assert solution.success, solution.message
    assert holding(arm, solution.trajectory.q[-1]) <= 1.0 + 1e-5


def test_holding_torques_have_the_derivatives_of_finite_differences(rng) -> None:
    item = ProblemFunctions.of(problem(make())).held
    assert item is not None
    q = rng.normal(size=(4, 3))

    def states(q: np.ndarray) -> States:
        return States(np.zeros(len(q)), q, rng.normal(size=q.shape), np.zeros(0))

    at, which = (part.ravel() for part in np.indices((4, 3)))
    by_q = item.differentiate(states(q), at, which).by_q
    for joint, step in enumerate(1e-6 * np.eye(3)):
        ends = (item.evaluate(states(q + sign * step)) for sign in (1.0, -1.0))
        upper, lower = ends
        slope = (upper - lower) / 2e-6
        assert_allclose(by_q[:, joint], slope.ravel(), atol=1e-7)


def test_sensitivities_count_the_torques_that_hold_the_end() -> None:
    """A stronger motor, or less load, lets the arm end in another configuration."""

    def logarithm(share: float, load: float) -> float:
        arm = make(EFFORT * [share, 1.0, 1.0], load)
        found = tm.plan(problem(arm), start=planned, **options)
        return float(np.log(found.T))

    options = {"effort": "quick", "refine": "grid", "max_planning_time": 60.0}
    options["intervals"] = 60
    planned = tm.plan(problem(make(load=0.1)), **options)
    table = {(x.kind, x.joint): x.value for x in planned.sensitivities}
    assert holding(make(load=0.1), planned.trajectory.q[-1]) == pytest.approx(1.0)
    slope = (logarithm(1.02, 0.1) - logarithm(0.98, 0.1)) / 0.04
    assert table["effort", "joint1"] == pytest.approx(slope, rel=0.1)
    slope = (logarithm(1.0, 0.12) - logarithm(1.0, 0.08)) / 0.4
    assert table["payload", None] == pytest.approx(slope, rel=0.1)


def test_exact_switching_ends_where_the_motors_hold_the_arm() -> None:
    """Regression: its arcs ended elsewhere, so that no exact motion was confirmed."""
    effort = np.array([4.348, 1.636])
    links = rod(1.0, 0.5), rod(0.6, 0.4)
    arm = make_arm(*links, effort=effort, gravity=DOWNWARD, velocity=20.0)
    goal = tm.JointRegionGoal({"joint1": 0.069}, 0.05)
    task = tm.Problem(arm, [-1.131, 0.294], goal, self_collision=False)
    solution = tm.plan(task, refine="switching", starts=1, max_planning_time=60.0)
    assert solution.success, solution.message
    assert KEPT not in solution.message
    assert holding(arm, solution.trajectory.q[-1]) == pytest.approx(1.0, abs=1e-6)
