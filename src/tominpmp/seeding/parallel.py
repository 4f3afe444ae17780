"""Work spread over several processes, with results as they come."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

# Idle processes are kept this long for the next call [s]; to start one takes seconds.
KEEP = 120.0
# Results that are late by this are no longer waited for [s].
GRACE = 1.0
# Numerical libraries take one thread a process.
THREADS = {
    name: "1"
    for name in (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "BLIS_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
        "NUMEXPR_NUM_THREADS",
    )
}


def run_parallel(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    processes: int,
    seconds: float | None = None,
) -> Iterator[tuple[int, Result]]:
    """Apply a function to items in several processes.

    Items are only taken from the iterable when a process is free (or will be next), so
    that it may be a generator that works for them; it runs in this process. What was
    yielded before an interruption (Ctrl-C), an exception or the time limit is the
    caller's to keep; processes at work are ended then, and when the caller stops
    iterating.

    Args:
        function: Function of an item. It is copied for each item, so that results do
            not depend on which process made them; both must be picklable.
        items: What it is applied to.
        processes: Number of processes, at least 1; with 1 it runs in this process.
        seconds: Time after which results are no longer waited for [s]; a function that
            watches its own time should end before.

    Yields:
        Number of the item and its result, in order of completion.

    Raises:
        Exception: What the function raised first.
    """
    deadline = None if seconds is None else time.perf_counter() + seconds
    if processes == 1:
        for number, item in enumerate(items):
            if deadline is not None and time.perf_counter() > deadline:
                return
            yield number, function(item)
        return
    # Takes a while, and most plans run in this process.
    from loky import get_reusable_executor

    executor = get_reusable_executor(
        max_workers=processes,
        timeout=KEEP,
        env=THREADS,
        # Ctrl-C is left to the process that waits for the results.
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),
    )
    numbered = enumerate(items)
    pending: dict[Future[Any], int] = {}
    finished = False
    try:
        while True:
            # One more than there are processes: none waits for the next item.
            while len(pending) <= processes:
                following = next(numbered, None)
                if following is None:
                    break
                number, item = following
                pending[executor.submit(function, item)] = number
            if not pending:
                break
            left = None
            if deadline is not None:
                left = max(deadline + GRACE - time.perf_counter(), 0.0)
            done, _ = wait(pending, left, return_when=FIRST_COMPLETED)
            if not done:
                return
            for future in sorted(done, key=lambda f: pending[f]):
                yield pending.pop(future), future.result()
        finished = True
    finally:
        if not finished:
            for future in pending:
                future.cancel()
            if not all(future.done() for future in pending):
                executor.shutdown(wait=False, kill_workers=True)


def available_processes() -> int:
    """Number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(affinity(0)) if affinity else os.cpu_count() or 1
