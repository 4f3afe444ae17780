"""Parallel processes: work spread over them, with results as they come.

The processes are those of loky, on which joblib builds. ``joblib.Parallel`` itself
would be one more dependency and not shorter: it neither asks processes at work to stop
nor waits for what they have found by then. Processes of :mod:`concurrent.futures`
outlive a parent that was killed: seen with "spawn", "fork" and "forkserver".
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

# Idle processes are kept this long for the next call [s]; to start one takes seconds.
KEEP = 120.0
# They are still counted on within this time [s].
READY = 0.9 * KEEP
# Longest waits for results [s]: of processes that were asked to stop, and of processes
# at the end of the time.
GRACE = 4.0
LATE = 1.0
# Periods of the checks for a request to stop, and for a living parent [s].
TICK, PULSE = 0.1, 0.25
# Numerical libraries take one thread a process.
THREADS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "BLIS_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
}


def run_parallel(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    processes: int,
    seconds: float = math.inf,
) -> Iterator[tuple[int, Result]]:
    """Apply a function to items in several processes.

    Items are only taken from the iterable when a process is free (or will be next), so
    that it may be a generator that computes them; it runs in this process. Results
    yielded before an interruption (Ctrl-C), an exception or the time limit are the
    caller's to keep. Busy processes are asked to stop then, and when the caller stops
    iterating, and killed if they do not; a function that heeds :func:`asked_to_stop`
    still has its result yielded. Processes end with this one, however it ends.

    Args:
        function: Function of an item. Processes keep their copy of it during a call,
            so it should forget what it did with other items: results must not depend
            on which process made them. Both must be picklable.
        items: Arguments of the function.
        processes: Number of processes, at least 1; with 1 it runs in this process.
        seconds: Time after which results are no longer waited for [s]; a function that
            watches its own time should end before.

    Yields:
        Number of the item and its result, in order of completion.

    Raises:
        Exception: The first exception that the function raised.
        Stop: If this process was asked to stop.
    """
    deadline = time.perf_counter() + seconds
    if processes == 1:
        for number, item in enumerate(items):
            if time.perf_counter() > deadline:
                return
            yield number, function(item)
        return
    crew = _Crew(processes, function)
    numbered = enumerate(items)
    try:
        while True:
            # One more than there are processes, so that no process waits for an item.
            wanted = processes + 1 - len(crew.pending)
            for following in itertools.islice(numbered, wanted):
                crew.submit(*following)
            if not crew.pending:
                return
            done = crew.wait(deadline + LATE)
            if not done:
                return
            yield from crew.results(done)
    except (Stop, KeyboardInterrupt):
        crew.ask()
        # At the end of the time processes end by themselves, without further grace.
        patience = min(GRACE, seconds_to_end())
        end = time.perf_counter() + patience
        with grace(patience):
            while crew.pending and (done := crew.wait(end)):
                yield from crew.results(done)
        raise
    finally:
        crew.dismiss()


_idle_since = -math.inf
# Whether the processes of the last call are being ended.
_ending = False


def ready() -> bool:
    """Whether processes of a former call are still there, and wait for work."""
    return time.perf_counter() - _idle_since < READY


class _Crew:
    """Processes at work; idle processes are kept for the next call."""

    def __init__(self, processes: int, function: Callable[[Any], Any]) -> None:
        # Takes a while, and most plans run in this process.
        from loky import get_reusable_executor
        from loky.backend.reduction import dumps

        global _ending
        self._asking = _event()
        self._asking.clear()
        # To make others in their place would take the order to end them back.
        ending, _ending = _ending, False
        self._executor = get_reusable_executor(
            max_workers=processes,
            timeout=KEEP,
            kill_workers=ending,
            env=THREADS,
            initializer=_prepare,
            initargs=(os.getpid(), self._asking),
        )
        self.pending: dict[Future[Any], int] = {}
        self._function = uuid.uuid4().hex, bytes(dumps(function))

    def submit(self, number: int, item: Any) -> None:
        """Give an item to the next process that is free."""
        self.pending[self._executor.submit(_apply, *self._function, item)] = number

    def wait(self, until: float) -> set[Future[Any]]:
        """Futures that are done; the set is empty at the end of the time [s].

        Raises:
            Stop: If this process was asked to stop.
        """
        while True:
            done, _ = wait(self.pending, TICK, return_when=FIRST_COMPLETED)
            if done or time.perf_counter() > until:
                return done
            check()

    def results(self, done: set[Future[Any]]) -> Iterator[tuple[int, Any]]:
        """Results of futures that are done, in the order of their items."""
        for future in sorted(done, key=lambda f: self.pending[f]):
            yield self.pending.pop(future), future.result()

    def ask(self) -> None:
        """Ask all processes to stop; items not begun are cancelled."""
        for future in list(self.pending):
            if future.cancel():
                del self.pending[future]
        self._asking.set()

    def dismiss(self) -> None:
        """Release the processes for other work, or kill them if they do not finish."""
        self.ask()
        if self.pending:
            wait(self.pending, min(LATE, seconds_to_end()))
        global _idle_since, _ending
        _idle_since = time.perf_counter()
        if not all(future.done() for future in self.pending):
            _idle_since, _ending = -math.inf, True
            self._executor.shutdown(wait=False, kill_workers=True)


@cache
def _event() -> Any:
    """Event that asks the processes to stop; shared, so that these can be kept."""
    from loky.backend import get_context

    return get_context("loky").Event()


_asked: Callable[[], bool] | None = None


def asked_to_stop() -> bool:
    """Whether this process of :func:`run_parallel` was asked to stop."""
    return _asked is not None and _asked()


_copy: tuple[str, Callable[[Any], Any]] | None = None


def _apply(key: str, pickled: bytes, item: Any) -> Any:
    """The result for an item, in a process of :func:`run_parallel`.

    The function is kept for the next item: to read the meshes of an arm again may take
    longer than to plan.
    """
    global _copy
    if _copy is None or _copy[0] != key:
        _copy = None
        _copy = key, pickle.loads(pickled)
    return _copy[1](item)


def _prepare(parent: int, asking: Any) -> None:
    """Prepare a process for its work."""
    global _asked
    # Ctrl-C is left to the process that waits for the results.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _asked = asking.is_set
    end_with(parent)


def end_with(parent: int) -> None:
    """Let this process end when its parent does, where systems tell who that is."""
    if hasattr(os, "getppid") and os.name == "posix":
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process when its parent has gone, even if it was killed."""
    while os.getppid() == parent:
        time.sleep(PULSE)
    os._exit(1)


def available_processes() -> int:
    """Number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(affinity(0)) if affinity else os.cpu_count() or 1
