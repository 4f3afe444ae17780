"""Work in several processes."""

from __future__ import annotations

import functools
import os
import pickle
import signal
import threading
import time

import numpy as np
import pytest
from guess_samples import START, maze, wall
from parallel_work import await_file, sleep_and_report, square

from tominpmp.exceptions import FrameNotFound
from tominpmp.initial_guess.parallel import LATE, available_processes, run_parallel


def refuse(x):
    if x == 1:
        raise FrameNotFound("tool", ["base", "tip"])
    return x


def clearance_at(system, q):
    return float(system.clearance.values(np.array([q]), np.inf).max())


@pytest.mark.parametrize("processes", [1, 2])
def test_all_results_come_with_their_numbers(processes):
    results = dict(run_parallel(square, range(5), processes))
    assert results == {number: number**2 for number in range(5)}


def test_results_come_as_they_are_ready_from_other_processes(tmp_path):
    results = []
    for result in run_parallel(await_file, [tmp_path / "second is here", None], 2):
        results.append(result)
        (tmp_path / "second is here").touch()
    assert [number for number, _ in results] == [1, 0]
    workers = {worker for _, (worker, _) in results}
    assert os.getpid() not in workers and len(workers) == 2
    assert {threads for _, (_, threads) in results} == {"1"}


@pytest.mark.parametrize("processes", [1, 2])
def test_exceptions_arrive_with_their_values(processes):
    with pytest.raises(FrameNotFound, match="no frame 'tool'") as caught:
        list(run_parallel(refuse, [1], processes))
    assert caught.value.available == ("base", "tip")


def test_late_results_are_not_waited_for(clock):
    begin, found = time.monotonic(), []
    for number, _ in run_parallel(sleep_and_report, [0.0, 600.0], 2, seconds=100.0):
        found.append(number)
        clock.advance(100.0 + 1.1 * LATE)
    assert found == [0]
    assert time.monotonic() - begin < 300.0


def test_results_that_are_a_little_late_are_taken(clock, tmp_path):
    items, found = [None, tmp_path / "late"], []
    for number, _ in run_parallel(await_file, items, 2, seconds=100.0):
        found.append(number)
        clock.advance(100.0 + 0.9 * LATE)
        (tmp_path / "late").touch()
    assert found == [0, 1]


def test_no_item_is_begun_after_the_time_limit(clock):
    def items():
        yield 1
        clock.advance(0.05)
        yield 2

    assert list(run_parallel(square, items(), 1, seconds=0.02)) == [(0, 1)]


def test_items_are_made_when_a_process_is_free():
    made = []

    def items():
        for number in range(8):
            made.append(number)
            yield number

    results = run_parallel(square, items(), 2)
    next(results)
    assert len(made) <= 4
    results.close()
    assert len(made) <= 4


@pytest.fixture
def interruptible():
    """Ctrl-C raises, also where a shell has left it ignored, as in the background."""
    former = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, former)


@pytest.mark.usefixtures("interruptible")
def test_an_interruption_leaves_what_was_finished():
    found = []
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        for number, _ in run_parallel(sleep_and_report, [0.0, 60.0, 60.0], 2):
            found.append(number)
            timer.start()
    timer.join()
    assert found == [0]
    # The next call works again.
    assert list(run_parallel(square, [3], 2)) == [(0, 9)]


def test_a_system_finds_its_geometry_in_another_process(tmp_path):
    system = maze(tmp_path, wall("block", 0.0, -0.8, 0.8))
    evaluate = functools.partial(clearance_at, system)
    configurations = [START, (0.0, 1.5)]
    results = dict(run_parallel(evaluate, configurations, 2))
    for number, q in enumerate(configurations):
        assert results[number] == pytest.approx(clearance_at(system, q), abs=1e-9)


def test_exceptions_of_the_library_pickle():
    error = pickle.loads(pickle.dumps(FrameNotFound("a", ["b"])))
    assert isinstance(error, FrameNotFound)
    assert (error.name, error.available) == ("a", ("b",))
    assert str(error) == "there is no frame 'a'; the robot has: b"


def test_there_is_a_process_available():
    assert available_processes() >= 1
