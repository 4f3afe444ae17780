"""Planning that ends early: what it began with, slowed down, is a motion already."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tests.schedules import carried_out
from tominpmp.initial_guess.guess import Guess, GuessRequest, initial_guesses
from tominpmp.planner.candidate import Candidate, Fallback, KeptIterate, as_candidate
from tominpmp.planner.coarse_search import CoarseSearch
from tominpmp.planner.descent import descent_work
from tominpmp.planner.first_program import first_program
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.planning import _finish
from tominpmp.planner.work import (
    _scaled,
    make_and_repair,
    use_fallback,
)
from tominpmp.solvers.iterate import Iterate
from tominpmp.stopping import Deadline, Stop
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.limit_violations import LimitViolation

# What "auto" comes to.
RESOLVED = {"method": "inverse", "lp_solver": "piqp"}


def planar():
    robot = tm.load_robot("planar3r")
    return tm.Problem(robot, (0.5, 1.7, -1.7), tm.JointGoal((0.5, 1.0, 1.0)))


def test_interrupted_at_once_there_is_a_motion():
    solution = tm.plan(planar(), callback=lambda record: True)
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success
    assert solution.verification.ok
    assert solution.T > tm.plan(planar()).T


@pytest.mark.parametrize("intervals", [16, 40, 160])
def test_timed_guesses_are_nearly_motions(intervals):
    """Short intervals at the ends asked for thirty times the torque there is."""
    system = ProblemFunctions.of(planar())
    guess = next(initial_guesses(system, GuessRequest(1, np.random.default_rng(0))))
    assert guess.timed
    options = tm.Options(method="inverse", intervals=intervals, control="constant")
    program, z = first_program(system, options, guess)
    assert program.rows.largest_violation(program.evaluate(z)) < 1.0
    slow = program.evaluate(program.time_scale(z, 2.0))
    assert program.rows.largest_violation(slow) == 0.0


def test_a_guess_runs_smoothly_between_its_samples():
    t = np.linspace(0.0, 1.0, 21)
    guess = Guess("parabola", t, t[:, None] ** 2, True)
    fine = np.linspace(0.0, 1.0, 501)
    np.testing.assert_allclose(guess.position(fine)[:, 0], fine**2, atol=1e-3)
    slope = np.diff(guess.position(fine)[:, 0]) / np.diff(fine)
    assert slope[0] < 0.01
    # Within the samples, and samples at one time are one.
    steps = Guess("step", np.array([0, 1, 1, 2.0]), np.array([[0, 1, 1, 1.0]]).T, True)
    assert np.all(np.diff(steps.position(2.0 * fine)[:, 0]) >= 0.0)
    assert steps.position(np.array([-1.0, 5.0]))[:, 0].tolist() == [0.0, 1.0]


def test_a_short_time_limit_leaves_a_verified_motion():
    """Arms of many joints found none in time: their programs take long."""
    arm = make_arm(*[slide(1.0) for _ in range(12)], effort=10.0, velocity=5.0)
    goal = tm.JointGoal(np.linspace(0.05, 0.1, 12))
    problem = tm.Problem(arm, np.zeros(12), goal)
    calls = []

    def late(record):
        calls.append(record)
        return len(calls) > 1

    solution = tm.plan(problem, callback=late)
    assert solution.success


def with_coarse_fallback() -> PlanState:
    """A plan whose only motion is on a coarse grid, without a replay."""
    problem = planar()
    system, options = ProblemFunctions.of(problem), tm.Options(**RESOLVED)
    guess = next(initial_guesses(system, GuessRequest(1, np.random.default_rng(0))))
    state = PlanState(problem, options)
    search = CoarseSearch(system, state, torques=True)
    assert carried_out(state, search.solve_coarse(guess)) is not None
    return state


def test_a_coarse_motion_without_a_replay_is_no_success(monkeypatch):
    """Time ended before its replay, and the solution was called a success."""
    state = with_coarse_fallback()

    def stopped(*_, **__):
        raise Stop(requested=False)

    monkeypatch.setattr(Candidate, "verified", stopped)
    use_fallback(state, tm.Status.TIME_LIMIT)
    assert state.candidates and not state.candidates[-1].confirmed


def test_a_fallback_that_does_not_hold_is_infeasible(monkeypatch):
    """Its status said that a motion was found that keeps all constraints."""
    state = with_coarse_fallback()
    monkeypatch.setattr(Candidate, "verified", lambda self, *_: self)
    use_fallback(state, tm.Status.FEASIBLE)
    assert state.candidates[-1].status is tm.Status.INFEASIBLE


def test_a_motion_whose_links_touch_is_replayed_once(monkeypatch):
    """It was replayed at four lower speeds, too, after the end of the planning time."""
    state, known, replays = with_coarse_fallback(), Candidate.verified, []
    touch = LimitViolation("clearance", "a and b", 0.1, 0.01, "m", 0.01, True)

    def touching(*given):
        replays.append(known(*given))
        found = replace(replays[-1].verification, ok=False, violations=(touch,))
        return replace(replays[-1], verification=found)

    monkeypatch.setattr(Candidate, "verified", touching)
    use_fallback(state, tm.Status.TIME_LIMIT)
    assert len(replays) == 1 + len(state.first_guesses)


def test_a_coarse_motion_that_does_not_hold_gives_way_to_the_next_one(monkeypatch):
    """A plan of 0.6 s had a motion, and one of 1 s had none: only one was tried."""
    state, known, replays = with_coarse_fallback(), Candidate.verified, []
    state.fallbacks, state.first_guesses = state.fallbacks * 2, []
    touch = LimitViolation("clearance", "a and b", 0.1, 0.01, "m", 0.01, True)

    def touching_once(*given):
        replays.append(known(*given))
        if len(replays) > 1:
            return replays[-1]
        found = replace(replays[-1].verification, ok=False, violations=(touch,))
        return replace(replays[-1], verification=found)

    monkeypatch.setattr(Candidate, "verified", touching_once)
    use_fallback(state, tm.Status.TIME_LIMIT)
    assert state.incumbent is not None


def test_a_slow_incumbent_does_not_hide_a_faster_coarse_motion():
    """A plan of 4 s returned 3.75 s, and one of 2 s had returned 0.39 s."""
    state = with_coarse_fallback()
    (coarse,), options = state.fallbacks, state.options
    program, iterate, _ = coarse.kept
    slower = replace(iterate, z=program.time_scale(iterate.z, 5.0))
    kept = KeptIterate(program, slower, True)
    slow = as_candidate("slow", kept, kept, tm.Status.TIME_LIMIT)
    slow = slow.verified(state.problem, options)
    state.candidates.append(slow)
    assert state.incumbent is slow
    solution = _finish(state, tm.Status.TIME_LIMIT)
    assert solution.success and solution.status is tm.Status.TIME_LIMIT
    assert solution.T < 1.3 * iterate.duration < slow.duration


def test_starts_that_all_end_without_a_motion_leave_a_guess_slowed_down():
    """An arm had a motion after 2 s, and none after 60 s, when all starts had ended."""
    arm = tm.load_robot("planar3r")
    goal = tm.JointGoal([1.2, 0.5, 0.6])
    problem = tm.Problem(arm, [0.5, 0.1, 0.1], goal)
    solution = tm.plan(problem, max_iterations=1, intervals=10)
    assert solution.success and solution.verification.ok
    assert solution.status is tm.Status.ITERATION_LIMIT


def test_a_guess_is_not_slowed_down_once_time_is_up():
    """Twelve slower motions were tried after the end of a plan, 0.06 s altogether."""
    problem = planar()
    system, options = ProblemFunctions.of(problem), tm.Options(**RESOLVED)
    guess = next(initial_guesses(system, GuessRequest(1, np.random.default_rng(0))))
    program, z = first_program(system, options, guess)
    begun = KeptIterate(program, Iterate.of(program, z, 1.0), False)
    candidate = as_candidate("guess", begun, begun, tm.Status.TIME_LIMIT)
    late = Deadline()
    late.end = 0.0
    with late.in_force(), pytest.raises(Stop):
        _scaled(Fallback("guess", begun, begun, problem), candidate, options)


def test_time_is_reserved_for_a_replay_before_one_was_timed():
    """One of some segments takes 0.2 s: it was found, and there was no time for it."""
    problem = planar()
    system, options = ProblemFunctions.of(problem), tm.Options(**RESOLVED)
    guess = next(initial_guesses(system, GuessRequest(1, np.random.default_rng(0))))
    program, z = first_program(system, options, guess)
    slow = Iterate.of(program, program.time_scale(z, 3.0), 1.0)
    state = PlanState(problem, options.changed({"max_planning_time": 2.0}))
    for seconds, reserve in ((0.0, 0.225), (0.01, 0.06), (0.1, 0.15), (9.0, 0.5)):
        state.replayed(seconds)
        state.keep(program, slow)
        assert state.kept_iterates[-1].feasible
        before = state.deadline.last - state.deadline.end
        assert before == pytest.approx(0.06 * 2.0 + 0.07 + reserve)


def test_slow_iterations_reserve_more_time_for_the_first_replay(clock):
    """An xArm 7 with five segments was ready after 2 s of 8, but a replay takes 1 s."""
    state = PlanState(planar(), tm.Options(**RESOLVED, max_planning_time=10.0))
    state.begin()
    state.initial = object()  # a first guess, which may have to be slowed down
    record = tm.IterationRecord(0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0, True, 1, 1, 0.0, 0.0)
    for _ in range(40):
        clock.advance(0.2)
        assert state(record) is None
    clock.advance(0.6)  # the first replay may take a second, and half as much again
    with pytest.raises(Stop):
        state(record)


def test_a_replay_may_take_the_time_that_is_kept_for_it(monkeypatch):
    """It was cut short by its own reserve, and done once more from its beginning."""
    problem = planar()
    state = PlanState(problem, tm.Options(**RESOLVED, max_planning_time=2.0))
    ends, known = [], Candidate.verified

    def verified(*given):
        ends.append(state.deadline.end == state.deadline.last)
        return known(*given)

    monkeypatch.setattr(Candidate, "verified", verified)
    system = ProblemFunctions.of(problem)
    guess = next(initial_guesses(system, GuessRequest(1, np.random.default_rng(0))))
    assert make_and_repair(
        state, descent_work(system, state.options, guess, state)
    ).confirmed
    assert ends and all(ends)


@pytest.mark.parametrize("free", [True, False])
def test_repairs_of_touching_links_begin_with_the_guess_if_the_end_is_free(
    monkeypatch, free
):
    """A PR2 took 0.85 s beside its other arm, into which the free end had drifted."""
    given, problem = [], planar()
    if free:
        goal = tm.PositionGoal("tip", (1.0, 4.0, 0.0))
        problem = tm.Problem(problem.robot, problem.q_start, goal)
    state = PlanState(problem, tm.Options(**RESOLVED))
    system = ProblemFunctions.of(problem)
    guess = next(initial_guesses(system, GuessRequest(1, np.random.default_rng(0))))
    work = descent_work(system, state.options, guess, state)

    def make(system, doublings, former):
        given.append(former)
        return work.make(system, doublings, former)

    first = property(lambda candidate: len(given) == 1)
    monkeypatch.setattr(Candidate, "touches", first)
    monkeypatch.setattr(Candidate, "refuted", first)
    make_and_repair(state, replace(work, make=make))
    assert len(given) == 2
    assert (given[1] is None) is free
