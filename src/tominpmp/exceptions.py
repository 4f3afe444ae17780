"""The exceptions the library raises.

A caller's mistake raises one of these; a plan that cannot be found does not: it is a
:class:`~tominpmp.solution.Solution` with a status and a sentence. Every exception keeps
the offending values as attributes, so that a debugger (or a user interface) need not
parse the message.
"""

from __future__ import annotations

import copyreg
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tominpmp.solution import Solution


class TominpmpError(Exception):
    """Root of all exceptions of this library."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the message and the values, not the arguments they were made from."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class RobotLoadError(TominpmpError):
    """A robot description cannot be read or is incomplete.

    Attributes:
        path: The file in question, if there is one.
    """

    def __init__(self, message: str, path: str | Path | None = None) -> None:
        super().__init__(message)
        self.path = None if path is None else Path(path)


class FrameNotFound(TominpmpError):
    """A frame (link or joint frame) is not part of the robot.

    Attributes:
        name: The name asked for.
        available: The names there are.
    """

    def __init__(self, name: str, available: Sequence[str]) -> None:
        super().__init__(
            f"there is no frame {name!r}; the robot has: {', '.join(available)}"
        )
        self.name = name
        self.available = tuple(available)


class JointNotFound(TominpmpError):
    """A joint is not part of the robot.

    Attributes:
        name: The name asked for.
        available: The names there are.
    """

    def __init__(self, name: str, available: Sequence[str]) -> None:
        super().__init__(
            f"there is no joint {name!r}; the robot has: {', '.join(available)}"
        )
        self.name = name
        self.available = tuple(available)


class SceneError(TominpmpError):
    """An obstacle of a scene is wrong: a name twice, a size that is not positive.

    Attributes:
        obstacle: Name of the obstacle.
    """

    def __init__(self, message: str, obstacle: str | None = None) -> None:
        super().__init__(message)
        self.obstacle = obstacle


class ProblemError(TominpmpError):
    """A planning problem is wrong in itself: a shape, a limit, a start in collision.

    Attributes:
        field: The argument in question, for example ``"q_start"``.
    """

    def __init__(self, message: str, field: str | None = None) -> None:
        super().__init__(message)
        self.field = field


class OptionsError(TominpmpError):
    """An option has a value it cannot have.

    Attributes:
        option: Name of the option.
    """

    def __init__(self, message: str, option: str | None = None) -> None:
        super().__init__(message)
        self.option = option


class SolverNotFound(TominpmpError):
    """The named linear-programming solver is not installed.

    Attributes:
        name: The solver asked for.
        available: The solvers there are.
    """

    def __init__(self, name: str, available: Sequence[str]) -> None:
        super().__init__(
            f"the solver {name!r} is not available; there are: {', '.join(available)}"
        )
        self.name = name
        self.available = tuple(available)


class ScenarioError(TominpmpError):
    """A scenario, scene or trajectory file is wrong.

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


class PlanningFailed(TominpmpError):
    """Raised by :meth:`Solution.raise_if_failed` when no plan was found.

    Attributes:
        solution: The solution, with its status, sentence and best motion.
    """

    def __init__(self, solution: Solution) -> None:
        super().__init__(solution.message)
        self.solution = solution


class TominpmpWarning(UserWarning):
    """Something was mended on the caller's behalf: a start was clamped, say."""
