"""The multi-start search on a coarse grid: repeated guesses, and starts ended early."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tests.schedules import carried_out, loop_with
from tominpmp.initial_guess.guess import GuessRequest, straight_guess
from tominpmp.planner import descent
from tominpmp.planner.automatic_options import resolve_options
from tominpmp.planner.coarse_search import INTERVALS, CoarseSearch
from tominpmp.planner.descent import descent_work
from tominpmp.planner.plan_state import PlanState
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import Stop
from tominpmp.transcription.curve import nodes_of
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.problem_functions import ProblemFunctions

START, END = (0.5, 1.7, -1.7), (2.0, -1.0, 0.5)


@pytest.fixture(scope="module")
def coarse():
    """A coarse search after one start, and the guess of this start."""
    robot = tm.load_robot("planar3r")
    post = tm.Sphere("post", radius=0.05, position=(-9.0, -9.0, 0.0))
    problem = tm.Problem(robot, START, tm.JointGoal(END), scene=tm.Scene([post]))
    options = resolve_options(problem, tm.Options())
    system = ProblemFunctions.of(problem)
    search = CoarseSearch(system, PlanState(problem, options), torques=False)
    guess = straight_guess(system, problem.goal.configuration)
    assert carried_out(search.state, search.solve_coarse(guess)) is not None
    return search, guess


def test_guess_is_not_tried_twice(coarse):
    search, guess = coarse
    before = search.state.records
    assert before
    carried_out(search.state, search.probes([guess]))
    assert search.state.records is before


def test_repeated_guess_does_not_count_as_a_failed_start(coarse):
    search, guess = coarse
    before = search.state.records
    other = replace(guess, q=guess.q + 1e-9)
    carried_out(search.state, search.probes([guess, other], patience=1))
    assert search.state.records is not before


@pytest.mark.parametrize(("duration", "paths"), [(1.02, 1), (1.49, 1), (1.51, 2)])
def test_two_paths_may_fail_far_above_the_lower_bound(monkeypatch, duration, paths):
    post = tm.Sphere("post", radius=0.05, position=(-9.0, -9.0, 0.0))
    goal = tm.JointGoal(np.full(6, 0.5))
    problem = tm.Problem(tm.load_robot("ur5"), np.zeros(6), goal, scene=[post])
    state = PlanState(problem, resolve_options(problem, tm.Options()))
    search = CoarseSearch(ProblemFunctions.of(problem), state, torques=False)
    bound = SimpleNamespace(T=1.0)
    monkeypatch.setattr(PlanState, "best_duration", duration)
    monkeypatch.setattr(PlanState, "lower_bound", lambda self, problem: bound)
    assert search.patience == paths


def record(search, **changes):
    T = search.known[-1].candidate.trajectory.duration
    values = dict.fromkeys(IterationRecord.__dataclass_fields__, 0)
    values |= {"duration": T, "violation": 0.0, "radius": 1.0, "accepted": True}
    return IterationRecord(**(values | changes))


def loop(search, records):
    """A loop with records, at the latest motion of the search."""
    kept = search.state.fallbacks[0]
    return loop_with(records, program=kept.program, best=None, state=kept.iterate)


def test_start_ends_if_it_will_not_beat_an_earlier_one(monkeypatch):
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, START, tm.PositionGoal("tip", (1.5, 3.0, 0.0)))
    options = resolve_options(problem, tm.Options())
    system, state = ProblemFunctions.of(problem), PlanState(problem, options)
    search = CoarseSearch(system, state, torques=True)
    lines = list(islice(GuessRequest(np.random.default_rng(0)).guesses(system), 2))
    best = carried_out(state, search.solve_coarse(lines[0]))
    carried_out(state, search.solve_coarse(lines[1]))
    monkeypatch.setattr(search, "_is_known", lambda shape: False)

    def stop_reason(before, now):
        durations = [factor * best.duration for factor in (before, now)]
        records = [record(search, duration=duration) for duration in durations]
        return search._drop_early(loop(search, records))

    assert stop_reason(1.3, 1.1) is None  # the duration still decreases fast enough
    assert stop_reason(1.21, 1.2) is Status.STALLED
    assert stop_reason(1.0, 0.99) is None
    assert stop_reason(1.0, 1.0) is Status.STALLED


def test_repair_is_dropped_if_its_violation_stagnates(coarse, monkeypatch):
    """Regression: repairs were continued for 80 iterations, until T was twenty times as
    long, and the other starts had no time left.
    """
    search, guess = coarse
    rules, former = [], search.known[0].candidate

    def caught(*given):
        rules.append(given[-1])
        raise Stop(requested=False)

    monkeypatch.setattr(PlanState, "solve", caught)
    monkeypatch.setattr(descent, "trust_regions", lambda _: (None, lambda loop: None))
    work = descent_work(search.system, search.coarse, guess, search.state)
    with pytest.raises(Stop):
        work.make(search.system, 0, former)
    stays = [record(search, violation=0.02, duration=2.0 + k) for k in range(12)]
    falls = [record(search, violation=0.5 * 0.8**k) for k in range(12)]
    assert rules[0](loop(search, stays[:9])) is None
    assert rules[0](loop(search, stays)) is Status.STALLED
    assert rules[0](loop(search, falls)) is not Status.STALLED


def test_history_has_every_iteration_once():
    rail = make_arm(slide(1.0), effort=40.0, velocity=0.5)
    problem = tm.Problem(rail, [0.0], tm.JointGoal([1.0]))
    solution = tm.plan(problem, effort="quick")
    found = [(r.duration, r.predicted, r.actual) for r in solution.history]
    assert len(set(found)) == len(found) > 0


def test_fine_grid_does_not_smooth_motions_limited_by_torques():
    robot = tm.load_robot("planar3r")
    post = tm.Sphere("post", radius=0.05, position=(-9.0, -9.0, 0.0))
    problem = tm.Problem(robot, START, tm.JointGoal(END), scene=tm.Scene([post]))
    system = ProblemFunctions.of(problem)
    for torques, changes, smoothing in (
        (True, {}, 0.0),
        (False, {}, None),
        (True, {"smoothing": 0.01}, 0.01),
    ):
        options = resolve_options(problem, tm.Options(**changes))
        state = PlanState(problem, options)
        search = CoarseSearch(system, state, torques=torques)
        assert search.fine.smoothing == smoothing
        assert search.coarse.smoothing == options.smoothing


def test_motions_on_the_coarse_grid_are_motions_on_the_default_grid():
    """Regression: nodes at both ends were elsewhere, and motions of a Fetch broke
    its torques by 42 % where they were finished.
    """
    counts = INTERVALS, tm.Options().intervals
    coarse, fine = (nodes_of(interval_shares("cosine", n)[:, 0]) for n in counts)
    assert np.abs(coarse[:, None] - fine).min(axis=1).max() < 1e-14
