"""When to stop: a deadline and a stop request, checked wherever time may pass.

A plan has one :class:`Deadline`. While it is in force, every loop that may take long
calls :func:`check`, which ends the computation by raising :class:`Stop`; the best
motion so far is in the :class:`~tominpmp.planner.plan_state.PlanState`, which handles
the exception. Native code that cannot call back gets :func:`seconds_left` as its time
limit.

Ctrl-C is a stop request while a deadline is in force, so that no state is left
half-written; a second Ctrl-C, or one that is ignored for too long, raises
KeyboardInterrupt.
"""

from __future__ import annotations

import _thread
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from types import FrameType

# A request that is ignored for this long becomes a KeyboardInterrupt [s].
PATIENCE = 2.0
# Period at which another process is polled for a stop request [s].
POLL_PERIOD = 0.05
# Most evaluations of the dynamics for one start: some seconds for a small arm.
EVALUATIONS = 300_000


class Stop(BaseException):
    """Ends a computation. It never reaches callers of the library.

    Attributes:
        requested: Whether the stop was requested; otherwise the time is used up.
        prevented: The computation that it has ended, in a clause, if that is done only
            once and kept planning from its start.
    """

    prevented = ""

    def __init__(self, requested: bool) -> None:
        super().__init__("stop was requested" if requested else "the time is used up")
        self.requested = requested


class Deadline:
    """A deadline and a stop request.

    Args:
        poll: Function that returns whether another process requests a stop.

    Attributes:
        end: Time at which to stop, on the clock of ``time.perf_counter`` [s]; infinite
            without a limit.
        last: Time at which the plan must have returned, its result saved, on the same
            clock [s]; infinite without a limit.
        requested: Whether a stop was requested.
        heeded: Whether the request has been noticed.
    """

    def __init__(self, poll: Callable[[], bool] | None = None) -> None:
        self.end = math.inf
        self.last = math.inf
        self.requested = False
        self.heeded = False
        self._poll = poll
        self._next_poll = 0.0
        self._requested_before = False

    @property
    def due(self) -> bool:
        """Whether it is time to stop."""
        if self.requested:
            self.heeded = True
            return True
        now = time.perf_counter()
        if self._poll is not None and now > self._next_poll:
            self._next_poll = now + POLL_PERIOD
            if self._poll():
                self.requested = self.heeded = True
                return True
        return now > self.end

    @property
    def interrupted(self) -> bool:
        """Whether a stop was requested, also before a grace period began."""
        return self.requested or self._requested_before

    def check(self) -> None:
        """Stop if it is time to stop.

        Raises:
            Stop: If it is time to stop.
        """
        if self.due:
            raise Stop(self.requested)

    @contextmanager
    def in_force(self) -> Iterator[None]:
        """Put this deadline in force; Ctrl-C then requests a stop.

        It does so where it would raise KeyboardInterrupt.
        """
        main = threading.current_thread() is threading.main_thread()
        usual = signal.default_int_handler
        taken = main and signal.getsignal(signal.SIGINT) is usual
        token = _current.set(self)
        try:
            if taken:
                signal.signal(signal.SIGINT, self._interrupted)
            yield
        finally:
            if taken:
                signal.signal(signal.SIGINT, usual)
            self.heeded = True
            _current.reset(token)

    def _interrupted(self, number: int, frame: FrameType | None) -> None:
        """Handle Ctrl-C: the first request is for a stop, the next one interrupts."""
        if not self.request_stop():
            signal.default_int_handler(number, frame)

    @contextmanager
    def grace(self, until: float) -> Iterator[None]:
        """Continue until another deadline, or until a stop is requested once more.

        Args:
            until: The deadline, on the clock of ``time.perf_counter`` [s].
        """
        before = self.end, self.requested, self._poll, self._requested_before
        self._requested_before = self.interrupted
        self.end, self.requested, self._poll = until, False, None
        try:
            yield
        finally:
            end, requested, self._poll, self._requested_before = before
            self.end, self.requested = end, self.requested or requested

    def request_stop(self) -> bool:
        """Request a stop; False if one was requested before."""
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
        """Interrupt code that ignores a request, and repeat the interrupt if needed."""
        if not self.heeded:
            _thread.interrupt_main()
            self._wait()


# In force where no other one is: it never comes.
_NEVER = Deadline()
_current: ContextVar[Deadline] = ContextVar("deadline", default=_NEVER)


def check() -> None:
    """Stop if it is time to stop; cheap enough for any loop.

    Raises:
        Stop: If it is time to stop.
    """
    _current.get().check()


def due() -> bool:
    """Whether it is time to stop."""
    return _current.get().due


def seconds_left() -> float:
    """Time until the deadline, 1 ms at least; infinite without a deadline [s]."""
    return max(_current.get().end - time.perf_counter(), 1e-3)


def seconds_to_end() -> float:
    """Time until the plan must have returned; infinite without a limit [s]."""
    return max(_current.get().last - time.perf_counter(), 0.0)


def request() -> bool:
    """Request a stop of the running computation.

    Returns:
        Whether the request is new: False without a deadline in force, or after an
        earlier request.
    """
    deadline = _current.get()
    return deadline is not _NEVER and deadline.request_stop()


@contextmanager
def grace(seconds: float) -> Iterator[None]:
    """Continue for a grace period after the deadline, to save the results."""
    deadline, until = _current.get(), time.perf_counter() + seconds
    with nullcontext() if deadline is _NEVER else deadline.grace(until):
        yield


@contextmanager
def bounded(seconds: float | None) -> Iterator[None]:
    """A stage with a time limit of its own, unless a deadline is in force already."""
    deadline = Deadline()
    if seconds is not None:
        deadline.end = deadline.last = time.perf_counter() + seconds
    with deadline.in_force() if _current.get() is _NEVER else nullcontext():
        yield


class Budget:
    """Work that may be done before the deadline.

    It is measured in evaluations and processor time, not by the clock: results must not
    depend on the load of the machine.

    Args:
        evaluations: Number of states at which the dynamics may be evaluated.
        seconds: Processor time [s].
    """

    def __init__(
        self, evaluations: float = EVALUATIONS, seconds: float = math.inf
    ) -> None:
        self.remaining = evaluations
        self._end = time.process_time() + seconds

    @property
    def spent(self) -> bool:
        """Whether the budget is used up.

        Raises:
            Stop: If it is time to stop the plan.
        """
        check()
        return self.remaining <= 0 or time.process_time() > self._end

    def share(self, evaluations: float) -> Budget:
        """A budget of fewer evaluations, until the same end."""
        share = Budget(min(evaluations, self.remaining))
        share._end = self._end
        return share

    def spend(self, evaluations: int) -> None:
        """Deduct evaluations.

        Raises:
            StopIteration: If the budget is used up.
        """
        self.remaining -= evaluations
        if self.spent:
            raise StopIteration
