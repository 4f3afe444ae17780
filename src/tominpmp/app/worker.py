"""A process that plans, so that the page stays responsive.

Requests are sent to it, outcomes come back. It receives while it plans: of several
requests only the newest is planned. The process is started by loky, which does not run
the caller's main module a second time.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from typing import Any

from loky.backend import get_context

from tominpmp.app.planning import Outcome, Session
from tominpmp.app.request import Request

# Least time of a plan before a newer request ends it [s]: quick plans complete, so that
# motions appear while a handle is dragged.
GRACE = 0.8
# Requests; None marks the end.
Jobs = SimpleQueue[Request | None]


def work(session: Session, jobs: Jobs, answer: Callable[[Outcome], None]) -> None:
    """Plan the newest of the requests, one after the other, until the end mark."""
    while (request := jobs.get()) is not None:
        if not jobs.empty():
            continue
        begun = time.monotonic()

        def superseded(begun: float = begun) -> bool:
            return not jobs.empty() and time.monotonic() - begun > GRACE

        for outcome in session.outcomes(request, superseded):
            answer(outcome)
            if not jobs.empty():
                # A motion was shown; further outcomes of this request are outdated.
                break


def _serve(connection: Any) -> None:
    """Plan the requests of a connection until the parent process closes it."""
    # Ctrl-C in the terminal is for the parent, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    jobs: Jobs = SimpleQueue()

    def read() -> None:
        with suppress(EOFError, OSError):
            while True:
                jobs.put(connection.recv())
        jobs.put(None)

    threading.Thread(target=read, daemon=True).start()
    with suppress(OSError):
        work(Session(), jobs, connection.send)


class Worker:
    """The planning process.

    Args:
        on_outcome: Called with each outcome, in a thread of the worker; if the process
            crashes, with an outcome that reports the crash.
    """

    def __init__(self, on_outcome: Callable[[Outcome], None]) -> None:
        self._on_outcome = on_outcome
        self._last: Request | None = None
        self._lock = threading.Lock()
        self._closing = False
        self._start()

    def _start(self) -> None:
        context = get_context("loky")
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other,), daemon=True)
        self._process.start()
        other.close()  # the copy of the process is the only one, and ends with it
        ends = self._process, self._connection
        self._listener = threading.Thread(target=self._listen, args=ends, daemon=True)
        self._listener.start()

    def plan(self, request: Request) -> None:
        """Plan a request; earlier requests become outdated."""
        with self._lock:
            if not self._process.is_alive() and not self._closing:
                # The process has crashed; a new one plans this request.
                self._start()
            self._last = request
            # If the process has just ended, the listener reports it.
            with suppress(OSError):
                self._connection.send(request)

    def close(self) -> None:
        """End the planning process, which has nothing to put away."""
        with self._lock:
            self._closing = True
        self._process.terminate()
        self._process.join()
        self._listener.join(2.0)

    def _listen(self, process: Any, connection: Any) -> None:
        try:
            while True:
                self._on_outcome(connection.recv())
        except (EOFError, OSError):
            process.join()
            if not self._closing and self._last is not None:
                message = (
                    "the planning process has ended unexpectedly (code "
                    f"{process.exitcode}); the next change starts another one"
                )
                self._on_outcome(Outcome(self._last, message))
        finally:
            connection.close()
