"""Clearance rows added at the closest approaches between rows, for fast arms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.arrays import Array
from tominpmp.planner.candidate import Candidate
from tominpmp.status import Status
from tominpmp.transcription.bspline import InverseTranscription
from tominpmp.transcription.exchange import exchanged
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

# A box and a ball, side by side where the tip passes: without further rows the plan
# ended at 3.855 s, with a predicted gain of 6 %.
START, GOAL = [2.36108, -0.14796, 1.95794], [2.74605, 0.83243, 2.70663]
BOX = tm.Box("box", size=[0.212, 0.36, 0.274], position=[-3.6765, 1.1352, 0.0])
BALL = tm.Sphere("ball", radius=0.1593, position=[-3.3817, 0.5666, 0.0])


@pytest.fixture(scope="module")
def problem() -> tm.Problem:
    """The arm of the paper between a box and a ball."""
    arm = tm.load_robot("planar3r")
    return tm.Problem(arm, START, tm.JointGoal(GOAL), tm.Scene([BOX, BALL]))


def test_plan_converges_again_after_rows_were_added_between_rows(
    problem: tm.Problem,
) -> None:
    solution = tm.plan(problem)

    assert solution.success
    assert solution.T < 2.8
    assert solution.status is Status.CONVERGED
    assert solution.certificate.ok


@pytest.mark.parametrize("angle", np.linspace(1.38, 1.52, 8))
def test_obstacle_passed_between_two_rows_becomes_a_row(angle: float) -> None:
    """The tip moves 19 cm from one row to the next, through a ball of 10 cm."""
    place = 5.95 * np.array([np.cos(angle), np.sin(angle), 0.0])
    ball = tm.Sphere("ball", radius=0.05, position=place)
    start, way = np.array([0.2, 0.0, 0.0]), np.array([2.7, 0.0, 0.0])
    arm = tm.load_robot("planar3r", velocity=100.0)
    problem = tm.Problem(arm, start, tm.JointGoal(start + way), tm.Scene([ball]))
    system = ProblemFunctions.of(problem)
    of = InverseTranscription(system, np.full((6, 1), 1.0 / 6.0), 0.2)

    def path(t: Array) -> Array:
        share = t / 0.2
        return start + np.multiply.outer(share**2 * (3.0 - 2.0 * share), way)

    z = of.start(path, 0.2, np.array([0.2]))
    program = NonlinearProgram.of(of).at(z)

    more = exchanged(program, z)

    assert more is not None
    assert _clearance(program, z).max() < 0.0 < _clearance(more, z).max()


def test_replay_finds_no_collision_that_the_rows_missed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Regression: instants close to others were left out of the rows.

    The tip moves 3 cm between two neighbouring instants.
    """
    replayed: list[Candidate] = []

    def recorded(self: Candidate, *args: Any, **options: Any) -> Candidate:
        replayed.append(found := verified(self, *args, **options))
        return found

    verified = Candidate.verified
    monkeypatch.setattr(Candidate, "verified", recorded)
    arm = tm.load_robot("planar3r")
    arm = arm.with_changes(velocity=4.0 * arm.limits.velocity)
    box = tm.Box("box", size=[0.2192, 0.3548, 0.3104], position=[-4.1142, -1.59, 0.0])
    ball = tm.Sphere("ball", radius=0.17434, position=[-5.1363, -1.5947, 0.0])
    goal = tm.JointGoal([2.6893, 0.8554, 1.4335])
    problem = tm.Problem(arm, [2.2786, 0.5413, -2.6622], goal, tm.Scene([box, ball]))

    assert tm.plan(problem).success

    verdicts = [one.verification for one in replayed if one.verification is not None]
    assert verdicts
    assert all(one.ok for one in verdicts)


def _clearance(program: NonlinearProgram, z: Array) -> Array:
    """Violations of the clearance at the instants of a program."""
    of = program.transcription
    (block,) = (one for one in program.blocks if one.name == "clearance")
    _, states = block.states(of.motion(z))
    return block.constraint.evaluate(states)
