"""When to stop: a deadline and a request to stop, heeded wherever time may pass.

A plan has one :class:`Deadline`. While it is in force, :func:`check` ends whatever goes
on by raising :class:`Stop`, in every loop that may take long; what was found until then
is with the :class:`~tominpmp.planner.plan_state.PlanState`, which knows what to do
then. Native code that cannot ask is given :func:`seconds_left` as its time limit.

Ctrl-C is such a request while a deadline is in force, so that nothing is torn apart in
the middle; a second one, or one that is not heeded soon, raises KeyboardInterrupt.
"""

from __future__ import annotations

import _thread
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import FrameType

# A request that is not heeded for this long becomes a KeyboardInterrupt [s].
PATIENCE = 2.0
# Requests of another process are asked for this often [s].
ASKING = 0.05
# Evaluations of the dynamics for one start at most: some seconds for a small arm.
EVALUATIONS = 300_000


class Stop(BaseException):
    """Ends what is going on. It is not for callers of the library.

    Attributes:
        requested: Whether somebody asked for it; else the time is used up.
    """

    def __init__(self, requested: bool) -> None:
        super().__init__("stop was requested" if requested else "the time is used up")
        self.requested = requested


class Deadline:
    """A deadline and a request to stop.

    Args:
        asked: Tells whether another process asks to stop.

    Attributes:
        end: When to stop, on the clock of ``time.perf_counter`` [s]; infinite
            without a limit.
        last: When all must have come to its end, what was found being saved by then,
            on the same clock [s]; infinite without a limit.
        requested: Whether somebody asked to stop.
        heeded: Whether a request has been seen.
    """

    def __init__(self, asked: Callable[[], bool] | None = None) -> None:
        self.end = math.inf
        self.last = math.inf
        self.requested = False
        self.heeded = False
        self._asked = asked
        self._next = 0.0
        self._set_aside = False

    @property
    def due(self) -> bool:
        """Whether it is time to stop."""
        if self.requested:
            self.heeded = True
            return True
        now = time.perf_counter()
        if self._asked is not None and now > self._next:
            self._next = now + ASKING
            if self._asked():
                self.requested = self.heeded = True
                return True
        return now > self.end

    @property
    def interrupted(self) -> bool:
        """Whether somebody asked to stop, be it before a time of grace began."""
        return self.requested or self._set_aside

    def check(self) -> None:
        """Stop if it is time.

        Raises:
            Stop: If it is.
        """
        if self.due:
            raise Stop(self.requested)

    @contextmanager
    def in_force(self) -> Iterator[None]:
        """Heed this deadline, and Ctrl-C as a request to it."""
        token = _present.set(self)
        try:
            with self._interruptible():
                yield
        finally:
            self.heeded = True
            _present.reset(token)

    @contextmanager
    def grace(self, until: float) -> Iterator[None]:
        """Go on until another deadline, or until somebody asks once more.

        Args:
            until: The deadline, on the clock of ``time.perf_counter`` [s].
        """
        before = self.end, self.requested, self._asked, self._set_aside
        self._set_aside = self.interrupted
        self.end, self.requested, self._asked = until, False, None
        try:
            yield
        finally:
            end, requested, self._asked, self._set_aside = before
            self.end, self.requested = end, self.requested or requested

    @contextmanager
    def _interruptible(self) -> Iterator[None]:
        """Take Ctrl-C as a request, where it would raise KeyboardInterrupt."""
        main = threading.current_thread() is threading.main_thread()
        usual = signal.default_int_handler
        if not main or signal.getsignal(signal.SIGINT) is not usual:
            yield
            return

        def interrupted(number: int, frame: FrameType | None) -> None:
            if not self.ask():
                usual(number, frame)

        signal.signal(signal.SIGINT, interrupted)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, usual)
            self.heeded = True

    def ask(self) -> bool:
        """Ask to stop; returns whether that will do, as it was not asked before."""
        if self.requested:
            return False
        self.requested, self.heeded = True, False
        self._wait()
        return True

    def _wait(self) -> None:
        timer = threading.Timer(PATIENCE, self._insist)
        timer.daemon = True
        timer.start()

    def _insist(self) -> None:
        """Interrupt code that does not heed a request, again if that is lost."""
        if not self.heeded:
            _thread.interrupt_main()
            self._wait()


_present: ContextVar[Deadline | None] = ContextVar("deadline", default=None)


def check() -> None:
    """Stop if it is time; cheap enough for any loop.

    Raises:
        Stop: If it is.
    """
    deadline = _present.get()
    if deadline is not None and deadline.due:
        raise Stop(deadline.requested)


def due() -> bool:
    """Whether it is time to stop."""
    deadline = _present.get()
    return deadline is not None and deadline.due


def seconds_left() -> float:
    """Time until the deadline, a little at least; infinite without one [s]."""
    deadline = _present.get()
    if deadline is None or math.isinf(deadline.end):
        return math.inf
    return max(deadline.end - time.perf_counter(), 1e-3)


def seconds_to_end() -> float:
    """Time until all must have come to its end; infinite without a limit [s]."""
    deadline = _present.get()
    if deadline is None or math.isinf(deadline.last):
        return math.inf
    return max(deadline.last - time.perf_counter(), 0.0)


def request() -> bool:
    """Ask what is going on to stop; returns whether there is anything that will."""
    deadline = _present.get()
    return deadline is not None and deadline.ask()


@contextmanager
def grace(seconds: float) -> Iterator[None]:
    """Go on for a little, to save what there is, although it is time to stop."""
    deadline = _present.get()
    if deadline is None:
        yield
        return
    with deadline.grace(time.perf_counter() + seconds):
        yield


@contextmanager
def bounded(seconds: float | None) -> Iterator[None]:
    """A stage that has so many seconds where nothing tells yet when to stop."""
    if _present.get() is not None:
        yield
        return
    deadline = Deadline()
    if seconds is not None:
        deadline.end = time.perf_counter() + seconds
    with deadline.in_force():
        yield


class Budget:
    """Work that may be done before the deadline.

    It is counted in evaluations and time of the processor, not by the clock: what comes
    out shall not depend on what else the machine does.

    Args:
        evaluations: Number of states at which the dynamics may be evaluated.
        seconds: Time of the processor [s].
    """

    def __init__(
        self, evaluations: float = EVALUATIONS, seconds: float = math.inf
    ) -> None:
        self.left = self._first = evaluations
        self._end = time.process_time() + seconds

    @property
    def spent(self) -> bool:
        """Whether there is nothing left.

        Raises:
            Stop: If it is time to stop altogether.
        """
        check()
        return self.left <= 0 or time.process_time() > self._end

    def part(self, evaluations: float = EVALUATIONS) -> Budget:
        """A part of it, to be taken off when it is used."""
        part = Budget(min(evaluations, self.left))
        part._end = self._end
        return part

    def take(self, part: Budget) -> None:
        """Take off what was used of a part."""
        self.left -= part._first - part.left

    def pay(self, evaluations: int) -> None:
        """Pay for evaluations.

        Raises:
            StopIteration: If there is nothing left.
        """
        self.left -= evaluations
        if self.spent:
            raise StopIteration
