"""The exceptions the library raises.

A caller's mistake raises one of these; a plan that cannot be found does not: it is a
:class:`~tominpmp.solution.Solution` with a status and a sentence. Every exception keeps
the offending values as attributes, so that a debugger (or a user interface) need not
parse the message.
"""

from __future__ import annotations

import copy
import copyreg
import difflib
import logging
import reprlib
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

LIBRARY = __name__.partition(".")[0]
# Characters of a value that a message shows.
BRIEF = 80
# Characters of a whole message: it may list the joints of a large robot.
LONGEST = 3000

# Looks at the first items only, so that a list of millions costs nothing.
_repr = reprlib.Repr()
_repr.maxlevel, _repr.maxother = 4, 10 * BRIEF
_repr.maxlist = _repr.maxtuple = _repr.maxset = _repr.maxfrozenset = 8
_repr.maxstring = _repr.maxlong = BRIEF

# A library leaves it to the application whether its log is shown.
logging.getLogger(LIBRARY).addHandler(logging.NullHandler())


def shortened(text: str, most: int = BRIEF) -> str:
    """Cut a text that is longer than so many characters."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def brief(value: object, most: int = BRIEF) -> str:
    """Show a value in a message: what ``repr`` gives, on one line, not a long one."""
    try:
        if isinstance(value, str):
            text = repr(value[:most]) if len(value) > most else repr(value)
        else:
            text = " ".join(_repr.repr(value).split())
    except Exception:  # the caller's object may do anything, a long integer does
        text = f"<{type(value).__name__}>"
    return shortened(text, most)


class TominpmpError(Exception):
    """Root of all exceptions of this library."""

    def __init__(self, message: str = "") -> None:
        # What is read from a file may be named in it, and be of any length.
        super().__init__(shortened(message, LONGEST))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the message and the values, not the arguments they were made from."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class RobotLoadError(TominpmpError):
    """A robot description cannot be read or is incomplete.

    Cure: the message names the file, and the joint or mesh that is missing. What a
    file lacks is given to :func:`tominpmp.load_robot` (``effort=``, ``velocity=``,
    ``package_dirs=``).

    Attributes:
        path: The file in question, if there is one.
    """

    def __init__(self, message: str, path: str | Path | None = None) -> None:
        super().__init__(message)
        self.path = None if path is None else Path(path)


def closest(name: object, known: Sequence[str]) -> str:
    """A question after names that are nearly the one given; empty if there are none."""
    if not isinstance(name, str) or len(name) > BRIEF:
        return ""
    lower = {item.lower(): item for item in known}
    found = difflib.get_close_matches(name.lower(), lower, n=2, cutoff=0.6)
    # Many names of frames begin with that of the robot.
    found += [item for item in lower if item.endswith(name.lower()) and name]
    found += [item for item in lower if item.startswith(name.lower()) and name[2:]]
    names = list(dict.fromkeys(lower[item] for item in found))[:2]
    return f" (did you mean {' or '.join(names)}?)" if names else ""


class _NotFound(TominpmpError):
    """Something that was named is not among what there is."""

    _sentence = ""

    def __init__(self, name: str, available: Sequence[str]) -> None:
        near, known = closest(name, available), ", ".join(available)
        super().__init__(self._sentence.format(brief(name), near, known))
        self.name = name
        self.available = tuple(available)


class FrameNotFound(_NotFound):
    """A frame (link or joint frame) is not part of the robot.

    Cure: take one of the names that the message lists; ``tominpmp info`` shows them.

    Attributes:
        name: The name asked for.
        available: The names there are.
    """

    _sentence = "there is no frame {}{}; the robot has: {}"


class JointNotFound(_NotFound):
    """A joint is not part of the robot.

    Cure: take one of the names that the message lists. A joint that is locked, or
    follows another, is none that moves.

    Attributes:
        name: The name asked for.
        available: The names there are.
    """

    _sentence = "there is no joint {}{}; the robot has: {}"


class SceneError(TominpmpError):
    """An obstacle of a scene is wrong: a name twice, a size that is not positive.

    Cure: the message names the obstacle, the value and what was expected.

    Attributes:
        obstacle: Name of the obstacle.
    """

    def __init__(self, message: str, obstacle: str | None = None) -> None:
        super().__init__(message)
        self.obstacle = obstacle


class ProblemError(TominpmpError):
    """A planning problem is wrong in itself: a shape, a limit, a start in collision.

    Cure: the message names the argument, joint or pair of links, the value, and what
    was expected. Of links that touch it says what lets them.

    Attributes:
        field: The argument in question, for example ``"q_start"``.
    """

    def __init__(self, message: str, field: str | None = None) -> None:
        super().__init__(message)
        self.field = field


@contextmanager
def told_of(what: str, field: str | None = None) -> Iterator[None]:
    """Name what is looked at in the errors of this library that arise within this.

    They stay of their class and keep what they know.

    Args:
        what: What it is, which goes before their sentences: "station 2 ('drill')".
        field: Its field, to which a :class:`ProblemError` is then ascribed.

    Raises:
        TominpmpError: What was raised, with the name.
    """
    try:
        yield
    except TominpmpError as error:
        changed = copy.copy(error)
        changed.args = (shortened(f"{what}: {error}", LONGEST),)
        if isinstance(changed, ProblemError) and field is not None:
            inner = (changed.field or "").removeprefix(field).lstrip(".")
            changed.field = f"{field}.{inner}" if inner else field
        raise changed from error


class OptionsError(TominpmpError):
    """An option has a value it cannot have.

    Cure: the message says what was expected; all options are fields of
    :class:`tominpmp.Options`.

    Attributes:
        option: Name of the option.
    """

    def __init__(self, message: str, option: str | None = None) -> None:
        super().__init__(message)
        self.option = option


class SolverNotFound(_NotFound):
    """The named linear-programming solver is not installed.

    Cure: leave ``lp_solver`` at "auto", or install the solver.

    Attributes:
        name: The solver asked for.
        available: The solvers there are.
    """

    _sentence = "the solver {} is not available{}; there are: {}"


class ScenarioError(TominpmpError):
    """A scenario, scene or trajectory file is wrong.

    Cure: mend the key that the message names, in the file that it names.

    Attributes:
        path: The file.
        key: The field in it, if one is to blame.
    """

    def __init__(
        self, message: str, path: str | Path | None = None, key: str | None = None
    ) -> None:
        super().__init__(message)
        self.path = None if path is None else Path(path)
        self.key = key


class MissingDependency(TominpmpError):
    """An optional package is needed for what was asked.

    Cure: the command in the message installs it.

    Attributes:
        package: Name of the package.
        extra: The extra of this library that brings it.
    """

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs the package {package!r}: "
            f"python -m pip install 'tominpmp[{extra}]'"
        )
        self.package = package
        self.extra = extra


@contextmanager
def optional(package: str, extra: str, purpose: str) -> Iterator[None]:
    """Import an optional package within this, where it is needed.

    What it has deprecated itself is nothing that a user could mend.

    Raises:
        MissingDependency: If it is not installed.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            yield
    except ImportError as error:
        raise MissingDependency(package, extra, purpose) from error


class PlanningFailed(TominpmpError):
    """Raised by :meth:`Solution.raise_if_failed` when no plan was found.

    Cure: the message says what no motion kept, by how much and when; the page "Why was
    no motion found?" of the documentation what to try.

    Attributes:
        solution: The :class:`~tominpmp.solution.Solution`, with its status, sentence
            and best motion.
    """

    def __init__(self, solution: Any) -> None:
        super().__init__(solution.message)
        self.solution = solution


class TominpmpWarning(UserWarning):
    """Something was mended on the caller's behalf: a start was clamped, say."""


def warn_caller(message: str) -> None:
    """Warn whoever calls the library, by the line on which that is done.

    Args:
        message: What was mended, in a sentence.
    """
    level, frame = 2, sys._getframe(1)
    # Code that dataclasses generate is in no file; functools keeps cached properties.
    while frame.f_back is not None and (
        str(frame.f_globals.get("__name__")).startswith((f"{LIBRARY}.", "functools"))
        or frame.f_code.co_filename == "<string>"
    ):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, TominpmpWarning, stacklevel=level)
