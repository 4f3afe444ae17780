"""A process that plans, so that the page stays awake.

Parent and child speak in pickled records over the child's standard input and output.
The child reads while it plans: of several requests only the newest counts.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from typing import IO

from tominpmp.app.jobs import Exported, ExportJob, PlanJob, receive, send
from tominpmp.app.outcome import Outcome
from tominpmp.app.request import Request


class Worker:
    """The planning process.

    Args:
        on_outcome: Called with each outcome, in a thread of the worker's own.
        on_end: Called if the process ends by itself, with a sentence.
    """

    def __init__(
        self, on_outcome: Callable[[Outcome], None], on_end: Callable[[str], None]
    ) -> None:
        self._on_outcome, self._on_end = on_outcome, on_end
        self._lock = threading.Lock()
        self._tickets = 0
        self._answers: dict[int, tuple[threading.Event, list[Exported]]] = {}
        self._closing = False
        self._process = self._started()

    def _started(self) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [sys.executable, "-m", "tominpmp.app.child"],
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
        self._send(PlanJob(number, request))

    def export(
        self, ending: str, dt: float | None, message: str | None, patience: float = 60.0
    ) -> Exported:
        """Write the last motion to a file, and wait for it.

        Args:
            ending: What its name ends with.
            dt: Time between rows [s]; None for the nodes.
            message: Which ROS message, if it is one.
            patience: How long to wait [s].
        """
        event, found = threading.Event(), list[Exported]()
        with self._lock:
            self._tickets += 1
            ticket = self._tickets
            self._answers[ticket] = event, found
        self._send(ExportJob(ticket, ending, dt, message))
        if not event.wait(patience) or not found:
            remark = "the file was not written in time; planning is still busy"
            return Exported(ticket, "", b"", remark)
        return found[0]

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

    def _send(self, job: PlanJob | ExportJob) -> None:
        with self._lock:
            if self._process.poll() is not None and not self._closing:
                # It has crashed; the next request has a new one.
                self._process = self._started()
            assert self._process.stdin is not None  # noqa: S101
            try:
                send(self._process.stdin, job)
            except (OSError, ValueError):
                pass  # it has just ended, which the listener tells

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None  # noqa: S101
        try:
            while True:
                item = receive(process.stdout)
                if isinstance(item, Outcome):
                    self._on_outcome(item)
                    continue
                event, found = self._answers.pop(item.ticket, (None, []))
                found.append(item)
                if event is not None:
                    event.set()
        except (EOFError, OSError, ValueError):
            if not self._closing:
                code = process.wait()
                self._on_end(
                    f"the planning process has ended by itself (code {code}); the next "
                    "change starts another one"
                )
        finally:
            _close(process.stdin)
            _close(process.stdout)


def _close(stream: IO[bytes] | None) -> None:
    """Close a stream, be the other end there or not."""
    if stream is not None:
        try:
            stream.close()
        except OSError:
            pass
