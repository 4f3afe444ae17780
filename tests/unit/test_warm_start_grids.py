"""On which grid a former motion is gone on with."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.initial_guess.warm_start import warm_start
from tominpmp.transcription.bspline import BSplineTranscription
from tominpmp.transcription.problem_functions import ProblemFunctions

FORMER = 16


@pytest.fixture(scope="module")
def problem() -> tm.Problem:
    robot = tm.load_robot("planar3r", gravity=(0, 0, 0))
    return tm.Problem(robot, (0.5, 1.7, -1.7), tm.JointGoal((0.9, 1.3, -1.2)))


@pytest.fixture(scope="module")
def former(problem: tm.Problem) -> tm.Solution:
    quick = {"effort": "quick", "refine": None, "starts": 1, "max_iterations": 4}
    return tm.plan(problem, intervals=FORMER, control="linear", **quick)


@pytest.mark.parametrize(
    ("asked", "expected", "own"),
    [(24, 24, False), (16, 16, True), (10, 16, True), (6, 12, False)],
)
def test_fine_grids_are_kept_and_the_finest_are_not(
    problem: tm.Problem, former: tm.Solution, asked: int, expected: int, own: bool
) -> None:
    assert former.trajectory is not None
    system = ProblemFunctions.of(problem)
    guess = warm_start(system, former.trajectory)
    program, z = guess.spline_program(system, asked, "cosine", 3)
    of = program.transcription
    assert isinstance(of, BSplineTranscription)
    assert of.shares.shape == (expected, 1)
    lengths = np.diff(former.trajectory.t) / former.trajectory.duration
    assert (expected == FORMER and np.allclose(of.shares[:, 0], lengths)) is own
    # The motion is what it was, as far as the grid can show it.
    there = of.trajectory(z)(np.linspace(0.0, former.T, 50)).q
    gone = former.trajectory(np.linspace(0.0, former.T, 50)).q
    assert np.max(np.abs(there - gone)) < 0.02
