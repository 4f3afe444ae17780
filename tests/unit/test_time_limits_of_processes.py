"""Several processes keep a time limit as one does, and what they found is kept."""

from __future__ import annotations

import math
import os
import threading
import time
from concurrent import futures
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clocks import Clock
from parallel_work import PATIENCE, begin_and_wait, square, until_asked

import tominpmp as tm
from tominpmp.initial_guess import parallel
from tominpmp.initial_guess.guess import GuessRequest, initial_guesses
from tominpmp.initial_guess.parallel import ready, run_parallel
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.starts import ParallelDescents, _descents, descend_in_process
from tominpmp.planner.work import run
from tominpmp.stopping import Deadline, Stop
from tominpmp.transcription.problem_functions import ProblemFunctions


def test_processes_that_do_not_end_are_not_waited_for_beyond_the_end(
    clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    list(run_parallel(square, range(3), 2))  # to start processes takes its time
    assert ready()
    deadline = Deadline()
    deadline.end, deadline.last = clock.now + 0.5, clock.now + 1.0

    def waited(pending: Any, seconds: float, **how: str) -> tuple[set[Any], set[Any]]:
        if len(list(tmp_path.iterdir())) < 2:
            return futures.wait(pending, seconds, **how)
        clock.advance(seconds)
        return futures.wait(pending, 0.0, **how)

    monkeypatch.setattr(parallel, "wait", waited)
    with deadline.in_force(), pytest.raises(Stop):
        list(run_parallel(begin_and_wait, [tmp_path, tmp_path], 2))
    assert clock.now <= deadline.last + 2.0 * parallel.TICK
    assert not ready(), "they were ended, and have to be started anew"
    monkeypatch.setattr(parallel, "wait", futures.wait)
    assert dict(run_parallel(square, range(3), 2)) == {0: 0, 1: 1, 2: 4}


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.skipif(os.name != "posix", reason="asks for processes by their numbers")
def test_processes_end_though_others_take_their_place_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy machine they went on, and the program waited for them in the end."""
    process_executor = pytest.importorskip("loky.process_executor")
    manager = process_executor._ExecutorManagerThread
    usual, others = manager.flag_executor_shutting_down, threading.Event()

    def late(self: Any) -> None:
        others.wait(PATIENCE)
        usual(self)

    monkeypatch.setattr(manager, "flag_executor_shutting_down", late)
    monkeypatch.setattr(parallel, "LATE", 0.1)
    run = run_parallel(begin_and_wait, [None, tmp_path, tmp_path], 2)
    assert next(run)[0] == 0
    while len(list(tmp_path.iterdir())) < 2:
        time.sleep(0.02)
    run.close()
    assert dict(run_parallel(square, range(3), 2)) == {0: 0, 1: 1, 2: 4}
    others.set()
    end = time.monotonic() + PATIENCE
    pids = [int(path.name) for path in tmp_path.iterdir()]
    while not all(map(gone, pids)) and time.monotonic() < end:
        time.sleep(0.02)
    assert all(map(gone, pids))


def test_results_by_the_end_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parallel, "GRACE", PATIENCE)
    deadline = Deadline()

    def once_both_have_begun() -> None:
        while len(list(tmp_path.iterdir())) < 2:
            time.sleep(0.02)
        deadline.end = -math.inf

    found = []
    watch = threading.Thread(target=once_both_have_begun, daemon=True)
    watch.start()
    with deadline.in_force(), pytest.raises(Stop):
        for result in run_parallel(until_asked, [tmp_path, tmp_path], 2):
            found.append(result)
    watch.join()
    assert sorted(found) == [(0, True), (1, True)]


def reach() -> tm.Problem:
    robot = tm.load_robot("planar3r")
    ball = tm.Sphere("ball", radius=0.8, position=(4.0, 0.0, 0.0))
    goal = tm.PositionGoal("tip", (4.0, 1.0, 0.0))
    return tm.Problem(robot, (0.5, 1.7, -1.7), goal, scene=tm.Scene([ball]))


def test_a_plan_in_two_processes_ends_in_time(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What processes are at when the time is used up, they hand over."""
    limit, starts = 600.0, 200
    usual, handed = ParallelDescents.result, []

    def result(ahead: ParallelDescents, number: int, *_: object) -> Candidate | None:
        attempt = usual(ahead, number)
        clock.advance(0.0 if handed else 1.05 * limit)
        handed.append(number)
        return attempt

    monkeypatch.setattr(ParallelDescents, "result", result)
    options = tm.Options(processes=2, starts=starts, intervals=20, tolerance=1e-9)
    begin = time.monotonic()
    solution = tm.plan(reach(), options, max_planning_time=limit)
    # The next may have come together with the first, more on a busy machine.
    assert 0 < len(handed) < 0.1 * starts
    assert solution.status is tm.Status.TIME_LIMIT
    assert solution.success
    assert time.monotonic() - begin < PATIENCE


def test_a_process_without_time_ends_at_once() -> None:
    system = ProblemFunctions.of(reach())
    guess = next(initial_guesses(system, GuessRequest(1, np.random.default_rng(0))))
    options = tm.Options(method="inverse", lp_solver="piqp", intervals=160)
    result = descend_in_process(system, options, time.time() - 1.0, guess)
    attempt, failures, history = result
    assert not failures
    if attempt is not None:
        assert attempt.status is tm.Status.TIME_LIMIT
        assert len(history) <= 1


def ended_by_request() -> Candidate:
    """What a process hands over that was asked to stop."""
    goal = tm.JointGoal((0.6, 1.7, -1.7))
    problem = tm.Problem(tm.load_robot("planar3r"), (0.5, 1.7, -1.7), goal)
    motion = tm.plan(problem, effort="quick", refine=None).trajectory
    asked = tm.Status.INTERRUPTED
    return Candidate("a start", asked, True, motion, motion, violations={})


@pytest.mark.parametrize("asked", [False, True])
def test_processes_that_were_asked_at_the_end_of_the_time_were_not_interrupted(
    asked: bool,
) -> None:
    options = tm.Options(processes=2)
    state = PlanState(reach(), options)
    source = ParallelDescents(ProblemFunctions.of(state.problem), state, iter(()))
    source.results = {number: (ended_by_request(), [], []) for number in (0, 1)}
    state.deadline.requested = asked
    with state.deadline.grace(float("inf")):
        first = source.result(0)
        others = source.unclaimed()
    expected = tm.Status.INTERRUPTED if asked else tm.Status.TIME_LIMIT
    assert first is not None
    assert [attempt.status for attempt in (first, *others)] == [expected] * 2


def test_what_a_process_has_repaired_is_not_asked_for_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It may still lack some of the padding: that ended a plan as out of time."""
    system = ProblemFunctions.of(reach())
    guess = next(initial_guesses(system, GuessRequest(1, np.random.default_rng(0))))
    motion, lack = ended_by_request().trajectory, {"clearance": 1e-4 / system.reach}
    ended = Candidate("a start", tm.Status.INFEASIBLE, False, motion, motion, lack)
    state = PlanState(system.problem, tm.Options(processes=2))
    source = ParallelDescents(system, state, iter(()))
    source.batch, source.results = [guess], {0: (ended, [], [])}
    monkeypatch.setattr("tominpmp.planner.starts.ParallelDescents", lambda *_: source)
    assert run(state, _descents(system, state, iter(()), 1, 1)) is None
    [found] = state.candidates
    assert found.status is tm.Status.INFEASIBLE
    assert state.ended is None


def test_processes_are_not_started_where_there_is_no_time_for_it(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    def started(*_: object) -> None:
        raise AssertionError("processes were started")

    monkeypatch.setattr("tominpmp.planner.starts.ready", lambda: False)
    monkeypatch.setattr("tominpmp.planner.starts.run_parallel", started)
    solution = tm.plan(reach(), processes=2, starts=2, max_planning_time=4.9)
    assert solution.success
