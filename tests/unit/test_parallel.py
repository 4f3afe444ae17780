"""Work in several processes: results, exceptions, time limits, interruption."""

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
from tominpmp.initial_guess.parallel import LATE, run_parallel


def refuse(x):
    if x == 1:
        raise FrameNotFound("tool", ["base", "tip"])
    return x


def clearance_at(system, q):
    return float(system.clearance.values(np.array([q]), np.inf).max())


def test_results_come_with_the_numbers_of_their_items():
    results = dict(run_parallel(square, range(5), 2))
    assert results == {number: number**2 for number in range(5)}


def test_results_come_from_other_processes_in_order_of_completion(tmp_path):
    results = []
    for result in run_parallel(await_file, [tmp_path / "second is here", None], 2):
        results.append(result)
        (tmp_path / "second is here").touch()
    assert [number for number, _ in results] == [1, 0]
    workers = {worker for _, worker in results}
    assert os.getpid() not in workers and len(workers) == 2


def test_exceptions_of_a_worker_keep_their_attributes():
    with pytest.raises(FrameNotFound, match="no frame 'tool'") as caught:
        list(run_parallel(refuse, [1], 2))
    assert caught.value.available == ("base", "tip")


def test_results_after_the_grace_period_are_not_awaited(clock):
    begin, found = time.monotonic(), []
    for number, _ in run_parallel(sleep_and_report, [0.0, 600.0], 2, seconds=100.0):
        found.append(number)
        clock.advance(100.0 + 1.1 * LATE)
    assert found == [0]
    assert time.monotonic() - begin < 300.0


def test_results_within_the_grace_period_are_taken(clock, tmp_path):
    items, found = [None, tmp_path / "late"], []
    for number, _ in run_parallel(await_file, items, 2, seconds=100.0):
        found.append(number)
        clock.advance(100.0 + 0.9 * LATE)
        (tmp_path / "late").touch()
    assert found == [0, 1]


def test_items_are_generated_when_a_process_is_free():
    generated = []

    def items():
        for number in range(8):
            generated.append(number)
            yield number

    results = run_parallel(square, items(), 2)
    next(results)
    assert len(generated) <= 4
    results.close()
    assert len(generated) <= 4


@pytest.fixture
def interruptible():
    """Ctrl-C raises, also if a shell ignores this signal, as in the background."""
    former = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, former)


@pytest.mark.usefixtures("interruptible")
def test_interruption_keeps_finished_results():
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


def test_collision_geometry_is_available_in_another_process(tmp_path):
    system = maze(tmp_path, wall("block", 0.0, -0.8, 0.8))
    evaluate = functools.partial(clearance_at, system)
    configurations = [START, (0.0, 1.5)]
    results = dict(run_parallel(evaluate, configurations, 2))
    for number, q in enumerate(configurations):
        assert results[number] == pytest.approx(clearance_at(system, q), abs=1e-9)


def test_exceptions_can_be_pickled():
    error = pickle.loads(pickle.dumps(FrameNotFound("a", ["b"])))
    assert isinstance(error, FrameNotFound)
    assert (error.name, error.available) == ("a", ("b",))
    assert str(error) == "there is no frame 'a'; the robot has: b"
