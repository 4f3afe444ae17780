"""Ctrl-C and SIGTERM: planning ends with what it has found, which is still written."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from tominpmp import stopping

# What a shell says of a process that a signal has ended: this and its number.
SIGNALLED = 128


class Signals:
    """Signals to end that have come.

    The first one asks planning to stop, or waits until what is found is written. While
    there is nothing to save, and for who insists, it is a KeyboardInterrupt.

    Attributes:
        number: The first that came; None if none has.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self._writing = False
        self._insisted = False

    @property
    def code(self) -> int | None:
        """Exit code for the signal that came; None if none has."""
        return None if self.number is None else SIGNALLED + self.number

    def writing(self) -> None:
        """Say that what was found is written from now on."""
        self._writing = True

    def check(self) -> None:
        """End if a signal has come before: loading libraries may swallow the exception.

        Raises:
            KeyboardInterrupt: If one has.
        """
        if self.number is not None:
            raise KeyboardInterrupt

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take a signal."""
        self.number = number if self.number is None else self.number
        if self._writing and not self._insisted:
            self._insisted = True
            return
        if not self._writing and stopping.request():
            return
        raise KeyboardInterrupt


@contextmanager
def heeded_signals() -> Iterator[Signals]:
    """Take Ctrl-C and SIGTERM, unless they are ignored, as a shell does for jobs."""
    signals = Signals()
    former: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                former[number] = signal.signal(number, signals)
    try:
        yield signals
    finally:
        for key, handler in former.items():
            signal.signal(key, handler)
