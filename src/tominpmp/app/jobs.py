"""Jobs of the planning process, and how they are passed on."""

from __future__ import annotations

import pickle
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import IO, Any

from tominpmp.app.planning import Session
from tominpmp.app.request import Request
from tominpmp.exceptions import TominpmpError

# What was begun goes on for so long although it is out of date, so that motions are
# seen while one drags; a plan that takes longer makes place for the newest [s].
GRACE = 0.8


@dataclass(frozen=True)
class PlanJob:
    """Plan a request.

    Attributes:
        number: Its number; larger ones are newer.
        request: What is asked for.
    """

    number: int
    request: Request


@dataclass(frozen=True)
class ExportJob:
    """Write the last motion to a file.

    Attributes:
        ticket: Number to tell the answer by.
        ending: What the file's name ends with.
        dt: Time between rows [s]; None for the nodes.
        message: Which ROS message, if it is one.
    """

    ticket: int
    ending: str
    dt: float | None = None
    message: str | None = None


@dataclass(frozen=True)
class Exported:
    """A file with a motion.

    Attributes:
        ticket: Number of the job.
        name: Name of the file.
        content: Its content; empty if it was not written.
        remark: What its check says, or why it was not written.
    """

    ticket: int
    name: str
    content: bytes
    remark: str


def send(stream: IO[bytes], item: Any) -> None:
    """Write a record to a stream."""
    pickle.dump(item, stream)
    stream.flush()


def receive(stream: IO[bytes]) -> Any:
    """Read a record from a stream; only what :func:`send` wrote may be in it.

    Raises:
        EOFError: If the stream has ended.
    """
    try:
        return pickle.load(stream)
    except pickle.UnpicklingError as error:  # it ended within a record
        raise EOFError from error


class Inbox:
    """Jobs that wait: the newest plan, and all exports, which go first."""

    def __init__(self) -> None:
        self._ready = threading.Condition()
        self._plan: PlanJob | None = None
        self._exports: list[ExportJob] = []
        self._closed = False

    def put(self, job: PlanJob | ExportJob) -> None:
        """Add a job."""
        with self._ready:
            if isinstance(job, PlanJob):
                self._plan = job
            else:
                self._exports.append(job)
            self._ready.notify_all()

    def close(self) -> None:
        """Let :meth:`get` end."""
        with self._ready:
            self._closed = True
            self._ready.notify_all()

    def get(self) -> PlanJob | ExportJob | None:
        """Wait for a job; None when closed."""
        with self._ready:
            while not (self._closed or self._plan or self._exports):
                self._ready.wait()
            if self._closed:
                return None
            if self._exports:
                return self._exports.pop(0)
            job, self._plan = self._plan, None
            return job

    def newer(self) -> bool:
        """Whether there is something to be done next, or the end has come."""
        return self._closed or self._plan is not None


def work(session: Session, inbox: Inbox, answer: Callable[[Any], None]) -> None:
    """Do jobs until the inbox is closed."""
    while (job := inbox.get()) is not None:
        if isinstance(job, ExportJob):
            answer(_export(session, job))
            continue
        begun = time.monotonic()

        def superseded(begun: float = begun) -> bool:
            return inbox.newer() and time.monotonic() - begun > GRACE

        for outcome in session.outcomes(job.number, job.request, superseded):
            answer(outcome)
            if inbox.newer():
                # A motion was seen; what else could be told of it is out of date.
                break


def _export(session: Session, job: ExportJob) -> Exported:
    try:
        found = session.exported(job.ending, job.dt, job.message)
    except TominpmpError as error:
        return Exported(job.ticket, "", b"", str(error))
    return Exported(job.ticket, *found)
