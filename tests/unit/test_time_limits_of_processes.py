"""Several processes keep a time limit as one does, and what they found is kept."""

from __future__ import annotations

import time

import numpy as np
import pytest
from parallel_work import square, wait_and_tell

import tominpmp as tm
from tominpmp.initial_guess.guess import initial_guesses
from tominpmp.initial_guess.parallel import ready, run_parallel
from tominpmp.planner.attempt import Attempt
from tominpmp.planner.multistart import _SourceOfMany
from tominpmp.planner.progress import Progress
from tominpmp.stopping import Deadline, Stop
from tominpmp.transcription.problem_functions import ProblemFunctions


def deadline_of(seconds: float, end: float) -> Deadline:
    deadline = Deadline()
    deadline.end = time.perf_counter() + seconds
    deadline.last = time.perf_counter() + end
    return deadline


def test_processes_that_do_not_end_are_not_waited_for_beyond_the_end() -> None:
    list(run_parallel(square, range(3), 2))  # to start processes takes its time
    assert ready()
    deadline = deadline_of(0.5, 1.0)
    begin = time.perf_counter()
    with deadline.in_force(), pytest.raises(Stop):
        list(run_parallel(wait_and_tell, [60.0, 60.0], 2))
    assert time.perf_counter() - begin < 3.0
    assert not ready(), "they were ended, and have to be started anew"
    assert dict(run_parallel(square, range(3), 2)) == {0: 0, 1: 1, 2: 4}


def test_results_by_the_end_are_kept() -> None:
    list(run_parallel(square, range(3), 2))
    deadline = deadline_of(0.3, 20.0)
    found = []
    with deadline.in_force(), pytest.raises(Stop):
        for number, _ in run_parallel(wait_and_tell, [1.0, 1.0], 2):
            found.append(number)
    assert sorted(found) == [0, 1]


def reach() -> tm.Problem:
    robot = tm.load_robot("planar3r")
    ball = tm.Sphere("ball", radius=0.8, position=(4.0, 0.0, 0.0))
    goal = tm.PositionGoal("tip", (4.0, 1.0, 0.0))
    return tm.Problem(robot, (0.5, 1.7, -1.7), goal, scene=tm.Scene([ball]))


def test_a_plan_in_two_processes_ends_in_time() -> None:
    limit = 6.0
    # Far more starts than there is time for, each with a grid that takes long.
    options = tm.Options(processes=2, starts=200, intervals=160, tolerance=1e-9)
    begin = time.perf_counter()
    solution = tm.plan(reach(), options, max_planning_time=limit)
    spent = time.perf_counter() - begin
    assert solution.status is tm.Status.TIME_LIMIT
    assert spent < 1.1 * limit + 0.2 + 1.5  # processes may have to wait for a core


def ended_by_request() -> Attempt:
    """What a process hands over that was asked to stop."""
    goal = tm.JointGoal((0.6, 1.7, -1.7))
    problem = tm.Problem(tm.load_robot("planar3r"), (0.5, 1.7, -1.7), goal)
    motion = tm.plan(problem, effort="quick", refine=None).trajectory
    asked = tm.Status.INTERRUPTED
    return Attempt("a start", asked, True, motion, motion, violations={}, history=())


@pytest.mark.parametrize("asked", [False, True])
def test_processes_that_were_asked_at_the_end_of_the_time_were_not_interrupted(
    asked: bool,
) -> None:
    options = tm.Options(processes=2)
    progress = Progress(options)
    system = ProblemFunctions.of(reach())
    guess = next(initial_guesses(system, 1, np.random.default_rng(0)))
    source = _SourceOfMany(system, options, progress, iter(()))
    source.results = {0: (ended_by_request(), []), 1: (ended_by_request(), [])}
    progress.deadline.requested = asked
    with progress.deadline.grace(float("inf")):
        first = source.solve(0, guess)
        others = source.left()
    expected = tm.Status.INTERRUPTED if asked else tm.Status.TIME_LIMIT
    assert first is not None
    assert [attempt.status for attempt in (first, *others)] == [expected] * 2


def test_processes_are_not_started_where_there_is_no_time_for_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def started(*_: object) -> None:
        raise AssertionError("processes were started")

    monkeypatch.setattr("tominpmp.planner.multistart.ready", lambda: False)
    monkeypatch.setattr("tominpmp.planner.multistart.run_parallel", started)
    solution = tm.plan(reach(), processes=2, starts=2, max_planning_time=4.9)
    assert solution.success
