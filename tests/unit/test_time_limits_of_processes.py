"""Time limits of plans in several processes, and the results they keep."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Iterator
from concurrent import futures
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from clocks import Clock
from parallel_work import PATIENCE, begin_and_wait, square, wait_for_stop_request

import tominpmp as tm
from tests.schedules import loop_with
from tominpmp.initial_guess import parallel
from tominpmp.initial_guess.guess import GuessRequest
from tominpmp.initial_guess.parallel import ready, run_parallel
from tominpmp.planner import descent
from tominpmp.planner.automatic_options import resolve_options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.starts import (
    ParallelDescents,
    Result,
    _descents,
    descend_in_process,
)
from tominpmp.planner.work import Work, run
from tominpmp.stopping import Deadline, Stop
from tominpmp.transcription.problem_functions import ProblemFunctions


def test_time_limit_ends_the_wait_for_unresponsive_processes(
    clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    list(run_parallel(square, range(3), 2))  # processes take time to start
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
    assert not ready(), "the processes were ended, and have to be started again"
    monkeypatch.setattr(parallel, "wait", futures.wait)
    assert dict(run_parallel(square, range(3), 2)) == {0: 0, 1: 1, 2: 4}


def has_ended(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.skipif(os.name != "posix", reason="finds processes by their ids")
def test_old_processes_end_if_new_ones_start_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: on a busy machine the old processes went on, and the program waited
    for them at its end.
    """
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
    while not all(map(has_ended, pids)) and time.monotonic() < end:
        time.sleep(0.02)
    assert all(map(has_ended, pids))


def test_results_within_the_grace_period_are_kept(
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
        for result in run_parallel(wait_for_stop_request, [tmp_path, tmp_path], 2):
            found.append(result)
    watch.join()
    assert sorted(found) == [(0, True), (1, True)]


def reach() -> tm.Problem:
    robot = tm.load_robot("planar3r")
    ball = tm.Sphere("ball", radius=0.8, position=(4.0, 0.0, 0.0))
    goal = tm.PositionGoal("tip", (4.0, 1.0, 0.0))
    return tm.Problem(robot, (0.5, 1.7, -1.7), goal, scene=tm.Scene([ball]))


def test_plan_in_two_processes_keeps_its_time_limit(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Processes hand over their current candidates when the time is used up."""
    limit, starts = 600.0, 200
    usual, handed = ParallelDescents.result, []

    def result(ahead: ParallelDescents, number: int, *_: object) -> Candidate | None:
        candidate = usual(ahead, number)
        clock.advance(0.0 if handed else 1.05 * limit)
        handed.append(number)
        return candidate

    monkeypatch.setattr(ParallelDescents, "result", result)
    options = tm.Options(processes=2, starts=starts, intervals=24, tolerance=1e-9)
    begin = time.monotonic()
    solution = tm.plan(reach(), options, max_planning_time=limit)
    # The second result may arrive with the first, and more on a busy machine.
    assert 0 < len(handed) < 0.1 * starts
    assert solution.status is tm.Status.TIME_LIMIT
    assert solution.success
    assert time.monotonic() - begin < PATIENCE


def test_process_without_remaining_time_ends_at_once() -> None:
    system = ProblemFunctions.of(reach())
    guess = next(GuessRequest(np.random.default_rng(0)).guesses(system))
    options = tm.Options(method="inverse", lp_solver="piqp", intervals=160)
    result = descend_in_process(system, options, time.time() - 1.0, math.inf, guess)
    candidate, failures, history = result
    assert not failures
    if candidate is not None:
        assert candidate.status is tm.Status.TIME_LIMIT
        assert len(history) <= 1


def interrupted_candidate() -> Candidate:
    """The candidate of a process that was asked to stop."""
    goal = tm.JointGoal((0.6, 1.7, -1.7))
    problem = tm.Problem(tm.load_robot("planar3r"), (0.5, 1.7, -1.7), goal)
    motion = tm.plan(problem, effort="quick", refine=None).trajectory
    requested = tm.Status.INTERRUPTED
    return Candidate(requested, True, motion, motion, violations={})


@pytest.mark.parametrize("requested", [False, True])
def test_candidates_stopped_by_the_time_limit_have_its_status(
    requested: bool,
) -> None:
    options = tm.Options(processes=2)
    state = PlanState(reach(), options)
    source = ParallelDescents(ProblemFunctions.of(state.problem), state, iter(()))
    source.results = {number: (interrupted_candidate(), [], []) for number in (0, 1)}
    state.deadline.requested = requested
    with state.deadline.grace(float("inf")):
        first = source.result(0)
        others = source.unclaimed()
    expected = tm.Status.INTERRUPTED if requested else tm.Status.TIME_LIMIT
    assert first is not None
    assert [candidate.status for candidate in (first, *others)] == [expected] * 2


def test_candidate_repaired_in_a_process_is_not_repaired_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Regression: a repaired candidate may still lack some of the padding, and the
    second repair ended the plan as out of time.
    """
    system = ProblemFunctions.of(reach())
    guess = next(GuessRequest(np.random.default_rng(0)).guesses(system))
    motion, lack = (
        interrupted_candidate().trajectory,
        {"clearance": 1e-4 / system.reach},
    )
    ended = Candidate(tm.Status.INFEASIBLE, False, motion, motion, lack)
    state = PlanState(system.problem, tm.Options(processes=2))
    source = ParallelDescents(system, state, iter(()))
    source.batch, source.results = [guess], {0: (ended, [], [])}
    monkeypatch.setattr("tominpmp.planner.starts.ParallelDescents", lambda *_: source)
    assert run(state, _descents(system, state, iter(()), 1, 1)) is None
    [found] = state.candidates
    assert found.status is tm.Status.INFEASIBLE
    assert state.ended is None


def test_descents_in_processes_are_dropped_only_if_the_incumbent_is_faster(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Regression: processes had no incumbent, and dropped all starts whose violation
    stagnates.
    """
    system, ends = ProblemFunctions.of(reach()), []
    kept = SimpleNamespace()  # of a replay that keeps all limits
    incumbent = replace(interrupted_candidate(), verification=kept)

    def work(*args: Any) -> Work:
        for factor in (0.9, 1.1):
            duration = factor * incumbent.duration
            record = SimpleNamespace(violation=0.3, duration=duration)
            loop = loop_with([record] * descent.PATIENCE)
            ends.append(descent._stop_if_hopeless(args[-1], loop))
        return descent.descent_work(*args)

    def one_by_one(task: Any, items: Any, *_: float) -> Iterator[Any]:
        yield from enumerate(map(task, items))

    monkeypatch.setattr("tominpmp.planner.starts.descent_work", work)
    monkeypatch.setattr("tominpmp.planner.starts.run_parallel", one_by_one)
    options = resolve_options(system.problem, tm.Options(max_iterations=1))
    state = PlanState(system.problem, options)
    state.candidates.append(incumbent)
    guesses = GuessRequest(np.random.default_rng(0)).guesses(system)
    source = ParallelDescents(system, state, guesses)
    assert source.next(1) is not None
    source.result(0)
    assert ends == [None, tm.Status.STALLED]


@pytest.mark.parametrize("end", [Stop(requested=True), RuntimeError("died")])
def test_motions_of_processes_are_kept_if_the_callback_stops_the_plan(
    monkeypatch: pytest.MonkeyPatch, end: BaseException
) -> None:
    """Regression: no motion was found, although two processes had found one each."""
    system, motion = ProblemFunctions.of(reach()), interrupted_candidate()
    record = tm.IterationRecord(0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0, True, 1, 1, 0.0, 0.0)

    def handed_over() -> Iterator[tuple[int, Result]]:
        yield 0, (motion, [], [record])
        yield 1, (motion, [], [])
        raise end

    state = PlanState(system.problem, tm.Options(processes=2, callback=bool))
    source = ParallelDescents(system, state, iter(()))
    guess = next(GuessRequest(np.random.default_rng(0)).guesses(system))
    source.batch, source.done = [guess], handed_over()
    monkeypatch.setattr("tominpmp.planner.starts.ParallelDescents", lambda *_: source)
    assert run(state, _descents(system, state, iter(()), 1, 1)) is tm.Status.INTERRUPTED
    assert len(state.candidates) == 2


def test_processes_are_not_started_with_little_planning_time(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    def started(*_: object) -> None:
        raise AssertionError("processes were started")

    monkeypatch.setattr("tominpmp.planner.starts.ready", lambda: False)
    monkeypatch.setattr("tominpmp.planner.starts.run_parallel", started)
    solution = tm.plan(reach(), processes=2, starts=2, max_planning_time=4.9)
    assert solution.success
