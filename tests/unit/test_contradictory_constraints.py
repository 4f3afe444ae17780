"""Constraints that cannot be satisfied: messages name them, and their violation."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, rod, slide
from tominpmp.exceptions import ProblemError
from tominpmp.initial_guess.inverse_kinematics import Target
from tominpmp.status import Status
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.diagnosis import explain

QUICK = {"intervals": 12, "refine": None, "effort": "quick", "starts": 1}
UP = (1.0, 0.0, 0.0)


def arm() -> tm.Robot:
    """Three links of 1 m in a plane without gravity."""
    return make_arm(rod(1.0, 1.0), rod(1.0, 1.0), rod(1.0, 1.0), effort=np.full(3, 9.0))


def level(tolerance: float = 0.05) -> tm.KeepUpright:
    """The last link along x."""
    return tm.KeepUpright("tip", UP, UP, tolerance)


START = [0.8, -1.6, 0.8]


def test_inverse_kinematics_satisfies_the_constraints():
    goal = tm.PositionGoal("tip", (2.2, 0.5, 0.0))
    problem = tm.Problem(arm(), START, goal, constraints=(level(),))
    found = Target(ProblemFunctions.of(problem), goal).configurations(
        10, np.random.default_rng(0)
    )
    assert found.free
    ready = problem.ready_constraints[0]
    empty = np.zeros(0)
    for q in found.free:
        assert ready.measure(q, empty, empty) <= 0.05 + 1e-6


def test_goal_out_of_reach_within_a_cone_is_an_error():
    goal = tm.PositionGoal("tip", (0.0, 2.9, 0.0))  # nearly stretched out along y
    problem = tm.Problem(arm(), START, goal, constraints=(level(),))
    words = (
        r"goal: no configuration was found that reaches it and keeps the tilt of frame "
        r"tip: in the nearest one it is 1\.\d+ rad, 1\.\d rad more than its limit 0\.05"
    )
    with pytest.raises(ProblemError, match=words):
        tm.plan(problem, **QUICK)


def test_via_point_out_of_reach_within_a_cone_names_its_segment():
    via = tm.Segment(tm.PositionGoal("tip", (0.0, 2.9, 0.0)), constraints=(level(),))
    end = tm.Segment(tm.JointGoal([0.5, -1.0, 0.5]))
    problem = tm.Problem(arm(), START, segments=[via, end])
    words = r"segment 1 of 2: goal: no configuration .* keeps the tilt of frame tip"
    with pytest.raises(ProblemError, match=words):
        tm.plan(problem, **QUICK)


@pytest.mark.parametrize(
    ("one", "other", "words"),
    [
        (
            tm.WithinRegion("tip", (1.9, -0.1, -1), (2.0, 0.1, 1)),
            tm.KeepAway("tip", (2.0, 0.0, 0.0), 0.5),
            r"distance from its region of frame tip .* with the intrusion of frame tip",
        ),
        (
            level(),
            tm.KeepUpright("tip", UP, (0.0, 1.0, 0.0), 0.05),
            r"tilt of frame tip .* with the tilt of frame tip",
        ),
        (
            tm.JointCoupling(("joint1",), (1.0,), upper=0.9, lower=0.7),
            tm.JointCoupling(("joint1",), (1.0,), upper=0.5),
            r"coupling of joints joint1 .* with the coupling of joints joint1",
        ),
    ],
)
def test_contradictory_constraints_are_both_named(one, other, words):
    with pytest.raises(ProblemError, match=words) as caught:
        tm.Problem(arm(), START, tm.JointGoal(START), constraints=(one, other))
    assert "contradict each other" in str(caught.value)


def test_start_outside_a_cone_is_not_called_a_contradiction():
    with pytest.raises(
        ProblemError, match=r"start: the tilt of frame tip is"
    ) as caught:
        goal, tilted = tm.JointGoal(START), [0.8, -1.6, 1.2]
        tm.Problem(arm(), tilted, goal, constraints=(level(),))
    assert "contradict" not in str(caught.value)


def test_violated_constraint_is_named_with_its_frame_and_time():
    """Regression: the message named a joint with the name of the frame."""
    rail = make_arm(slide(1.0), effort=np.array([5.0]))
    motion = tm.plan(tm.Problem(rail, [0.0], tm.JointGoal([1.0])), **QUICK).trajectory
    wall = tm.KeepAway("tip", (0.5, 0.0, 0.0), 0.2)
    problem = tm.Problem(rail, [0.0], tm.JointGoal([1.0]), constraints=(wall,))
    text = explain(problem, motion, Status.INFEASIBLE, (1, 1))
    assert "the intrusion of frame tip is 0.2 m beyond its limit at 0.4" in text
    assert "What may help: a wider limit of the intrusion of frame tip." in text


@pytest.mark.parametrize(
    ("item", "words"),
    [
        (
            tm.StableContact("tip", (0, 0, 0.1), 0.3),
            r"lack of grip of frame tip is 0\.\d+ of the weight at rest: .* leans by "
            r"45 deg, and friction 0\.3 holds it up to 16\.7 deg",
        ),
        (
            tm.StableContact("tip", (0.1, 0, 0.1), 2.0, 0.05),
            r"lack of grip of frame tip is .* presses beyond the edge of its support",
        ),
        (
            tm.FirmGrasp("tip", 4.0, 0.5, 1.0, axis=(1, 0, 0)),
            r"load of the grasp of frame tip is 6\.\d+ N at rest: .* no more than 4 N",
        ),
    ],
)
def test_load_that_cannot_be_held_at_rest_names_the_cause(item, words):
    tilted = (9.81 * math.sin(math.pi / 4), 0.0, -9.81 * math.cos(math.pi / 4))
    rail = make_arm(slide(1.0), effort=np.array([100.0]), gravity=tilted)
    with pytest.raises(ProblemError, match=words):
        tm.Problem(rail, [0.0], tm.JointGoal([1.0]), constraints=(item,))
