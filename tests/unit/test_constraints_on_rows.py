"""Constraints on rows of states: values as at single states, guesses, certificates."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from test_loads import ITEMS as LOADS
from test_tool_constraints import ITEMS as TOOLS

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.constraints.base import States
from tominpmp.goals.direction import deviations
from tominpmp.initial_guess.guess import straight_guess
from tominpmp.transcription.problem_functions import ProblemFunctions

ITEMS = (*LOADS, *TOOLS, tm.ToolSpeed("tool0", 1.0), tm.KeepUpright("tool0"))
DIRECTION = np.array([0.0, 0.6, 0.8])


@pytest.fixture(scope="module")
def ur5():
    return tm.load_robot("ur5", limits="urdf")


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: type(item).__name__)
def test_constraint_rows_equal_those_of_single_states(item, ur5):
    ready = pickle.loads(pickle.dumps(item.on(ur5)))
    rng = np.random.default_rng(3)
    q, v, a = (rng.uniform(-2, 2, (4, 6)) for _ in range(3))
    states = States(np.zeros(4), q, v, a)
    values, sizes = ready.evaluate(states), ready.measures(states)
    at, entry = (part.ravel() for part in np.indices(values.shape))
    partials = ready.differentiate(states, at, entry)
    for k in range(4):
        assert sizes[k] == pytest.approx(ready.measure(q[k], v[k], a[k]), abs=1e-12)
        alone, *by = ready.terms(q[k], v[k], a[k])
        np.testing.assert_allclose(values[k], alone, atol=1e-12)
        for part, slope in zip(partials[1:4], by, strict=True):
            if part is None:
                assert not slope.size
            else:
                np.testing.assert_allclose(part[at == k], slope, atol=1e-12)


@pytest.mark.parametrize(
    "axis",
    [DIRECTION, -DIRECTION, (1.0, 0.0, 0.0), (0.0, 0.6 + 1e-5, 0.8), (0, -0.6, -0.8)],
)
def test_deviation_of_an_axis_has_the_length_and_slope_of_the_angle(axis):
    axis = np.array(axis) / np.linalg.norm(axis)
    (found, other), (by_axis, _) = deviations(np.array([axis, [1, 0, 0]]), DIRECTION)
    angle = np.arctan2(np.linalg.norm(np.cross(axis, DIRECTION)), axis @ DIRECTION)
    np.testing.assert_allclose(np.linalg.norm(found), angle, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(other), 0.5 * np.pi, atol=1e-12)
    if np.pi - angle < 1e-6:
        return  # opposite axes: the deviation has no unique direction
    for turn in 1e-6 * np.eye(3):
        step = np.cross(turn, axis)
        ends = deviations(np.array([axis - step, axis + step]), DIRECTION)[0]
        slope = 0.5 * (ends[1] - ends[0])
        np.testing.assert_allclose(by_axis @ step, slope, rtol=1e-4, atol=1e-11)


def test_certificate_includes_contact_and_keep_away_constraints():
    """Regression: these constraints raised an error in the certificate.

    The motion was called optimal without being examined.
    """
    rail = make_arm(slide(1.0), effort=np.array([100.0]), gravity=(0.0, 0.0, -9.81))
    tray = tm.StableContact("tip", (0, 0, 0.05), 0.2)
    away = tm.KeepAway("tip", (1.3, 0.0, 0.0), 0.2)
    held = tm.Problem(rail, [0.0], tm.JointGoal([1.0]), constraints=(tray, away))
    solution = tm.plan(held, effort="quick")
    assert solution.success, solution.message
    assert solution.certificate.ok, solution.certificate.message
    loose = tm.Problem(rail, [0.0], tm.JointGoal([1.0]))
    given = tm.certify(loose, solution.trajectory)
    assert given.stationarity > 20 * solution.certificate.stationarity


def test_initial_guess_is_slow_enough_for_its_load():
    """Regression: faster guesses were far from feasible, and ended in slow motions."""
    rail = make_arm(slide(1.0), effort=np.array([100.0]), gravity=(0.0, 0.0, -9.81))
    tray = tm.StableContact("tip", (0, 0, 0.05), 0.2)
    problem = tm.Problem(rail, [0.0], tm.JointGoal([1.0]), constraints=(tray,))
    guess = straight_guess(ProblemFunctions.of(problem), np.array([1.0]))
    fastest = 2.0 / np.sqrt(0.2 * 9.81)
    assert fastest * (1.0 - 1e-3) < guess.duration < 2.5 * fastest
    times = np.linspace(0.0, guess.duration, 400)
    a = np.gradient(np.gradient(guess.position(times), times, axis=0), times, axis=0)
    assert np.abs(a[5:-5]).max() < 1.2 * 0.2 * 9.81
    loose = tm.Problem(rail, [0.0], tm.JointGoal([1.0]))
    free = straight_guess(ProblemFunctions.of(loose), np.array([1.0]))
    assert free.duration < 0.3 * fastest
