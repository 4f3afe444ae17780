"""Reading YAML that strangers wrote.

Files come from downloads, so they are read in bounded time and memory and without
building anything but plain values: limits on size, depth and the number of values,
aliases counted as if they were written out, and no tags but those of units. Words mean
what they mean in YAML 1.2: ``1e-5`` is a number, ``on`` and ``no`` are words.

Units are written as the loaders of ROS and of xacro have them, and become SI units:
``!degrees 90``, ``!radians pi/2``, ``!millimeters 5``, and the words ``deg(90)`` and
``rad(pi/2)``.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import yaml

from tominpmp.description.paths import read_bytes as read_bytes
from tominpmp.exceptions import ScenarioError, brief

MAX_BYTES = 64 * 2**20
MAX_VALUES = 4_000_000
MAX_DEPTH = 64

# The parser in C, where PyYAML was built with it, is ten times as fast.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_WORDS = {"": None, "~": None, "null": None, "Null": None, "NULL": None}
_WORDS |= dict.fromkeys(("true", "True", "TRUE"), True)  # type: ignore[arg-type]
_WORDS |= dict.fromkeys(("false", "False", "FALSE"), False)  # type: ignore[arg-type]
_INTEGER = re.compile(r"[-+]?[0-9]{1,100}|0x[0-9a-fA-F]{1,100}|0o[0-7]{1,100}")
_FLOAT = re.compile(
    r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
    r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
)
# Tags that say nothing new; "!" marks a word in quotes.
_CORE_TAG = re.compile(r"tag:yaml\.org,2002:(str|int|float|bool|null|seq|map)|!")
# Tags of xacro and of ROS's loader, with their units in SI units.
UNITS = {"!degrees": math.pi / 180.0, "!radians": 1.0, "!meters": 1.0}
UNITS |= {"!millimeters": 1e-3, "!foot": 0.3048, "!inches": 0.0254}
_ANGLES = {"deg(": "!degrees", "rad(": "!radians"}
# What stands in them is reckoned if it is no longer than this, so takes no time.
LONGEST_EXPRESSION = 200
_OPERATIONS: Any = {ast.Add: operator.add, ast.Sub: operator.sub}
_OPERATIONS |= {ast.Mult: operator.mul, ast.Div: operator.truediv}


def read_yaml(path: Path) -> Any:
    """Read the only document of a YAML file.

    Returns:
        Dictionaries with texts as keys, lists, texts, numbers, truth values and None;
        values that the file repeats by an alias are the same object.

    Raises:
        ScenarioError: If the file cannot be read, is no YAML, is too large or nests too
            deep, has a tag that is no unit, or names a key twice.
    """
    return parse_yaml(read_bytes(path, MAX_BYTES), path)


def parse_yaml(content: bytes, path: Path) -> Any:
    """Parse YAML with limits and without tags; see :func:`read_yaml`."""
    builder = _Builder(path)
    try:
        for event in yaml.parse(content, Loader=_LOADER):
            builder.take(event)
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())[:300]
        raise ScenarioError(f"{path} is no YAML: {reason}", path) from error
    except (UnicodeError, ValueError, RecursionError) as error:
        raise ScenarioError(f"{path} is no YAML: {error}", path) from error
    return builder.result


@dataclass
class _Open:
    """A list or mapping whose end has not been read."""

    value: list[Any] | dict[str, Any]
    anchor: str | None
    start: int
    key: str | None = None


@dataclass
class _Builder:
    """Builds plain values from the events of the parser, without recursion."""

    path: Path
    result: Any = None
    documents: int = 0
    count: int = 0
    stack: list[_Open] = field(default_factory=list)
    anchors: dict[str, tuple[Any, int]] = field(default_factory=dict)

    def fail(self, message: str, mark: Any) -> NoReturn:
        raise ScenarioError(f"{self.path}, line {mark.line + 1}: {message}", self.path)

    def take(self, event: Any) -> None:
        mark = event.start_mark
        if isinstance(event, yaml.DocumentStartEvent):
            self.documents += 1
        elif self.documents > 1 and _is_content(event):
            self.fail("a second document begins, expected a single one", mark)
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor not in self.anchors:
                self.fail(f"nothing is named {brief(event.anchor)} before it", mark)
            value, size = self.anchors[event.anchor]
            self._add(value, size, mark)
        elif isinstance(event, yaml.ScalarEvent):
            if event.tag not in UNITS:
                self._check_tag(event.tag, mark)
            # The parser in C has no style where the other has None.
            plain = not event.style and event.tag is None
            value = _plain(event.value) if plain else event.value
            if event.tag in UNITS:
                value = _in_unit(event.value, event.tag)
                if value is None:
                    word = f"{event.tag} {brief(event.value)}"
                    self.fail(f"{word}: expected a number, as 90 or pi/2", mark)
            if event.anchor:
                self.anchors[event.anchor] = value, 1
            is_key = self.stack and self._awaits_key()
            self._add(event.value if is_key else value, 1, mark)
        elif isinstance(event, yaml.SequenceStartEvent | yaml.MappingStartEvent):
            self._check_tag(event.tag, mark)
            if len(self.stack) >= MAX_DEPTH:
                self.fail(f"values nest deeper than {MAX_DEPTH}", mark)
            if self.stack and self._awaits_key():
                self.fail("a key is no single word", mark)
            empty: Any = [] if isinstance(event, yaml.SequenceStartEvent) else {}
            self.stack.append(_Open(empty, event.anchor, self.count))
        elif isinstance(event, yaml.SequenceEndEvent | yaml.MappingEndEvent):
            done = self.stack.pop()
            size = self.count - done.start + 1
            if done.anchor:
                self.anchors[done.anchor] = done.value, size
            self._add(done.value, 1, mark)

    def _check_tag(self, tag: str | None, mark: Any) -> None:
        if tag is not None and not _CORE_TAG.fullmatch(tag):
            known = f"plain values only, and {', '.join(UNITS)} with a number"
            self.fail(f"the tag {tag[:80]!r} is refused: {known}", mark)

    def _awaits_key(self) -> bool:
        top = self.stack[-1]
        return isinstance(top.value, dict) and top.key is None

    def _add(self, value: Any, size: int, mark: Any) -> None:
        self.count += size
        if self.count > MAX_VALUES:
            self.fail(f"it holds more than {MAX_VALUES} values", mark)
        if not self.stack:
            if self.documents == 1:
                self.result = value
            return
        top = self.stack[-1]
        if isinstance(top.value, list):
            top.value.append(value)
        elif top.key is None:
            if not isinstance(value, str):
                self.fail("a key is no single word", mark)
            if value in top.value:
                self.fail(f"the key {value[:80]!r} is there twice", mark)
            top.key = value
        else:
            top.value[top.key] = value
            top.key = None


def _is_content(event: Any) -> bool:
    """Whether there is anything in a document: ROS ends messages with ``---``."""
    if isinstance(event, yaml.ScalarEvent):
        return bool(event.value)
    return isinstance(event, yaml.AliasEvent | yaml.CollectionStartEvent)


def _plain(word: str) -> Any:
    """What a word without quotes means."""
    if word in _WORDS:
        return _WORDS[word]
    if _INTEGER.fullmatch(word):
        # Leading zeros are decimal in YAML 1.2; Python refuses them without a base.
        base = {"0x": 16, "0o": 8}.get(word[:2], 10)
        return int(word, base)
    if len(word) <= 400 and _FLOAT.fullmatch(word):
        return float(word.replace(".inf", "inf").replace(".nan", "nan").lower())
    unit = _ANGLES.get(word[:4]) if word.endswith(")") else None
    value = None if unit is None else _in_unit(word[4:-1], unit)
    return word if value is None else value


def _in_unit(text: str, unit: str) -> float | None:
    """A number with a unit in SI units; None if it is none."""
    if len(text) > LONGEST_EXPRESSION:
        return None
    try:
        return UNITS[unit] * _reckoned(ast.parse(text.strip(), mode="eval").body)
    except (SyntaxError, ValueError, TypeError, ArithmeticError, RecursionError):
        return None


def _reckoned(node: ast.AST) -> float:
    """Value of an expression of numbers, pi and the four operations."""
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(
            number, bool
        ):
            return float(number)
        case ast.Name(id="pi"):
            return math.pi
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -_reckoned(inner)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATIONS:
            value: float = _OPERATIONS[type(op)](_reckoned(left), _reckoned(right))
            return value
    raise ValueError("no number")
