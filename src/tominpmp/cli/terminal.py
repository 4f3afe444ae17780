"""What all commands have in common: errors, warnings, exit codes, a closed pipe."""

from __future__ import annotations

import logging
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from typing import TYPE_CHECKING, Any

from tominpmp.exceptions import TominpmpError, TominpmpWarning

if TYPE_CHECKING:
    from rich.console import Console

PLANNED = 0
NO_PLAN = 1
BAD_INPUT = 2
# As sysexits.h and shells have them: a defect, Ctrl-C, a reader that went away.
DEFECT = 70
INTERRUPTED = 130
CLOSED_PIPE = 141

# Arguments that take values by joint name, and are flags that do.
_BY_JOINT = re.compile(
    r"\b(effort|velocity|position_lower|position_upper|damping|armature|friction"
    r"|acceleration)=\{([^{}]*)\}"
)
_WORDS = {
    "self_collision=False": "--no-self-collision",
    "limits='datasheet'": "--limits datasheet",
    "kinematic=True": "--kinematic",
    "package_dirs": "--package-dir",
    "in xacro_args": "with --xacro-arg NAME:=VALUE",
}


def say(text: str, *, err: bool = False) -> None:
    """Write a text to standard output, or to standard error."""
    print(text, file=sys.stderr if err else sys.stdout, flush=True)


@cache
def error_console() -> Console:
    """Console for progress, warnings and errors.

    There is one only, as it has to write a warning above the line of progress.
    """
    from rich.console import Console

    return Console(stderr=True, markup=False, highlight=False, emoji=False)


def in_own_words(message: str) -> str:
    """A message with flags in the place of arguments of Python.

    What is said of a scenario file stays as it is: there they are keys.
    """
    if ".toml:" in message:
        return message

    def flag(found: re.Match[str]) -> str:
        values = re.sub(r"'([^']*)':\s*", r"\1=", found[2]).replace(", ", ",")
        return f"--{found[1].replace('_', '-')} {values}"

    message = _BY_JOINT.sub(flag, message)
    for words, own in _WORDS.items():
        message = re.sub(rf"(?<![\w.]){re.escape(words)}(?!\w)", own, message)
    return message


def complain(prefix: str, message: str, style: str = "bold red") -> None:
    """Write a line like ``error: ...`` to standard error."""
    from rich.text import Text

    said = " ".join(in_own_words(message).split())
    line = Text.assemble((f"{prefix}:", style), " ", said)
    error_console().print(line, soft_wrap=True)


@contextmanager
def guarded(debug: bool = False) -> Iterator[None]:
    """Turn what goes wrong in a command, or with what was typed, into an exit code.

    Args:
        debug: Whether to show tracebacks too.

    Raises:
        SystemExit: With the exit code, after a line that says what is wrong.
    """
    try:
        with _warnings_shown():
            yield
    except (BrokenPipeError, SystemExit) as error:
        # With the latter Rich ends when nobody reads the help that it writes.
        _discard_output()
        raise SystemExit(CLOSED_PIPE) from error
    except KeyboardInterrupt as error:
        complain("error", "interrupted")
        raise SystemExit(INTERRUPTED) from error
    except (TominpmpError, OSError) as error:
        said = str(error)
        if isinstance(error, OSError):
            where = "" if error.filename is None else f"{error.filename}: "
            said = f"{where}{error.strerror or error}"
        _explain(said, debug)
        raise SystemExit(BAD_INPUT) from error
    except Exception as error:
        hint = "" if debug else "; --debug shows where"
        what = f"{type(error).__name__}: {error}"
        _explain(f"{what} (this is a defect of tominpmp{hint})", debug)
        raise SystemExit(DEFECT) from error


def _explain(message: str, debug: bool) -> None:
    if debug:
        traceback.print_exc()
    complain("error", message)


@contextmanager
def _warnings_shown() -> Iterator[None]:
    """Show the library's warnings as lines, others as Python does."""
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(
            message: Warning | str, category: type[Warning], *more: Any, **where: Any
        ) -> None:
            if issubclass(category, TominpmpWarning):
                complain("warning", str(message), "bold yellow")
            else:
                usual(message, category, *more, **where)

        warnings.simplefilter("always", TominpmpWarning)
        warnings.showwarning = show
        yield


@contextmanager
def log_shown(name: str, show: Callable[[logging.LogRecord], None]) -> Iterator[None]:
    """Show what a logger is given."""
    logger, handler = logging.getLogger(name), logging.Handler(logging.INFO)
    handler.emit = show  # type: ignore[assignment, method-assign]
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)


def logged(verbose: bool, console: Console) -> AbstractContextManager[None]:
    """Show the library's log above a line that changes, if wished for."""

    def show(record: logging.LogRecord) -> None:
        text = f"{record.levelname.lower()}: {record.getMessage()}"
        console.print(text, soft_wrap=True)

    return log_shown("tominpmp", show) if verbose else nullcontext()


def flush_output(code: int = 0) -> int:
    """Write what is still buffered.

    Args:
        code: The exit code so far. An output that could not be written may have been
            complained of as an error: what is left of it is not, once more.

    Returns:
        The exit code.
    """
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        _discard_output()
        if isinstance(error, BrokenPipeError):
            return CLOSED_PIPE
        if code != BAD_INPUT:
            complain("error", f"standard output: {error.strerror}")
        return BAD_INPUT
    return code


def _discard_output() -> None:
    """Send what is still buffered nowhere, as Python would complain at its end."""
    try:
        target = sys.stdout.fileno()
    except (OSError, ValueError, AttributeError):
        return  # not a file: nothing is written at the end
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, target)
    os.close(nowhere)
