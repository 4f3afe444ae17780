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
from typing import Any, NoReturn

LIBRARY = __name__.partition(".")[0]
# Longest text of a value in a message [characters].
BRIEF = 80
# Longest message [characters]: it may list the joints of a large robot.
LONGEST = 3000

# Beginnings of the names of modules whose calls are not the user's.
OWN_CALLS = (f"{LIBRARY}.", "functools", "contextlib")
# Largest number of faults that a message names.
MOST_NAMED = 5


class _Repr(reprlib.Repr):
    """Formats only the first items, so that a list of millions costs nothing."""

    def repr1(self, x: object, level: int) -> str:
        """Show a number of NumPy as a plain number: 1.5, not np.float64(1.5)."""
        numpy = sys.modules.get("numpy")  # not imported for messages alone
        plain = x.item() if numpy and isinstance(x, numpy.generic) else x
        return super().repr1(plain, level)


_repr = _Repr()
_repr.maxlevel, _repr.maxother = 4, 10 * BRIEF
_repr.maxlist = _repr.maxtuple = _repr.maxset = _repr.maxfrozenset = 8
_repr.maxstring = _repr.maxlong = BRIEF

# The application decides whether the log of a library is shown.
logging.getLogger(LIBRARY).addHandler(logging.NullHandler())


def shortened(text: str, most: int = BRIEF) -> str:
    """Cut a text that has more than ``most`` characters."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def enumerated(items: Sequence[object], most: int = MOST_NAMED) -> str:
    """The first items in words, and the number of the others."""
    rest = f"; and {len(items) - most} more" if len(items) > most else ""
    return "; ".join(map(str, items[:most])) + rest


def counted(number: int, noun: str) -> str:
    """A number with its noun: "1 joint", "3 joints"."""
    return f"{number} {noun}{'s' * (number != 1)}"


def brief(value: object, most: int = BRIEF) -> str:
    """Show a value in a message: its ``repr`` on one line, cut to the given length."""
    try:
        if isinstance(value, str):
            text = repr(str(value[:most]))
        else:
            text = " ".join(_repr.repr(value).split())
    except Exception:  # a foreign __repr__ may raise anything, huge integers do
        text = f"<{type(value).__name__}>"
    return shortened(text, most)


class TominpmpError(Exception):
    """Root of all exceptions of this library."""

    def __init__(self, message: str = "") -> None:
        # A message may quote text from a file, which may be of any length.
        super().__init__(shortened(message, LONGEST))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the message and the attributes, not arguments of the constructor."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class RobotLoadError(TominpmpError):
    """A robot description cannot be read or is incomplete.

    Cure: the message names the file, and the joint or mesh that is missing. Values that
    a file lacks can be passed to :func:`tominpmp.load_robot` (``effort=``,
    ``velocity=``, ``package_dirs=``).

    Attributes:
        path: The file in question, if there is one.
    """

    def __init__(self, message: str, path: str | Path | None = None) -> None:
        super().__init__(message)
        self.path = None if path is None else Path(path)


def fail_to_load(path: Path, message: str) -> NoReturn:
    """Raise an error about the file of a robot description.

    Raises:
        RobotLoadError: Always.
    """
    raise RobotLoadError(f"{path}: {message}", path)


def closest(name: object, known: Sequence[str]) -> str:
    """Question whether a similar known name was meant; empty if none is similar."""
    if not isinstance(name, str) or len(name) > BRIEF:
        return ""
    lower = {item.lower(): item for item in known}
    matches = difflib.get_close_matches(name.lower(), lower, n=2, cutoff=0.6)
    # Frame names often begin with the name of the robot.
    matches += [item for item in lower if item.endswith(name.lower()) and name]
    matches += [item for item in lower if item.startswith(name.lower()) and name[2:]]
    names = list(dict.fromkeys(lower[item] for item in matches))[:2]
    return f" (did you mean {' or '.join(names)}?)" if names else ""


def unknown(
    noun: str, name: object, known: Sequence[str], owner: str = "there are"
) -> str:
    """Message on a name that is not known, with similar names and all known ones.

    Args:
        noun: Kind of the named thing: "joint".
        name: The name.
        known: The known names.
        owner: What has the known names: "the robot has".
    """
    listed = ", ".join(known) or "none"
    return f"there is no {noun} {brief(name)}{closest(name, known)}; {owner}: {listed}"


class _NotFound(TominpmpError):
    """A name is not among the available ones."""

    _noun, _owner = "", "the robot has"

    def __init__(self, name: str, available: Sequence[str], field: str = "") -> None:
        message = unknown(self._noun, name, available, self._owner)
        super().__init__(f"{field}: {message}" if field else message)
        self.name = name
        self.available = tuple(available)
        self.field = field


class FrameNotFound(_NotFound):
    """A frame (link or joint frame) is not part of the robot.

    Cure: take one of the names that the message lists; ``tominpmp info`` shows them.

    Attributes:
        name: The unknown name.
        available: The known names.
        field: The argument that has the name; empty if it is not known.
    """

    _noun = "frame"


class JointNotFound(_NotFound):
    """A joint is not part of the robot.

    Cure: take one of the names that the message lists. A joint that is locked, or
        follows another (mimic), does not count as a joint that moves.

    Attributes:
        name: The unknown name.
        available: The known names.
        field: The argument that has the name; empty if it is not known.
    """

    _noun = "joint"


class SceneError(TominpmpError):
    """An obstacle of a scene is invalid: a repeated name, a size that is not positive.

    Cure: the message names the obstacle, the value and the expected one.

    Attributes:
        obstacle: Name of the obstacle.
    """

    def __init__(self, message: str, obstacle: str | None = None) -> None:
        super().__init__(message)
        self.obstacle = obstacle


class ProblemError(TominpmpError):
    """A planning problem is invalid: a wrong shape or limit, a start in collision.

    Cure: the message names the argument, joint or pair of links, the value, and the
        expected one. For links that touch, it names the ways of allowing the contact.

    Attributes:
        field: The argument in question, for example ``"q_start"``.
    """

    def __init__(self, message: str, field: str | None = None) -> None:
        super().__init__(message)
        self.field = field


@contextmanager
def naming(subject: str, field: str | None = None) -> Iterator[None]:
    """Prefix the errors of this library that arise within this block with a subject.

    They keep their class and their attributes.

    Args:
        subject: Subject, which goes before their messages: "station 2 ('drill')".
        field: Field of the subject, to which a :class:`ProblemError` or an unknown name
            is then ascribed.

    Raises:
        TominpmpError: The error that was raised, with the prefix.
    """
    try:
        yield
    except TominpmpError as error:
        changed = copy.copy(error)
        changed.args = (shortened(f"{subject}: {error}", LONGEST),)
        if isinstance(changed, ProblemError | _NotFound) and field is not None:
            inner = (changed.field or "").removeprefix(field).lstrip(".")
            changed.field = f"{field}.{inner}" if inner else field
        raise changed from error


class OptionsError(TominpmpError):
    """An option has an invalid value.

    Cure: the message describes valid values; all options are fields of
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
        name: Name of the missing solver.
        available: Names of the installed solvers.
        field: Empty: only ``lp_solver`` names a solver.
    """

    _noun, _owner = "solver", "there are"


class ScenarioError(TominpmpError):
    """A file of a scenario, scene, motion or limits is invalid, or cannot be written.

    Cure: correct the key that the message names, in the file that it names.

    Attributes:
        path: The file.
        key: The key in it that is invalid, if the error concerns a single key.
    """

    def __init__(
        self, message: str, path: str | Path | None = None, key: str | None = None
    ) -> None:
        super().__init__(message)
        self.path = None if path is None else Path(path)
        self.key = key


class MissingDependency(TominpmpError):
    """An optional package is needed but not installed.

    Cure: the command in the message installs it.

    Attributes:
        package: Name of the package.
        extra: The extra of this library that installs it.
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
    """Import an optional package within this block, at the place of its use.

    Deprecation warnings of its own code are suppressed: users cannot act on them.

    Raises:
        MissingDependency: If it is not installed.
    """
    try:
        with quiet(DeprecationWarning):
            yield
    except ImportError as error:
        raise MissingDependency(package, extra, purpose) from error


class PlanningFailed(TominpmpError):
    """Raised by ``raise_if_failed`` of a solution or a tour when planning failed.

    Cure: the message names the constraint that no motion kept, with the violation and
    its time; the page "Why was no motion found?" of the documentation lists remedies.

    Attributes:
        solution: The :class:`~tominpmp.solution.Solution`, with its status, message and
            best motion, or the :class:`~tominpmp.Tour`.
    """

    def __init__(self, solution: Any) -> None:
        super().__init__(solution.message)
        self.solution = solution


class TominpmpWarning(UserWarning):
    """Input was corrected, left out or looks like a mistake, or a file does not pass.

    Examples are a start that was clamped, and keys of a file that are not read.
    """


@contextmanager
def quiet(category: type[Warning] = TominpmpWarning) -> Iterator[None]:
    """Suppress warnings within this block, by default those of this library only."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield


def warn_caller(message: str) -> None:
    """Warn the user's code, with the line on which it calls the library.

    Args:
        message: The correction or the fault, in a sentence.
    """
    level, frame = 2, sys._getframe(1)
    # Code that dataclasses generate has no file; functools calls cached properties, and
    # contextlib functions with a decorator.
    while frame.f_back is not None and (
        str(frame.f_globals.get("__name__")).startswith(OWN_CALLS)
        or frame.f_code.co_filename == "<string>"
    ):
        level, frame = level + 1, frame.f_back
    warnings.warn(shortened(message, LONGEST), TominpmpWarning, stacklevel=level)
