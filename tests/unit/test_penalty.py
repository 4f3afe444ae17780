"""The exterior penalty function method: known optima, and how the iteration ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sample_arms import make_arm, slide

import tominpmp as tm
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.loop import Loop, solve
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.penalty import penalty_rounds
from tominpmp.status import Status
from tominpmp.transcription.adjoint import AdjointTranscription
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

INTERVALS = 10
LEAST = 2.0 * np.sqrt(1.0 / 2.0)  # one metre at 2 m/s^2, from rest to rest


def on_a_rail(**limits):
    robot = make_arm(slide(2.0), effort=4.0, **limits)
    problem = tm.Problem(robot, [0.0], tm.JointGoal([1.0]))
    shares = np.full((INTERVALS, 1), 1.0 / INTERVALS)
    transcription = AdjointTranscription(ProblemFunctions.of(problem), shares, 1.0)
    nlp = NonlinearProgram.of(transcription)
    return nlp, nlp.transcription.pack(np.zeros((INTERVALS, 1)), np.array([1.0]))


def solved(nlp, z, callback=None, keep=None, **options):
    options = tm.Options(**options)
    least, method = MinimumTime.of(options), penalty_rounds(options, z)
    return solve(nlp, least, z, *method, callback=callback, keep=keep)


def test_penalty_method_ends_near_the_minimum_time():
    nlp, z = on_a_rail()
    result = solved(nlp, z, feasibility=1e-5)
    assert result.status is Status.CONVERGED
    assert result.best.violation <= 1e-5
    # The minimum time to the final state of the motion, which is not quite the goal.
    motion = nlp.trajectory(result.best.z)
    q, v = float(motion.q[-1, 0]), float(motion.v[-1, 0])
    least = np.sqrt(2.0 * q + 0.5 * v**2) - 0.5 * v
    assert least * (1 - 1e-9) <= result.best.duration <= 1.02 * LEAST
    torque = nlp.transcription.torques(result.best.z)
    assert np.abs(torque).max() <= 4.0 * (1 + 1e-12)


def test_path_constraints_are_penalised_too():
    nlp, z = on_a_rail(velocity=0.8)
    result = solved(nlp, z, feasibility=1e-4)
    assert result.status is Status.CONVERGED
    least = 1.0 / 0.8 + 0.8 / 2.0
    assert least * (1 - 1e-5) <= result.best.duration <= 1.05 * least
    assert np.abs(nlp.trajectory(result.best.z).v).max() <= 0.8 * (1 + 1e-4)


def test_violations_fall_as_the_weight_grows():
    """From outside: T rises with the weight K, and violations fall like 1 / K."""
    nlp, z = on_a_rail()
    options = tm.Options()
    step, _ = penalty_rounds(options, z)
    least = MinimumTime.of(options)
    loop = Loop(nlp, least, Iterate.of(nlp, z, 0.0))
    durations, violations = [], []
    for weight in (300.0, 3e3, 3e4):
        weights = np.full(len(nlp.rows.kinds), weight * step.first_weight("goal"))
        for _ in range(8):  # to the minimum for each weight
            loop.state = replace(loop.state, weights=weights)
            step(loop)
        durations.append(loop.state.duration)
        violations.append(loop.state.violation)
    assert durations[0] < durations[1] < durations[2] < LEAST
    assert violations[0] > violations[1] > violations[2]
    assert violations[1] / violations[2] == pytest.approx(10.0, rel=0.1)


def test_a_goal_out_of_reach_is_infeasible():
    # The first joint may hardly turn, and the others alone do not bring the tip there.
    narrow = {"joint1": 0.6, "joint2": 3.0, "joint3": 3.0}
    robot = tm.load_robot("planar3r", position_upper=narrow, position_lower=0.4)
    goal = tm.PositionGoal("tip", (-4, 0, 0))
    problem = tm.Problem(robot, (0.5, 0.5, 0.5), goal)
    shares = np.full((INTERVALS, 1), 1.0 / INTERVALS)
    transcription = AdjointTranscription(ProblemFunctions.of(problem), shares, 1.5)
    nlp = NonlinearProgram.of(transcription)
    z = nlp.transcription.pack(np.zeros((INTERVALS, 3)), np.array([1.5]))
    result = solved(nlp, z)
    assert result.status is Status.INFEASIBLE
    assert result.best is None
    assert result.iterate.violation > 0.01
    assert len(result.history) < 20 * tm.Options().max_iterations


def test_the_iteration_limit_holds():
    nlp, z = on_a_rail()
    result = solved(nlp, z, max_iterations=1)
    assert result.status is Status.ITERATION_LIMIT
    assert 0 < len(result.history) <= 40
    numbers = [record.iteration for record in result.history]
    assert numbers == list(range(len(numbers)))


def test_interruption_keeps_the_last_iterate():
    nlp, z = on_a_rail()

    def interrupt(record):
        if record.iteration == 3:
            raise KeyboardInterrupt

    kept = []

    def keep(program, iterate):
        kept.append(iterate)

    with pytest.raises(KeyboardInterrupt):
        solved(nlp, z, interrupt, keep)
    assert len(kept) == 5  # the first iterate, and one per iteration
    assert kept[-1].duration < kept[0].duration


@pytest.mark.slow
def test_papers_example_is_slower_than_by_linear_programs():
    """As in the paper: at rest at the goal, but slower than by linear programs."""
    problem = tm.Problem(
        tm.load_robot("planar3r", position_lower=-np.inf, position_upper=np.inf),
        (0.5, 1.7, -1.7),
        tm.PositionGoal("tip", (4, 1, 0)),
    )
    shares = np.full((40, 1), 1.0 / 40)
    transcription = AdjointTranscription(ProblemFunctions.of(problem), shares, 1.5)
    nlp = NonlinearProgram.of(transcription)
    z = nlp.transcription.pack(np.zeros((40, 3)), np.array([1.5]))
    result = solved(nlp, z, feasibility=1e-3)
    assert result.status is Status.CONVERGED
    assert 0.8313 < result.best.duration < 0.983
