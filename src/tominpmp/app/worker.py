"""A process that plans, so that the page stays awake.

Parent and child speak in pickled records over the child's standard input and output:
numbers and requests go in, outcomes come out. The child reads while it plans: of
several requests only the newest counts. It is ``python -m tominpmp.app.worker``.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from typing import IO, Any

from tominpmp.app.planning import Outcome, Session
from tominpmp.app.request import Request

# What was begun goes on for so long although it is out of date, so that motions are
# seen while one drags; a plan that takes longer makes place for the newest [s].
GRACE = 0.8
# What comes of a stream that has ended, maybe within a record.
ENDED = (EOFError, OSError, ValueError, pickle.UnpicklingError)
# Numbers and requests; None where no more will come.
Jobs = SimpleQueue[tuple[int, Request] | None]


def send(stream: IO[bytes], item: Any) -> None:
    """Write a record to a stream."""
    pickle.dump(item, stream)
    stream.flush()


def work(session: Session, jobs: Jobs, answer: Callable[[Outcome], None]) -> None:
    """Plan the newest of the requests, one after the other, until no more will come."""
    while (job := _newest(jobs)) is not None:
        begun = time.monotonic()

        def superseded(begun: float = begun) -> bool:
            return not jobs.empty() and time.monotonic() - begun > GRACE

        for outcome in session.outcomes(*job, superseded):
            answer(outcome)
            if not jobs.empty():
                # A motion was seen; what else could be told of it is out of date.
                break


def _newest(jobs: Jobs) -> tuple[int, Request] | None:
    job = jobs.get()
    while not jobs.empty():
        job = jobs.get()
    return job


def main() -> None:
    """Serve the parent until it closes the input."""
    # Ctrl-C in the terminal is for the parent, which closes the input.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    output = os.fdopen(os.dup(1), "wb")
    # What libraries print must not get between the records.
    os.dup2(2, 1)
    # Not through sys.stdin: its lock would be held when the interpreter ends.
    source = os.fdopen(os.dup(0), "rb", closefd=False)
    jobs: Jobs = SimpleQueue()

    def read() -> None:
        with suppress(*ENDED):
            while True:
                jobs.put(pickle.load(source))
        jobs.put(None)

    threading.Thread(target=read, daemon=True).start()
    with suppress(BrokenPipeError):
        work(Session(), jobs, lambda item: send(output, item))


class Worker:
    """The planning process.

    Args:
        on_outcome: Called with each outcome, in a thread of the worker's own, and with
            one that says so if the process ends by itself.
    """

    def __init__(self, on_outcome: Callable[[Outcome], None]) -> None:
        self._on_outcome = on_outcome
        self._last: tuple[int, Request] | None = None
        self._lock = threading.Lock()
        self._closing = False
        self._process = self._started()

    def _started(self) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [sys.executable, "-m", "tominpmp.app.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._listener = threading.Thread(
            target=self._listen, args=(process,), daemon=True
        )
        self._listener.start()
        return process

    def plan(self, number: int, request: Request) -> None:
        """Plan a request; what is planned before it is out of date."""
        with self._lock:
            if self._process.poll() is not None and not self._closing:
                # It has crashed; the next request has a new one.
                self._process = self._started()
            assert self._process.stdin is not None  # noqa: S101
            self._last = number, request
            # If it has just ended, the listener tells.
            with suppress(*ENDED):
                send(self._process.stdin, self._last)

    def close(self) -> None:
        """End the process."""
        self._closing = True
        with self._lock:
            _close(self._process.stdin)
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._listener.join(2.0)

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None  # noqa: S101
        try:
            while True:
                self._on_outcome(pickle.load(process.stdout))
        except ENDED:
            if not self._closing and self._last is not None:
                told = (
                    f"the planning process has ended by itself (code {process.wait()});"
                    " the next change starts another one"
                )
                self._on_outcome(Outcome(*self._last, told))
        finally:
            _close(process.stdin)
            _close(process.stdout)


def _close(stream: IO[bytes] | None) -> None:
    """Close a stream, be the other end there or not."""
    if stream is not None:
        with suppress(OSError):
            stream.close()


if __name__ == "__main__":
    main()
