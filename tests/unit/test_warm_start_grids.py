"""The grid of the program that a former motion starts."""

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
    ("asked", "expected"), [(24, 24), (16, 16), (10, 16), (4, 16), (3, 3)]
)
def test_nodes_are_kept_unless_there_are_far_too_many(
    problem: tm.Problem, former: tm.Solution, asked: int, expected: int
) -> None:
    assert former.trajectory is not None
    system = ProblemFunctions.of(problem)
    guess = warm_start(system, former.trajectory)
    program, z = guess.spline_program(system, asked, "cosine", 3)
    of = program.transcription
    assert isinstance(of, BSplineTranscription)
    assert of.shares.shape == (expected, 1)
    nodes = np.append(0.0, np.cumsum(of.shares))
    kept = [
        np.min(np.abs(nodes - node)) < 1e-9 for node in former.trajectory.t / former.T
    ]
    assert all(kept) is (expected == FORMER)
    # The motion is the same, as far as the grid can represent it.
    there = of.trajectory(z)(np.linspace(0.0, former.T, 50)).q
    gone = former.trajectory(np.linspace(0.0, former.T, 50)).q
    assert np.max(np.abs(there - gone)) < (1e-9 if all(kept) else 0.1)
