"""Terminal output of all commands: errors, warnings, exit codes, a closed pipe."""

from __future__ import annotations

import errno
import logging
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import cache
from io import TextIOWrapper
from typing import TYPE_CHECKING, Any

from tominpmp.exceptions import TominpmpError, TominpmpWarning

if TYPE_CHECKING:
    from rich.console import Console

PLANNED = 0
NO_PLAN = 1
BAD_INPUT = 2
# Exit codes of sysexits.h and shells: a defect, output that cannot be written, Ctrl-C,
# a closed pipe.
DEFECT = 70
UNWRITTEN = 74
INTERRUPTED = 130
CLOSED_PIPE = 141

OUTPUT = "standard output"

# A Python argument with values by joint name, whose flag takes the same values.
_BY_JOINT = re.compile(r"\b([a-z_]+)=\{([^{}]*)\}")
# The argument at fault, at the beginning of a message, and the number of its item.
_FAULTY = re.compile(r"([a-z_.]+)(\[\d+\])?(?=: | is | has )")
# Arguments whose flag has another name.
_RENAMED = {
    "q_start": "--start",
    "v_start": "--start-velocity",
    "a_start": "--start-acceleration",
    "goal.q": "--goal",
    "goal.v": "--goal-velocity",
    "goal.wrap": "--wrap",
    "start": "--start-from",
    "message": "--ros-message",
    "constraints": "--constraint",
    "locked_joints": "--lock",
}
IN_RADIANS = "angles are in radians, not degrees"
_FLAGS = {
    "self_collision=False": "--no-self-collision",
    "limits='datasheet'": "--limits datasheet",
    "kinematic=True": "--kinematic",
    "package_dirs": "--package-dir",
    "max_planning_time": "--max-time",
    "max_iterations": "--max-iterations",
    "(locked_joints)": "(--lock)",
    "in xacro_args": "with --xacro-arg NAME:=VALUE",
    IN_RADIANS: "give radians, or add --degrees",
}


def hold_streams() -> None:
    """Open the null device in place of standard streams that are closed (``2>&-``).

    The next files would get their numbers, and native code would write messages there;
    processes of loky cannot be started without a standard error. Results and exit codes
    do not depend on standard error: what it does not take is left out.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    if sys.stderr is None or isinstance(sys.stderr, TextIOWrapper):
        encoding = getattr(sys.stderr, "encoding", "utf-8")
        raw, lossless = open(2, "wb", closefd=False), "backslashreplace"
        sys.stderr = _Tolerant(raw, encoding, lossless, line_buffering=True)


class _Tolerant(TextIOWrapper):
    """Standard error, without what it does not take: it may be closed or full."""

    def write(self, text: str) -> int:
        with suppress(OSError):
            super().write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            super().flush()


def say(text: str, *, end: str = "\n", err: bool = False) -> None:
    """Write a text to standard output, or to standard error.

    Raises:
        OSError: If standard output cannot be written; names it as its file.
    """
    stream = sys.stderr if err else sys.stdout
    # Names and paths may have characters that the encoding of the stream lacks.
    encoding = getattr(stream, "encoding", None) or "utf-8"
    text = text.encode(encoding, "backslashreplace").decode(encoding)
    try:
        if stream is None:  # the program was started without it: >&-
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        print(text, end=end, file=stream, flush=True)
    except OSError as error:
        error.filename = OUTPUT
        raise


@cache
def error_console() -> Console:
    """Console for progress, warnings and errors.

    All output shares one console, as it has to print warnings above the status line.
    """
    from rich.console import Console

    return Console(stderr=True, markup=False, highlight=False, emoji=False)


def as_command_line_flags(message: str, typed: Collection[str] = ()) -> str:
    """Replace Python arguments in a message by flags of the command line.

    Messages about a scenario file are unchanged: its keys are named as the arguments.

    Args:
        message: The message.
        typed: The words of the command line. An argument at the beginning of the
            message is replaced if its flag is among them.
    """
    if ".toml:" in message:
        return message

    def flag(name: str) -> str:
        return _RENAMED.get(name, f"--{re.sub('[._]', '-', name)}")

    def by_joint(match: re.Match[str]) -> str:
        values = re.sub(r"'([^']*)':\s*", r"\1=", match[2]).replace(", ", ",")
        return f"{flag(match[1])} {values}"

    faulty = _FAULTY.match(message)
    if faulty and any(word.split("=")[0] == flag(faulty[1]) for word in typed):
        message = flag(faulty[1]) + message[faulty.end() :]
    message = _BY_JOINT.sub(by_joint, message)
    if "--degrees" in typed:  # the angles were in degrees
        message = message.replace(f"; {IN_RADIANS}", "")
    for argument, option in _FLAGS.items():
        message = re.sub(rf"(?<![\w.]){re.escape(argument)}(?!\w)", option, message)
    return message


def complain(prefix: str, message: str, typed: Collection[str] = ()) -> None:
    """Write a line like ``error: ...`` to standard error.

    Args:
        prefix: The word before the colon; errors are red, others yellow.
        message: The message, whose arguments of Python are replaced by flags.
        typed: The words of the command line, see :func:`as_command_line_flags`.
    """
    from rich.text import Text

    style = "bold red" if prefix == "error" else "bold yellow"
    text = " ".join(as_command_line_flags(message, typed).split())
    line = Text.assemble((f"{prefix}:", style), " ", text)
    error_console().print(line, soft_wrap=True)


@contextmanager
def guarded(typed: Collection[str] = ()) -> Iterator[None]:
    """Turn exceptions of a command into a line on standard error and an exit code.

    Args:
        typed: The words of the command line; with ``--debug`` tracebacks are shown too.

    Raises:
        SystemExit: With the exit code.
    """
    try:
        with _warnings_shown():
            yield
        if sys.stdout is not None:
            sys.stdout.flush()  # Rich leaves that to the end of the program
    except (BrokenPipeError, SystemExit) as error:
        # Rich raises SystemExit if the pipe is closed while it writes the help.
        _discard_output()
        raise SystemExit(CLOSED_PIPE) from error
    except KeyboardInterrupt as error:
        complain("error", "interrupted")
        raise SystemExit(INTERRUPTED) from error
    except (TominpmpError, OSError) as error:
        message, code = str(error), BAD_INPUT
        if isinstance(error, OSError):
            stream = error.filename or OUTPUT  # Rich, which writes the help, names none
            message = f"{stream}: {error.strerror or error}"
            if stream == OUTPUT:
                _discard_output()
                code = UNWRITTEN
        _explain(message, typed)
        raise SystemExit(code) from error
    except Exception as error:
        hint = "" if "--debug" in typed else "; --debug shows where"
        defect = f"{type(error).__name__}: {error}"
        _explain(f"{defect} (this is a defect of tominpmp{hint})", typed)
        raise SystemExit(DEFECT) from error


def _explain(message: str, typed: Collection[str]) -> None:
    if "--debug" in typed:
        say(traceback.format_exc(), err=True)
    complain("error", message, typed)


@contextmanager
def _warnings_shown() -> Iterator[None]:
    """Show the library's warnings as lines, each once, others as Python does."""
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(
            message: Warning | str, category: type[Warning], *more: Any, **where: Any
        ) -> None:
            if issubclass(category, TominpmpWarning):
                complain("warning", str(message))
            else:
                usual(message, category, *more, **where)

        warnings.simplefilter("default", TominpmpWarning)
        warnings.showwarning = show
        yield


@contextmanager
def log_shown(name: str, show: Callable[[logging.LogRecord], None]) -> Iterator[None]:
    """Pass the records of a logger to a function."""
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


def logged(verbose: bool) -> AbstractContextManager[None]:
    """Show the library's log above the status line if ``verbose``."""

    def show(record: logging.LogRecord) -> None:
        text = f"{record.levelname.lower()}: {record.getMessage()}"
        error_console().print(text, soft_wrap=True)

    return log_shown("tominpmp", show) if verbose else nullcontext()


def _discard_output() -> None:
    """Redirect buffered output to the null device, so that Python's exit is silent."""
    # Python does not flush a stream that is not a file at exit.
    with suppress(OSError, ValueError, AttributeError), open(os.devnull, "wb") as null:
        os.dup2(null.fileno(), sys.stdout.fileno())
