"""Planning that ends early: a slowed initial guess or a coarse motion is returned."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import tominpmp as tm
from examples import ur5_post
from tests.sample_arms import make_arm, slide
from tests.schedules import carried_out
from tominpmp.initial_guess.guess import Guess, GuessRequest
from tominpmp.initial_guess.segments import segmented_guesses
from tominpmp.planner.candidate import Candidate, KeptIterate
from tominpmp.planner.coarse_search import CoarseSearch
from tominpmp.planner.descent import descent_work
from tominpmp.planner.first_program import first_program
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.planning import _finish
from tominpmp.planner.work import (
    _keep_fallback,
    _slower_motions,
    make_and_repair,
    use_fallback,
)
from tominpmp.solvers.exchange import restored
from tominpmp.solvers.iterate import Iterate
from tominpmp.stopping import Deadline, Stop
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.verification.limit_violations import LimitViolation

# The choices of "auto".
RESOLVED = {"method": "inverse", "lp_solver": "piqp"}


def planar():
    robot = tm.load_robot("planar3r")
    return tm.Problem(robot, (0.5, 1.7, -1.7), tm.JointGoal((0.5, 1.0, 1.0)))


def test_plan_interrupted_at_once_returns_a_verified_motion():
    solution = tm.plan(planar(), callback=lambda record: True)
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success
    assert solution.verification.ok
    assert solution.T > tm.plan(planar()).T


@pytest.mark.parametrize("intervals", [16, 40, 160])
def test_slowed_timed_guess_is_feasible(intervals):
    """Regression: short intervals at both ends needed thirty times the torque limit."""
    system = ProblemFunctions.of(planar())
    guess = next(GuessRequest(np.random.default_rng(0)).guesses(system))
    assert guess.timed
    options = tm.Options(method="inverse", intervals=intervals, control="constant")
    program, z = first_program(system, options, guess)
    assert program.rows.largest_violation(program.evaluate(z)) < 1.0
    slow = program.evaluate(program.time_scale(z, 2.0))
    assert program.rows.largest_violation(slow) == 0.0


def test_guess_is_interpolated_smoothly_within_its_samples():
    t = np.linspace(0.0, 1.0, 21)
    guess = Guess("parabola", t, t[:, None] ** 2, True)
    fine = np.linspace(0.0, 1.0, 501)
    np.testing.assert_allclose(guess.position(fine)[:, 0], fine**2, atol=1e-3)
    slope = np.diff(guess.position(fine)[:, 0]) / np.diff(fine)
    assert slope[0] < 0.01
    # The interpolation stays within the samples; samples at one time are merged.
    steps = Guess("step", np.array([0, 1, 1, 2.0]), np.array([[0, 1, 1, 1.0]]).T, True)
    assert np.all(np.diff(steps.position(2.0 * fine)[:, 0]) >= 0.0)
    assert steps.position(np.array([-1.0, 5.0]))[:, 0].tolist() == [0.0, 1.0]


def test_plan_stopped_in_its_second_iteration_returns_a_motion():
    """Regression: plans of many joints had no motion in time, as programs take long."""
    arm = make_arm(*[slide(1.0) for _ in range(12)], effort=10.0, velocity=5.0)
    goal = tm.JointGoal(np.linspace(0.05, 0.1, 12))
    problem = tm.Problem(arm, np.zeros(12), goal)
    calls = []

    def late(record):
        calls.append(record)
        return len(calls) > 1

    solution = tm.plan(problem, callback=late)
    assert solution.success


def test_a_plan_that_is_stopped_later_has_no_worse_motion():
    """Regression: a UR5 had a motion beside a post after three iterations, none after
    four: only the newest one was slowed down, which lacked 3e-6 of a clearance.
    """
    problem, durations = ur5_post.problem(), []
    for most in range(2, 6):
        seen = []

        def stops(record, seen=seen, most=most):
            seen.append(record)
            return len(seen) == most

        solution = tm.plan(problem, callback=stops)
        assert solution.success
        durations.append(solution.T)
    assert durations == sorted(durations, reverse=True)


@pytest.mark.parametrize(("method", "most"), [("adjoint", 8), ("collocation", 7)])
def test_feasible_iterate_of_states_or_torques_is_returned_as_it_is(method, most):
    """Regression: time scaling by a factor of 1 changed it, as it recomputes torques:
    each motion by collocation or shooting was lost once its plan was stopped.
    """
    seen = []

    def stops(record):
        seen.append(record)
        return len(seen) == most

    ball = tm.Sphere("ball", radius=0.4, position=(3.0, 1.0, 0.0))
    problem = replace(planar(), goal=tm.JointGoal((2.0, -1.0, 0.5)))
    problem = replace(problem, scene=tm.Scene([ball]))
    solution = tm.plan(problem, method=method, callback=stops)
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success and solution.T == pytest.approx(seen[-1].duration, rel=1e-3)


@pytest.mark.parametrize("most", [2, 4])
@pytest.mark.parametrize("method", ["inverse", "collocation", "adjoint"])
def test_stopped_plan_with_a_goal_of_a_frame_has_a_motion(method, most):
    """Regression: each step misses such a goal by its error of linearisation, and the
    motions of all plans that were stopped before they had settled were lost.
    """
    problem = replace(planar(), goal=tm.PositionGoal("tip", (1.5, 1.0, 0.0)))
    seen = []

    def stops(record):
        seen.append(record)
        return len(seen) == most

    solution = tm.plan(problem, method=method, callback=stops)
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success and solution.T < 1.1 * tm.plan(problem, method=method).T


def test_stopped_plan_returns_a_motion_near_its_last_iterate():
    """Regression: an iterate that exceeded torque limits by 5 % was given up for the
    first guess, which took half as long again.
    """
    problem, seen = replace(planar(), goal=tm.JointGoal((2.0, -1.0, 0.5))), []

    def stops(record):
        seen.append(record)
        return len(seen) == 2

    solution = tm.plan(problem, callback=stops)
    assert solution.success and solution.T < 1.15 * seen[-1].duration


def missing_its_goal(factor: float) -> tuple[NonlinearProgram, Iterate]:
    """An iterate that ends 4 cm from its goal, slower than a guess by a factor."""

    def functions(*position):
        goal = tm.PositionGoal("tip", position)
        return ProblemFunctions.of(replace(planar(), goal=goal))

    request = GuessRequest(np.random.default_rng(0))
    guess = next(request.guesses(functions(1.5, 1.0, 0.0)))
    system = functions(1.48, 1.03, 0.0)
    program, z = first_program(system, tm.Options(**RESOLVED), guess)
    return program, Iterate.of(program, program.time_scale(z, factor), 1.0)


@pytest.mark.parametrize("factor", [1.5, 2.0])
def test_restored_iterate_keeps_all_rows(factor):
    program, near = missing_its_goal(factor)
    program, feasible = restored(program, near)
    assert near.violation > 1e-2
    assert feasible.violation <= 1e-9
    assert np.array_equal(feasible.values, program.evaluate(feasible.z))
    # The way is no longer than one that turns the joints by a few degrees.
    assert np.max(np.abs(feasible.z - near.z)) < 0.1
    fixed = np.equal(*program.step_bounds(near.z, 1.0))
    assert np.array_equal(feasible.z[fixed], near.z[fixed])


def test_rows_that_are_missing_join_a_restored_motion():
    """Regression: of 21 problems of a Fetch stopped after two iterations, 8 had a
    motion, as others touched between the rows of their programs.
    """
    ball = tm.Sphere("ball", radius=0.05, position=(0.8, 2.6, 0.0))
    problem = replace(planar(), goal=tm.JointGoal((2.0, -1.0, 0.5)))
    system = ProblemFunctions.of(replace(problem, scene=tm.Scene([ball])))
    guess = next(GuessRequest(np.random.default_rng(0)).guesses(system))
    program, z = first_program(system, tm.Options(**RESOLVED), guess)
    slow = Iterate.of(program, program.time_scale(z, 3.0), 1.0)
    more, feasible = restored(program, slow)
    assert slow.violation > 1e-3 and more.rows.size > program.rows.size
    assert feasible.violation <= 1e-9
    assert np.array_equal(feasible.values, more.evaluate(feasible.z))


def test_feasible_iterate_is_not_restored():
    program, near = missing_its_goal(2.0)
    program, feasible = restored(program, near)
    assert feasible.violation <= 1e-9
    assert restored(program, feasible) == (program, feasible)


def with_coarse_fallback() -> PlanState:
    """A plan whose only motion is on a coarse grid, without a replay."""
    problem = planar()
    system, options = ProblemFunctions.of(problem), tm.Options(**RESOLVED)
    guess = next(GuessRequest(np.random.default_rng(0)).guesses(system))
    state = PlanState(problem, options)
    search = CoarseSearch(system, state, torques=True)
    assert carried_out(state, search.solve_coarse(guess)) is not None
    return state


def test_coarse_motion_without_a_replay_is_not_confirmed(monkeypatch):
    """Regression: time ended before the replay, and the status was a success."""
    state = with_coarse_fallback()

    def stopped(*_, **__):
        raise Stop(requested=False)

    monkeypatch.setattr(Candidate, "verified", stopped)
    use_fallback(state, tm.Status.TIME_LIMIT)
    assert state.candidates and not state.candidates[-1].confirmed


def test_fallback_that_violates_constraints_is_infeasible(monkeypatch):
    """Regression: its status was that of a motion that satisfies all constraints."""
    state = with_coarse_fallback()
    monkeypatch.setattr(Candidate, "verified", lambda self, *_: self)
    use_fallback(state, tm.Status.FEASIBLE)
    assert state.candidates[-1].status is tm.Status.INFEASIBLE


def test_fallback_in_self_collision_is_replayed_once(monkeypatch):
    """Regression: the motion was replayed at four lower speeds, too.

    This was after the end of the planning time.
    """
    state, known, replays = with_coarse_fallback(), Candidate.verified, []
    touch = LimitViolation("clearance", "a and b", 0.1, 0.01, "m", 0.01, True)

    def touching(*given):
        replays.append(known(*given))
        found = replace(replays[-1].verification, ok=False, violations=(touch,))
        return replace(replays[-1], verification=found)

    monkeypatch.setattr(Candidate, "verified", touching)
    use_fallback(state, tm.Status.TIME_LIMIT)
    assert len(replays) == len(state.fallbacks) == 2  # the first guess is the other one


def test_next_fallback_is_tried_after_one_that_fails_its_replay(monkeypatch):
    """Regression: only one fallback was tried.

    A plan of 0.6 s returned a motion, and a plan of 1 s did not.
    """
    state, known, replays = with_coarse_fallback(), Candidate.verified, []
    state.fallbacks = state.fallbacks[:1] * 2
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


def test_feasible_fallback_is_tried_before_the_first_guess(monkeypatch):
    """Regression: a plan stopped in a start that lacked clearance lost its motion.

    That start was the first fallback, as the fastest one, but could not be slowed down
    until it kept its clearances; the first guess, slowed down, was the solution, and
    took half as long again as the feasible motion of a former start.
    """
    state = with_coarse_fallback()
    near, tried = state.fallbacks[0]._replace(feasible=False, initial=None), []
    z = near.program.time_scale(near.iterate.z, 1.5)
    sound = near._replace(iterate=near.iterate.on(near.program, z), feasible=True)
    state.fallbacks, state.kept_iterates = [sound], [near]
    _keep_fallback(state, refuted=False)

    def failing(_, fallback, candidate):
        tried.append(fallback)
        return [candidate]

    monkeypatch.setattr("tominpmp.planner.work._slower_motions", failing)
    use_fallback(state, tm.Status.TIME_LIMIT)
    assert list(map(id, tried)) == list(map(id, (sound, near)))


def test_path_is_tried_before_a_slower_guess(monkeypatch):
    """Regression: beside a shelf a guess was slowed down to 2.21 s, where a path took
    1.88 s; under a table its replays left no time for the path.
    """
    state, tried = with_coarse_fallback(), []
    guess = state.fallbacks[-1]._replace(feasible=False, initial=None)
    z = guess.program.time_scale(guess.iterate.z, 1.2)
    slow = guess._replace(iterate=guess.iterate.on(guess.program, z))
    state.fallbacks, state.paths = [slow], {0: lambda: guess}

    def failing(_, fallback, candidate):
        tried.append(fallback)
        return [replace(candidate, feasible=False)]

    monkeypatch.setattr("tominpmp.planner.work._slower_motions", failing)
    use_fallback(state, tm.Status.TIME_LIMIT)
    assert list(map(id, tried)) == list(map(id, (guess, slow)))


def test_stopped_plan_tells_of_the_replay_that_failed(monkeypatch):
    """Regression: the message said that there had been no time for a replay, although
    the motions that were slowed down less had failed theirs.
    """
    known, seen, replays = Candidate.verified, [], []

    def refuted_once(candidate, *given):
        if replays:
            raise Stop(requested=True)
        replays.append(known(candidate, *given))
        slow = LimitViolation("duration", "the motion", 0.0, 1.0, "s", 0.1, True)
        broken = replace(replays[0].verification, ok=False, violations=(slow,))
        return replace(replays[0], verification=broken)

    def stops(record):
        seen.append(record)
        return len(seen) == 6

    monkeypatch.setattr(Candidate, "verified", refuted_once)
    solution = tm.plan(planar(), intervals=20, callback=stops)
    assert len(replays) == 1
    assert solution.verification.violations[0].kind == "duration"
    assert "no time" not in solution.message


def test_each_motion_of_a_stopped_plan_is_replayed_once(monkeypatch):
    """Regression: those that had failed their replay were replayed once more, which
    left no time for the others.
    """
    known, seen, replays = Candidate.verified, [], []

    def failing(candidate, *given):
        found = known(candidate, *given)
        replays.append(found.trajectory.duration)
        touch = LimitViolation("clearance", "a and b", 0.1, 0.01, "m", 0.01, True)
        broken = replace(found.verification, ok=False, violations=(touch,))
        return replace(found, verification=broken)

    def stops(record):
        seen.append(record)
        return len(seen) == 6

    monkeypatch.setattr(Candidate, "verified", failing)
    assert not tm.plan(planar(), callback=stops).success
    assert replays and len(replays) == len(set(replays))


def test_first_motion_of_a_stopped_plan_is_slowed_down():
    """Regression: after one iteration beside a post, torques 1.5 % beyond their limits,
    a UR5 had no motion; with objective "feasible" an arm took five times as long.
    """
    solution = tm.plan(ur5_post.problem(), callback=lambda record: True)
    assert solution.success
    goal = tm.JointGoal((0.9, -1.2, -0.9))
    problem, seen = replace(planar(), goal=goal), []

    def third(record):
        seen.append(record)
        return len(seen) == 3

    solution = tm.plan(problem, objective="feasible", callback=third)
    assert solution.status is tm.Status.INTERRUPTED and solution.success
    assert solution.T < 1.5


def test_faster_coarse_motion_replaces_a_slow_incumbent():
    """Regression: planning for 4 s returned T = 3.75 s, planning for 2 s T = 0.39 s."""
    state = with_coarse_fallback()
    (coarse, _), options = state.fallbacks, state.options
    program, iterate = coarse.program, coarse.iterate
    slower = replace(iterate, z=program.time_scale(iterate.z, 5.0))
    kept = KeptIterate(program, slower, True)
    slow = kept.candidate(tm.Status.TIME_LIMIT).verified(state.problem, options)
    state.candidates.append(slow)
    assert state.incumbent is slow
    solution = _finish(state, tm.Status.TIME_LIMIT)
    assert solution.success and solution.status is tm.Status.TIME_LIMIT
    assert solution.T < 1.3 * iterate.duration < slow.duration


def test_fallback_as_slow_as_the_incumbent_is_not_tried_after_a_dwell(monkeypatch):
    """Regression: the duration of the fallback was compared without its dwells."""
    goals = tm.JointGoal((0.5, 1.4, -1.0)), tm.JointGoal((0.5, 1.0, 1.0))
    segments = tm.Segment(goals[0], dwell=1.0), tm.Segment(goals[1])
    start = planar()
    problem = tm.Problem(start.robot, start.q_start, segments=segments)
    system, options = ProblemFunctions.of(problem), tm.Options(**RESOLVED)
    request = GuessRequest(np.random.default_rng(0))
    guess = next(segmented_guesses(system, request))
    program, z = first_program(system, options, guess)
    iterate = Iterate.of(program, z, 1.0)
    kept = KeptIterate(program, iterate, True)
    state = PlanState(problem, options)
    replayed = kept.candidate(tm.Status.TIME_LIMIT).verified(problem, options)
    confirmed = replace(replayed.verification, ok=True, violations=())
    incumbent = replace(replayed, verification=confirmed)
    state.candidates.append(incumbent)
    assert state.incumbent is incumbent
    state.fallbacks, tried = [kept], []

    def scaled(_, fallback, candidate):
        tried.append(fallback)
        return [candidate]

    monkeypatch.setattr("tominpmp.planner.work._slower_motions", scaled)
    use_fallback(state, tm.Status.TIME_LIMIT)
    assert not tried


def test_slowed_guess_is_returned_if_all_starts_fail():
    """Regression: planning for 60 s returned no motion, as all starts had ended.

    Planning for 2 s had returned a motion.
    """
    arm = tm.load_robot("planar3r")
    goal = tm.JointGoal([1.2, 0.5, 0.6])
    problem = tm.Problem(arm, [0.5, 0.1, 0.1], goal)
    solution = tm.plan(problem, max_iterations=1, intervals=10)
    assert solution.success and solution.verification.ok
    assert solution.status is not tm.Status.CONVERGED


@pytest.mark.parametrize("several", [False, True])
def test_path_around_obstacles_is_followed_if_its_descent_is_cut_short(
    several, monkeypatch
):
    """Regression: a path was known, but no motion was returned: of 14 plans for a Fetch
    among shelves four ended like this after 5 s.
    """
    scene = tm.Scene([tm.Sphere("ball", radius=0.8, position=(3.2, 3.2, 0.0))])
    robot, start, end = tm.load_robot("planar3r"), (0.5, 1.7, -1.7), (0.9, -1.2, -0.9)
    there, back = tm.JointGoal(end), tm.JointGoal(start)
    goals = {"segments": [tm.Segment(there), tm.Segment(back)]}
    goals = goals if several else {"goal": there}
    problem = tm.Problem(robot, start, scene=scene, **goals)

    def stops(*_arguments, **_keywords):
        raise Stop(requested=False)

    monkeypatch.setattr(PlanState, "solve", stops)
    solution = tm.plan(problem)
    assert solution.success and solution.verification.ok
    assert solution.status is tm.Status.TIME_LIMIT


@pytest.mark.parametrize("error", [MemoryError, np.linalg.LinAlgError])
def test_path_that_cannot_be_followed_does_not_end_the_plan(error, monkeypatch):
    """Regression: the error was raised in place of a solution."""

    def fails(*_arguments):
        raise error

    state = PlanState(planar(), tm.Options(**RESOLVED))
    state.paths[0] = fails
    use_fallback(state, tm.Status.TIME_LIMIT)
    assert not state.candidates


def test_guess_is_slowed_until_it_keeps_a_time_window(ur5: tm.Robot) -> None:
    """Regression: at full speed it broke the window, and was given up."""
    stays = tm.WithinRegion("tool0", [-2.0] * 3, [2.0, 0.0, 2.0], during=(0.0, 2.0))
    start = np.array([-1.0, -1.2, 1.8, -0.6, 1.5, 0.0])
    goal = tm.JointGoal([1.0, *start[1:]])
    problem = tm.Problem(ur5, start, goal, constraints=[stays])
    solution = tm.plan(problem, callback=lambda record: True)
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success and solution.verification.ok


def test_guess_is_not_slowed_after_the_end_of_the_planning_time():
    """Regression: twelve slower motions were tried after the end, in 0.06 s."""
    problem = planar()
    system, options = ProblemFunctions.of(problem), tm.Options(**RESOLVED)
    guess = next(GuessRequest(np.random.default_rng(0)).guesses(system))
    program, z = first_program(system, options, guess)
    iterate = Iterate.of(program, z, 1.0)
    begun = KeptIterate(program, iterate, False)
    candidate = begun.candidate(tm.Status.TIME_LIMIT)
    late = Deadline()
    late.end = 0.0
    with late.in_force(), pytest.raises(Stop):
        next(_slower_motions(PlanState(problem, options), begun, candidate))


def test_planning_time_is_reserved_for_the_first_replay():
    """Regression: a motion of several segments was found without time for its replay.

    The replay of several segments takes 0.2 s.
    """
    problem = planar()
    system, options = ProblemFunctions.of(problem), tm.Options(**RESOLVED)
    guess = next(GuessRequest(np.random.default_rng(0)).guesses(system))
    program, z = first_program(system, options, guess)
    slow = Iterate.of(program, program.time_scale(z, 3.0), 1.0)
    state = PlanState(problem, options.changed({"max_planning_time": 2.0}))
    for seconds, reserve in ((0.0, 0.225), (0.01, 0.015), (0.1, 0.15), (9.0, 0.5)):
        state.replayed(seconds)
        state.keep(program, slow)
        assert state.kept_iterates[-1].feasible
        before = state.deadline.last - state.deadline.end
        assert before == pytest.approx(0.06 * 2.0 + 0.07 + reserve)


def test_feasible_iterates_outlive_later_ones_and_equal_ones_are_kept_once():
    """Regression: three segments had a motion after 0.39 s, and none after 0.41 s."""
    problem = planar()
    system, options = ProblemFunctions.of(problem), tm.Options(**RESOLVED)
    guess = next(GuessRequest(np.random.default_rng(0)).guesses(system))
    program, z = first_program(system, options, guess)
    state = PlanState(problem, options)
    paces = (0.5, 3.0, 0.6, 0.7, 0.8, 0.85, 0.9)
    iterates = [Iterate.of(program, program.time_scale(z, pace), 1.0) for pace in paces]
    for iterate in iterates:
        state.keep(program, iterate)
        state.keep(program, replace(iterate, radius=0.5))  # of a rejected step
    kept = [item.iterate.z for item in state.kept_iterates]
    assert kept[-1] is iterates[-1].z
    assert [item.feasible for item in state.kept_iterates].count(True) == 1
    assert len(kept) == len({id(unknowns) for unknowns in kept}) == 5


def test_slow_iterations_increase_the_reserve_for_the_first_replay(clock):
    """Regression: an xArm 7 with five segments had a motion after 2 s of 8 s.

    Its replay takes 1 s.
    """
    state = PlanState(planar(), tm.Options(**RESOLVED, max_planning_time=10.0))
    state.begin()
    # A first guess, which may have to be slowed down.
    state.kept_iterates = [SimpleNamespace(feasible=False)]
    record = tm.IterationRecord(0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0, True, 1, 1, 0.0, 0.0)
    for _ in range(40):
        clock.advance(0.2)
        assert state(record) is None
    clock.advance(0.6)  # the first replay may take a second, and half as much again
    with pytest.raises(Stop):
        state(record)


def test_replay_may_use_the_time_reserved_for_it(monkeypatch):
    """Regression: the replay was stopped by its own reserve, and done once more."""
    problem = planar()
    state = PlanState(problem, tm.Options(**RESOLVED, max_planning_time=2.0))
    ends, known = [], Candidate.verified

    def verified(*given):
        ends.append(state.deadline.end == state.deadline.last)
        return known(*given)

    monkeypatch.setattr(Candidate, "verified", verified)
    system = ProblemFunctions.of(problem)
    guess = next(GuessRequest(np.random.default_rng(0)).guesses(system))
    work = descent_work(system, state.options, guess, state)
    assert make_and_repair(state, work).confirmed
    assert ends and all(ends)


@pytest.mark.parametrize("free", [True, False])
def test_repair_of_a_self_collision_starts_from_the_guess(monkeypatch, free):
    """The repair starts from the guess only if the final configuration is free.

    Regression: a PR2 took 0.85 s beside its other arm, into which the free final
    configuration had drifted.
    """
    given, problem = [], planar()
    if free:
        goal = tm.PositionGoal("tip", (1.0, 4.0, 0.0))
        problem = tm.Problem(problem.robot, problem.q_start, goal)
    state = PlanState(problem, tm.Options(**RESOLVED))
    system = ProblemFunctions.of(problem)
    guess = next(GuessRequest(np.random.default_rng(0)).guesses(system))
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
