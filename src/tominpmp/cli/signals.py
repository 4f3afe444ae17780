"""Ctrl-C, SIGTERM and SIGHUP: planning ends with its incumbent, which is written."""

from __future__ import annotations

import os
import signal
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from tominpmp import stopping

TYPE_CHECKING = False  # typing takes long to import
if TYPE_CHECKING:
    from types import FrameType
    from typing import Any

# Exit code of a process that a signal has ended, less the number of the signal.
SIGNALLED = 128
# The terminal was closed; None on Windows, which has no such signal.
HANGUP = getattr(signal, "SIGHUP", None)
# Clears the line of progress, and shows the cursor.
CLEARED = b"\r\x1b[K\x1b[?25h"


class Signals:
    """Handler of signals to end, which keeps the signals received.

    The first signal requests a stop of planning, or is deferred while results are
    written.
    If there is nothing to save, and from the second signal on, it raises a
    KeyboardInterrupt.

    Attributes:
        number: Number of the first signal; None before any.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self._writing = False
        self._insisted = False

    def writing(self) -> None:
        """Declare that results are written from now on."""
        self._writing = True

    def check(self) -> None:
        """Raise if a signal was received, as native code may swallow the exception.

        Raises:
            KeyboardInterrupt: If a signal was received.
        """
        if self.number is not None:
            raise KeyboardInterrupt

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        if number == HANGUP:
            _leave_closed_terminal()
        self.number = number if self.number is None else self.number
        if self._writing and not self._insisted:
            self._insisted = True
            return
        if not self._writing and stopping.request():
            return
        if not stopping.due() and _importing(frame):
            end_at_once(self.number, frame)
        raise KeyboardInterrupt


def _leave_closed_terminal() -> None:
    """Redirect output to a closed terminal to the null device.

    Writing to the terminal, be it to clear a line of progress, would fail.
    """
    for stream in (1, 2):
        with suppress(OSError):
            device = stat.S_ISCHR(os.fstat(stream).st_mode)
            if device and not os.isatty(stream):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream)


def end_at_once(number: int, frame: FrameType | None) -> None:
    """End the process at once on a signal, while there is nothing to save.

    An exception raised during an import would be lost in native code, or be printed by
    the importing module.
    """
    cleared = CLEARED if os.isatty(2) else b""
    try:
        os.write(2, cleared + b"error: interrupted\n")
    finally:
        os._exit(SIGNALLED + number)


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def take(handler: Callable[[int, FrameType | None], None]) -> dict[int, Any]:
    """Install a handler for Ctrl-C, SIGTERM and SIGHUP, unless they are ignored.

    A shell lets background jobs ignore them, and ``nohup`` the last one.

    Returns:
        The former handlers by the numbers of the signals.
    """
    former: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in filter(None, (signal.SIGINT, signal.SIGTERM, HANGUP)):
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                former[number] = signal.signal(number, handler)
    return former


_present = Signals()


def present() -> Signals:
    """The signals that the running command has received."""
    return _present


@contextmanager
def heeded_signals() -> Iterator[Signals]:
    """Context manager that handles signals during a command."""
    global _present
    before, _present = _present, Signals()
    former = take(_present)
    try:
        yield _present
    finally:
        for key, handler in former.items():
            signal.signal(key, handler)
        _present = before
