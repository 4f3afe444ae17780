"""Access to the values of a parsed file, with errors that name the file and the key."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NoReturn

import numpy as np

import tominpmp.checks as checks
from tominpmp.arrays import Array
from tominpmp.exceptions import ScenarioError, TominpmpError, closest, shortened

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib  # type: ignore[no-redef, import-not-found, unused-ignore]

# Longest number in TOML; parsing a longer one takes a hundred times the memory of the
# file.
MAX_DIGITS = 5000


@dataclass(frozen=True)
class Field:
    """A value in a file, with its location.

    Attributes:
        value: The value: dictionary, list, text, number, truth value or None.
        path: The file.
        key: Location of the value in the file, for example ``goal.position[2]``; empty
            for the whole document.
    """

    value: Any
    path: Path
    key: str = ""

    # What may stand before the name of the field in messages: "segment.dwell is".
    _owner: ClassVar[str] = r"\w+\."

    def fail(self, message: str) -> NoReturn:
        """Raise an error about this value.

        Raises:
            ScenarioError: Always.
        """
        key = f"{shortened(self.key)}: " if self.key else ""
        # The message may begin with names of the value, and of the tables around it.
        names = self.key.split(".")
        paths = [".".join(names[k:]) for k in range(len(names))]
        repeated = [f"{name}: " for name in (*names, *paths)]
        # A name without a point may be a word of the message.
        repeated += [f"{path} " for path in paths if "." in path]
        for beginning in repeated:
            message = message.removeprefix(beginning)
        text = f"{self.path}: {key}{self._unnamed(message)}"
        raise ScenarioError(text, self.path, self.key or None)

    def _unnamed(self, message: str) -> str:
        """A message without the name of the field in which the key ends: "v is"."""
        name = re.escape(self.key.rpartition(".")[2])
        return re.sub(rf"^({self._owner})?{name} (?=is |in collision)", "", message)

    def blame(self, error: TominpmpError) -> NoReturn:
        """Raise an error of the library again as an error about this value.

        Raises:
            ScenarioError: Always.
        """
        self.fail(str(error))

    def _expected(self, expected: str) -> NoReturn:
        shown = "empty" if self.value is None else shortened(repr(self.value))
        self.fail(f"is {shown}, expected {expected}")

    @property
    def given(self) -> bool:
        """Whether there is a value: neither missing nor None nor empty."""
        return self.value is not None and self.value not in ("", [], {})

    @property
    def is_filled_in(self) -> bool:
        """Whether the value differs from the defaults of a ROS message."""
        if isinstance(self.value, dict | list):
            listed = isinstance(self.value, list)
            inner = self.items() if listed else self.table().values()
            return any(item.is_filled_in for item in inner)
        return self.value not in (None, "", 0, False)

    def get(self, name: str) -> Field:
        """Value of a key of a table; its value is None if the key is missing."""
        table = {} if self.value is None else self.value
        if not isinstance(table, dict):
            self._expected("a table of keys and values")
        key = f"{self.key}.{name}" if self.key else name
        return replace(self, value=table.get(name), key=key)

    def need(self, name: str) -> Field:
        """Value of a required key."""
        item = self.get(name)
        if item.value is None:
            item.fail("is missing")
        return item

    def table(self) -> dict[str, Field]:
        """Values of a table by key."""
        if not isinstance(self.value, dict):
            self._expected("a table of keys and values")
        return {name: self.get(name) for name in self.value}

    def only(self, *names: str) -> None:
        """Refuse keys of a table other than these."""
        for name, item in self.table().items():
            if name not in names:
                hint = closest(name, names)
                item.fail(f"there is no such key{hint}; there are: {', '.join(names)}")

    def items(self) -> Iterator[Field]:
        """Values of a list; empty if the list is missing."""
        values = [] if self.value is None else self.value
        if not isinstance(values, list):
            self._expected("a list")
        for index, value in enumerate(values):
            yield replace(self, value=value, key=f"{self.key}[{index}]")

    def text(self) -> str:
        """Text that must not be empty."""
        if not isinstance(self.value, str) or not self.value:
            self._expected("a text")
        return self.value

    def flag(self) -> bool:
        """Truth value."""
        if not isinstance(self.value, bool):
            self._expected("true or false")
        return self.value

    def number(
        self,
        expected: str = "a finite number",
        *,
        default: float | None = None,
        **bounds: Any,
    ) -> float:
        """Number in a range, of 1e150 at most unless infinite ones are allowed.

        Args:
            expected: Description of valid numbers, for messages.
            default: Number for a missing value; None if the value is required.
            **bounds: The range, as of :func:`~tominpmp.checks.number`.
        """
        if self.value is None and default is not None:
            return default
        try:
            return checks.number(self.value, self.key, expected, **bounds)
        except TominpmpError as error:
            self.fail(str(error))

    def numbers(self, count: int | None = None) -> list[float]:
        """List of finite numbers, of a given length if ``count`` is set."""
        values = self.value
        if not isinstance(values, list) or count not in (None, len(values)):
            self._expected("numbers" if count is None else f"{count} numbers")
        return [item.number() for item in self.items()]

    def vector(self, names: str) -> Array:
        """Numbers as a list, or by a letter each: ``[1, 2, 3]`` or ``{x: 1, ...}``.

        Returns:
            The numbers, in the order of the letters, shape (len(names),).
        """
        if isinstance(self.value, dict):
            return np.array([self.need(name).number() for name in names])
        return np.array(self.numbers(len(names)))


def parse_toml(content: bytes, path: Path) -> Field:
    """Parse the content of a TOML file.

    Args:
        content: The content.
        path: The file; paths in it are relative to its folder.

    Raises:
        ScenarioError: If the content is not TOML.
    """
    if re.search(rb"[0-9_]{%d}" % MAX_DIGITS, content):
        raise ScenarioError(f"{path} holds a number of {MAX_DIGITS} digits", path)
    try:
        return Field(tomllib.loads(content.decode("utf-8-sig")), path)
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{path} is not TOML: {error}", path) from error
