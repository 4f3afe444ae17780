"""The grid of a program that is warm-started from a former motion."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.initial_guess.warm_start import warm_start
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
    ("intervals", "expected"), [(24, 24), (16, 16), (10, 16), (4, 16), (3, 3)]
)
def test_warm_start_keeps_the_nodes_of_the_former_motion(
    problem: tm.Problem, former: tm.Solution, intervals: int, expected: int
) -> None:
    assert former.trajectory is not None
    system = ProblemFunctions.of(problem)
    guess = warm_start(system, former.trajectory)
    of, z = guess.iterate(system, intervals, "cosine", 3)
    assert of.shares.shape == (expected, 1)
    nodes = np.append(0.0, np.cumsum(of.shares))
    kept = [
        np.min(np.abs(nodes - node)) < 1e-9 for node in former.trajectory.t / former.T
    ]
    assert all(kept) is (expected == FORMER)
    # The motion is the same, as far as the grid can represent it.
    represented = of.trajectory(z)(np.linspace(0.0, former.T, 50)).q
    original = former.trajectory(np.linspace(0.0, former.T, 50)).q
    assert np.max(np.abs(represented - original)) < (1e-9 if all(kept) else 0.1)
