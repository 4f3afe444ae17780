"""Reading YAML from untrusted sources.

Files may be downloads, so they are read in bounded time and memory, and only plain
values are built: with limits on size, depth and the number of values, where aliases
count as if written out, and without tags other than units. Plain scalars follow YAML
1.2: ``1e-5`` is a number, ``on`` and ``no`` are texts. As in YAML 1.1, the key ``<<``
merges a table, or a list of tables of which the first takes precedence, into the table
around it, whose own keys take precedence.

Units have the notation of the loaders of ROS and of xacro, and are converted to SI
units: ``!degrees 90``, ``!radians pi/2``, ``!millimeters 5``, and the scalars
``deg(90)`` and ``rad(pi/2)``.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import yaml

from tominpmp.description.paths import read_bytes
from tominpmp.exceptions import ScenarioError, brief

MAX_BYTES = 64 * 2**20
MAX_VALUES = 4_000_000
MAX_DEPTH = 64

# The parser in C, if PyYAML was built with it, is ten times as fast.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_WORDS = {"": None, "~": None, "null": None, "Null": None, "NULL": None}
_WORDS |= dict.fromkeys(("true", "True", "TRUE"), True)  # type: ignore[arg-type]
_WORDS |= dict.fromkeys(("false", "False", "FALSE"), False)  # type: ignore[arg-type]
_INTEGER = re.compile(r"[-+]?[0-9]{1,100}|0x[0-9a-fA-F]{1,100}|0o[0-7]{1,100}")
_FLOAT = re.compile(
    r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
    r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
)
# Redundant tags, which are accepted; "!" marks a quoted scalar.
_CORE_TAG = re.compile(r"tag:yaml\.org,2002:(str|int|float|bool|null|seq|map)|!")
# Key of the tables that are merged into the table around it.
MERGE = "<<"
# Factors to SI units by the tags of xacro and of ROS's loader.
UNITS = {"!degrees": math.pi / 180.0, "!radians": 1.0, "!meters": 1.0}
UNITS |= {"!millimeters": 1e-3, "!foot": 0.3048, "!inches": 0.0254}
_ANGLES = {"deg(": "!degrees", "rad(": "!radians"}
# Longest expression with a unit that is evaluated, which bounds the time.
LONGEST_EXPRESSION = 200
_OPERATIONS: Any = {ast.Add: operator.add, ast.Sub: operator.sub}
_OPERATIONS |= {ast.Mult: operator.mul, ast.Div: operator.truediv}


def read_yaml(path: Path) -> Any:
    """Read the only document of a YAML file.

    Returns:
        Dictionaries with texts as keys, lists, texts, numbers, truth values and None;
        values that the file repeats by an alias are the same object.

    Raises:
        ScenarioError: If the file cannot be read, is not YAML, is too large or nested
            too deeply, has a tag that is not a unit, or repeats a key.
    """
    return parse_yaml(read_bytes(path, MAX_BYTES), path)


def parse_yaml(content: bytes, path: Path) -> Any:
    """Parse YAML with limits and without tags; see :func:`read_yaml`."""
    try:
        return _Builder(content, path).document()
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        # The parser calls bytes by this name where it gives their line.
        reason = " ".join(str(error).replace('"<byte string>", ', "").split())[:300]
        raise ScenarioError(f"{path} is not YAML: {reason}", path) from error


class _Builder:
    """Builds plain values from the events of the parser."""

    def __init__(self, content: bytes, path: Path) -> None:
        self.events: Iterator[Any] = yaml.parse(content, Loader=_LOADER)
        self.path, self.count = path, 0
        #: Values by anchor, with the number of values inside each.
        self.anchors: dict[str, tuple[Any, int]] = {}

    def fail(self, message: str, event: Any) -> NoReturn:
        line = event.start_mark.line + 1
        raise ScenarioError(f"{self.path}, line {line}: {message}", self.path)

    def document(self) -> Any:
        """The only document; an empty one may follow, as in messages printed by ROS."""
        result, documents = None, 0
        for event in self.events:
            documents += isinstance(event, yaml.DocumentStartEvent)
            if not isinstance(event, yaml.NodeEvent):
                continue
            if documents == 1:
                result = self._value(event, 0)
            elif not isinstance(event, yaml.ScalarEvent) or event.value:
                self.fail("a second document begins, expected a single one", event)
        return result

    def _value(self, event: Any, depth: int) -> Any:
        """Value that begins with an event, at a depth of nesting."""
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self.anchors:
                self.fail(f"there is no anchor {brief(event.anchor)} before it", event)
            value, size = self.anchors[event.anchor]
            self._add(size, event)
            return value
        before = self.count
        self._add(1, event)
        if isinstance(event, yaml.ScalarEvent):
            value = self._scalar(event)
        else:
            self._check_tag(event)
            if depth >= MAX_DEPTH:
                self.fail(f"values nest deeper than {MAX_DEPTH}", event)
            is_list = isinstance(event, yaml.SequenceStartEvent)
            value = self._list(depth + 1) if is_list else self._mapping(depth + 1)
        if event.anchor:
            self.anchors[event.anchor] = value, self.count - before
        return value

    def _add(self, size: int, event: Any) -> None:
        """Count values, including those that an alias repeats."""
        self.count += size
        if self.count > MAX_VALUES:
            self.fail(f"it holds more than {MAX_VALUES} values", event)

    def _list(self, depth: int) -> list[Any]:
        items = []
        while not isinstance(event := next(self.events), yaml.SequenceEndEvent):
            items.append(self._value(event, depth))
        return items

    def _mapping(self, depth: int) -> dict[str, Any]:
        table, merged = dict[str, Any](), dict[str, Any]()
        while not isinstance(event := next(self.events), yaml.MappingEndEvent):
            key, merges = self._value(event, depth), False
            if isinstance(event, yaml.ScalarEvent):
                key, merges = event.value, event.value == MERGE and not event.style
            if not isinstance(key, str):
                self.fail("a key is not a single word", event)
            if key in table:
                self.fail(f"the key {brief(key)} occurs twice", event)
            table[key] = self._value(next(self.events), depth)
            if merges:
                tables = table.pop(key)
                for inner in reversed(tables if isinstance(tables, list) else [tables]):
                    if not isinstance(inner, dict):
                        self.fail(f"{MERGE} merges {brief(inner)}, no table", event)
                    merged |= inner
        return merged | table

    def _scalar(self, event: Any) -> Any:
        if event.tag in UNITS:
            value = _in_unit(event.value, event.tag)
            if value is None:
                word = f"{event.tag} {brief(event.value)}"
                self.fail(f"{word}: expected a number, as 90 or pi/2", event)
            return value
        self._check_tag(event)
        # The C parser has an empty style where the Python parser has None.
        is_plain = not event.style and event.tag is None
        return _plain_value(event.value) if is_plain else event.value

    def _check_tag(self, event: Any) -> None:
        if event.tag is not None and not _CORE_TAG.fullmatch(event.tag):
            known = f"plain values only, and {', '.join(UNITS)} with a number"
            self.fail(f"the tag {brief(event.tag)} is refused: {known}", event)


def _plain_value(word: str) -> Any:
    """Value of a plain scalar."""
    if word in _WORDS:
        return _WORDS[word]
    if _INTEGER.fullmatch(word):
        # Leading zeros are decimal in YAML 1.2; Python refuses them without a base.
        return int(word, {"0x": 16, "0o": 8}.get(word[:2], 10))
    if len(word) <= 400 and _FLOAT.fullmatch(word):
        return float(word.replace(".inf", "inf").replace(".nan", "nan").lower())
    unit = _ANGLES.get(word[:4]) if word.endswith(")") else None
    value = None if unit is None else _in_unit(word[4:-1], unit)
    return word if value is None else value


def _in_unit(text: str, unit: str) -> float | None:
    """Number with a unit, in SI units; None if it is not a number."""
    if len(text) > LONGEST_EXPRESSION or "_" in text:  # Python alone allows 1_0
        return None
    try:
        return UNITS[unit] * _evaluate(ast.parse(text.strip(), mode="eval").body)
    except (SyntaxError, ValueError, TypeError, ArithmeticError, RecursionError):
        return None


def _evaluate(node: ast.AST) -> float:
    """Evaluate an expression of numbers, pi and the four operations."""
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(
            number, bool
        ):
            return float(number)
        case ast.Name(id="pi"):
            return math.pi
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -_evaluate(inner)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATIONS:
            value: float = _OPERATIONS[type(op)](_evaluate(left), _evaluate(right))
            return value
    raise ValueError("no number")
