"""One line that tells how the planning goes."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.status import Status
from rich.text import Text

from tominpmp.cli.terminal import log_shown

if TYPE_CHECKING:
    from tominpmp.status import IterationRecord

# Lines in a log come this seldom [s].
PERIOD = 3.0
# What takes seconds where the planning cannot tell how it goes: cutting meshes.
LOGGER = "tominpmp.collision.decomposition_cache"


class Progress:
    """Shows the phase and the last iteration while something takes long.

    On a terminal it is a line that changes and disappears at the end. Elsewhere there
    is nothing, or a line every few seconds if wished for.

    Args:
        console: Where to show it.
        quiet: Whether to show nothing at all.
        verbose: Whether to write lines where the console is no terminal.
    """

    def __init__(self, console: Console, *, quiet: bool, verbose: bool) -> None:
        self._console = console
        self._status: Status | None = None
        if console.is_terminal and not quiet:
            self._status = console.status("")
        self._lines = verbose and not quiet and not console.is_terminal
        self._last = time.monotonic()
        self._log = log_shown(LOGGER, lambda record: self.phase(record.getMessage()))

    def __enter__(self) -> Progress:
        """Begin to show."""
        if self._status is not None:
            self._status.start()
            self._log.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Clear the line."""
        if self._status is not None:
            self._log.__exit__(kind, error, trace)
            self._status.stop()

    def phase(self, text: str) -> None:
        """Say what is being done."""
        if self._status is not None:
            self._status.update(Text(text))

    def __call__(self, record: IterationRecord) -> None:
        """Show an iteration."""
        if self._status is not None:
            self._status.update(Text(_progress_text(record)))
        elif self._lines and time.monotonic() - self._last >= PERIOD:
            self._last = time.monotonic()
            self._console.print(_progress_text(record), soft_wrap=True)


def _progress_text(record: IterationRecord) -> str:
    """Say in one line how far an iteration got."""
    start = f"start {record.start + 1}, " if record.start else ""
    return (
        f"planning: {start}iteration {record.iteration}, T {record.duration:.4f} s, "
        f"violation {record.violation:.1e}, {record.seconds:.1f} s"
    )
