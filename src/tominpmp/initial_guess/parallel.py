"""Parallel processes: distribute work, and yield results in order of completion.

The worker processes come from loky, on which joblib builds: ``joblib.Parallel`` neither
requests busy workers to stop nor waits for their results. Processes of
:mod:`concurrent.futures` outlive a parent that was killed: seen with "spawn", "fork"
and "forkserver".
"""

from __future__ import annotations

import itertools
import math
import os
import pickle
import signal
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from functools import cache
from typing import Any, TypeVar

from tominpmp.stopping import Stop, check, grace, seconds_to_end

Item = TypeVar("Item")
Result = TypeVar("Result")

# Idle workers are kept this long for the next call [s], as starting one takes seconds.
KEEP = 120.0
# Longest waits for results [s]: of workers that were requested to stop, and of workers
# at the time limit.
GRACE, LATE = 4.0, 1.0
# Period of the checks for a request to stop, and for a living parent [s].
TICK = 0.1


def run_parallel(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    processes: int,
    seconds: float = math.inf,
) -> Iterator[tuple[int, Result]]:
    """Apply a function to items in several processes.

    Items are taken from the iterable only when a process is free, and one in advance.
    It may therefore be a generator that computes them, which runs in this process. The
    caller keeps the results that were yielded before an interruption (Ctrl-C), an
    exception or the time limit. Busy processes are then requested to stop, as they are
    when the caller stops iterating, and killed if they do not. The result of a function
    that returns on :func:`stop_requested` is still yielded. Processes end with this
    one, however it ends.

    Args:
        function: Function of an item. A process keeps its copy of the function during a
            call, so that the function must not keep a state between items: results must
            not depend on the process that makes them. Function and items must be
            picklable.
        items: Arguments of the function.
        processes: Number of processes, at least 1.
        seconds: Time limit for results [s]; a function with a time limit of its own
            should end before.

    Yields:
        Number of the item and its result, in order of completion.

    Raises:
        Exception: The first exception that the function raised.
        Stop: If it is time to stop this process.
    """
    # The import takes a while, and most plans run in a single process.
    from loky import get_reusable_executor
    from loky.backend.reduction import dumps

    global _idle_since, _ending
    deadline = time.perf_counter() + seconds
    stop_event = _shared_stop_event()
    stop_event.clear()
    # New workers must not take the place of workers that are still being killed, as
    # this would revoke the kill.
    ending, _ending = _ending, False
    executor = get_reusable_executor(
        max_workers=processes,
        timeout=KEEP,
        kill_workers=ending,
        initializer=_prepare,
        initargs=(os.getpid(), stop_event),
    )
    copy = uuid.uuid4().hex, bytes(dumps(function))
    pending: dict[Future[Result], int] = {}
    numbered = enumerate(items)

    def completed(until: float) -> list[Future[Result]]:
        """Completed futures in the order of their items; none at the deadline."""
        while True:
            done, _ = wait(pending, TICK, return_when=FIRST_COMPLETED)
            if done or time.perf_counter() > until:
                return sorted(done, key=lambda future: pending[future])
            check()

    def request_stop() -> None:
        """Request all workers to stop; items that wait are cancelled."""
        for future in list(pending):
            if future.cancel():
                del pending[future]
        stop_event.set()

    try:
        while True:
            # One item is submitted in advance, so that no process waits for an item.
            free = processes + 1 - len(pending)
            for number, item in itertools.islice(numbered, free):
                pending[executor.submit(_apply, *copy, item)] = number
            done = completed(deadline + LATE) if pending else []
            if not done:
                return
            for future in done:
                yield pending.pop(future), future.result()
    except (Stop, KeyboardInterrupt):
        request_stop()
        # Near the deadline workers end by themselves: the grace period is shorter.
        patience = min(GRACE, seconds_to_end())
        end = time.perf_counter() + patience
        with grace(patience):
            while pending and (done := completed(end)):
                for future in done:
                    yield pending.pop(future), future.result()
        raise
    finally:
        # The workers are free for other calls, or are killed if they do not finish.
        request_stop()
        if pending:
            wait(pending, min(LATE, seconds_to_end()))
        _idle_since = time.perf_counter()
        if not all(future.done() for future in pending):
            _idle_since, _ending = -math.inf, True
            executor.shutdown(wait=False, kill_workers=True)


_idle_since = -math.inf
# Whether the workers of the last call are being killed.
_ending = False


def ready() -> bool:
    """Whether idle workers of a former call are still available."""
    return time.perf_counter() - _idle_since < KEEP - GRACE


@cache
def _shared_stop_event() -> Any:
    """Stop event of the workers; common to all calls, so that workers can be kept."""
    from loky.backend import get_context

    return get_context("loky").Event()


_stop_is_set: Callable[[], bool] | None = None


def stop_requested() -> bool:
    """Whether a stop of this worker of :func:`run_parallel` was requested."""
    return _stop_is_set is not None and _stop_is_set()


_copy: tuple[str, Callable[[Any], Any]] | None = None


def _apply(key: str, pickled: bytes, item: Any) -> Any:
    """The result for an item, in a worker of :func:`run_parallel`.

    The function is kept for the next item, as loading the meshes of an arm again may
    take longer than planning.
    """
    global _copy
    if _copy is None or _copy[0] != key:
        _copy = None
        _copy = key, pickle.loads(pickled)
    return _copy[1](item)


def _prepare(parent: int, stop_event: Any) -> None:
    """Initialise a worker: its signals, its stop event, and its parent."""
    global _stop_is_set
    # Ctrl-C is handled by the process that waits for the results.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _stop_is_set = stop_event.is_set
    end_with(parent)


def end_with(parent: int) -> None:
    """Let this process end with its parent, on systems that report the parent."""
    if hasattr(os, "getppid") and os.name == "posix":
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process once its parent has ended, even if that was killed."""
    while os.getppid() == parent:
        time.sleep(TICK)
    os._exit(1)
