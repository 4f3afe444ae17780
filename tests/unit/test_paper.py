"""The iteration of the paper: steps of fixed size, which are all accepted."""

from __future__ import annotations

import numpy as np
import pytest
from sample_arms import make_arm, slide

import tominpmp as tm
from tominpmp.solvers.fixed_step import fixed_steps
from tominpmp.solvers.loop import solve
from tominpmp.solvers.objective import MinimumTime
from tominpmp.status import Status
from tominpmp.transcription.adjoint import AdjointTranscription
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

INTERVALS = 10
LEAST = 2.0 * np.sqrt(1.0 / 2.0)  # one metre at 2 m/s^2, from rest to rest


def on_a_rail(velocity=1e3):
    robot = make_arm(slide(2.0), effort=4.0, velocity=velocity)
    problem = tm.Problem(robot, [0.0], tm.JointGoal([1.0]))
    shares = np.full((INTERVALS, 1), 1.0 / INTERVALS)
    transcription = AdjointTranscription(ProblemFunctions.of(problem), shares, 1.0)
    nlp = NonlinearProgram.of(transcription, "exact")
    # No torque: the goal is missed by a metre.
    return nlp, nlp.transcription.pack(np.zeros((INTERVALS, 1)), np.array([1.0]))


def solved(nlp, z, callback=None, keep=None, **options):
    defaults = {"max_iterations": 400, "control_step": 0.2, "time_step": 0.02}
    options = tm.Options(**{**defaults, "lp_solver": "highs", **options})
    least, method = MinimumTime.of(options), fixed_steps(options)
    return solve(nlp, least, z, *method, callback=callback, keep=keep)


def test_fixed_steps_converge_to_the_minimum_time():
    nlp, z = on_a_rail()
    result = solved(nlp, z)
    assert result.status is Status.CONVERGED
    assert result.best.duration == pytest.approx(LEAST, rel=1e-5)
    assert result.best.violation <= 1e-6
    assert len(result.history) < 200


def test_fixed_steps_oscillate_at_a_speed_limit():
    """At the limit it does not matter which interval brakes: no step is the last."""
    nlp, z = on_a_rail(velocity=0.8)
    least = 1.0 / 0.8 + 0.8 / 2.0
    result = solved(nlp, z, max_iterations=80)
    assert result.status is Status.ITERATION_LIMIT
    last = result.history[-20:]
    assert max(record.violation for record in last) < 0.1
    assert all(0.9 * least < record.duration < least for record in last)
    before, after = solved(nlp, z, max_iterations=79).iterate.z, result.iterate.z
    moved = np.abs(
        nlp.transcription.torques(after) - nlp.transcription.torques(before)
    ).max()
    assert moved == pytest.approx(0.2)


def test_steps_have_a_fixed_size_and_are_all_accepted():
    nlp, z = on_a_rail()
    missed = nlp.rows.largest_violation(nlp.evaluate(z))
    torque, duration = nlp.transcription.torques(z), nlp.cost @ z
    # The violation is driven down first, whatever becomes of the duration.
    records = solved(nlp, z, max_iterations=30).history
    assert all(record.accepted for record in records)
    assert records[5].violation < missed
    for count in (1, 2, 3):
        one = solved(nlp, z, max_iterations=count).iterate
        now = nlp.transcription.torques(one.z)
        assert np.abs(now - torque).max() == pytest.approx(0.2)
        assert abs(one.duration - duration) <= 0.02 + 1e-12
        torque, duration = now, one.duration


def test_best_iterate_is_the_fastest_feasible_iterate():
    nlp, z = on_a_rail()
    result = solved(nlp, z, max_iterations=5)
    assert result.status is Status.ITERATION_LIMIT
    assert result.best is None
    assert result.iterate.violation > 0.1
    long = solved(nlp, z, max_iterations=60)
    good = [r.duration for r in long.history if r.violation <= 1e-6]
    assert long.best.duration == min(good)


def test_callback_sees_every_iteration():
    nlp, z = on_a_rail()
    seen = []
    result = solved(nlp, z, seen.append, max_iterations=7)
    assert result.status is Status.ITERATION_LIMIT
    assert tuple(seen) == result.history and len(seen) == 7


def test_interruption_keeps_the_last_iterate():
    nlp, z = on_a_rail()

    def interrupt(record):
        if record.iteration == 60:
            raise KeyboardInterrupt

    kept = []

    def keep(program, iterate):
        kept.append(iterate)

    with pytest.raises(KeyboardInterrupt):
        solved(nlp, z, interrupt, keep)
    assert kept[-1].violation <= 1e-6
    # The first iterate, and one per iteration; the best one is handed over repeatedly.
    assert len(set(map(id, kept))) == 62


@pytest.mark.parametrize("obstacle", [False, True])
def test_papers_example_reaches_the_times_of_the_paper(obstacle):
    """Fewer intervals and longer steps than in the paper, from the paper's start.

    The violation at the end grows with the length of the steps, about as its square.
    """
    changes = {} if obstacle else {"position_lower": -np.inf, "position_upper": np.inf}
    scene = tm.Scene()
    if obstacle:
        scene = tm.Scene([tm.Sphere("O", radius=0.8, position=(4, 0, 0))])
    problem = tm.Problem(
        tm.load_robot("planar3r", **changes),
        (0.5, 1.7, -1.7),
        tm.PositionGoal("tip", (4, 1, 0)),
        scene=scene,
    )
    shares = np.full((25, 1), 1.0 / 25)
    transcription = AdjointTranscription(ProblemFunctions.of(problem), shares, 1.5)
    nlp = NonlinearProgram.of(transcription, "exact")
    z = nlp.transcription.pack(np.zeros((25, 3)), np.array([1.5]))
    result = solved(nlp, z, max_iterations=160, feasibility=5e-3)
    assert result.history[0].violation > 1.0
    assert result.best is not None
    # The times of the paper, which the duration passes as it falls.
    assert result.best.duration < (1.207 if obstacle else 0.884)
