"""Options from dataclasses: each field is an option, and the docstring has its help.

A command is a function. If the type of one of its parameters is a dataclass marked with
:func:`options`, each field of the dataclass is an option of the command;
:func:`fields_of` derives a dataclass of this kind from a class of the library. Thus an
option is declared in one place.
"""

from __future__ import annotations

import glob
import inspect
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import MISSING, Field, dataclass, field, fields
from inspect import signature
from pathlib import Path
from types import NoneType, SimpleNamespace
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    TypeAlias,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)
from xml.etree.ElementTree import Element

from cyclopts import Group, Parameter, Token

from tominpmp.exceptions import OptionsError

if TYPE_CHECKING:
    from cyclopts.completion import CompletionContext
    from typing_extensions import dataclass_transform
else:

    def dataclass_transform(**_: Any) -> Any:
        """Mark nothing: the mark is for type checkers."""
        return lambda function: function


Completer: TypeAlias = "Callable[[CompletionContext], list[str]]"

# Endings of the files that are completed in place of a robot or a problem.
ENDINGS = (".urdf", ".toml")
# Kinds of joints that have a position.
MOVING = ("revolute", "continuous", "prismatic")


def supported(**marks: Any) -> dict[str, Any]:
    """Keep the arguments of a ``Parameter`` that the installed Cyclopts supports.

    Version 4, the last for Python 3.10, completes only the names of options, and does
    not show the names of their values in the usage line.
    """
    known = signature(Parameter).parameters
    return {name: value for name, value in marks.items() if name in known}


def sources(typed: CompletionContext) -> list[str]:
    """Names of robots, and files and folders that begin with the typed text.

    The files are those of robots and scenarios.
    """
    from tominpmp.description.files import robot_names

    matches = sorted(glob.glob(f"{glob.escape(typed.incomplete)}*"))
    names = (f"{name}/" if Path(name).is_dir() else name for name in matches)
    files = [name for name in names if name.endswith(("/", *ENDINGS))]
    return [*robot_names(), *files]


def named(kind: str, *tags: str) -> Completer:
    """Completer for names of elements in the URDF or SRDF file of the typed robot."""
    return lambda typed: [e.get("name", "") for e in _elements(typed, kind, *tags)]


def joints(typed: CompletionContext) -> list[str]:
    """Moving joints of the typed robot, as ``JOINT=``."""
    elements = _elements(typed, "urdf", "joint")
    return [f"{e.get('name', '')}=" for e in elements if e.get("type") in MOVING]


def positions(typed: CompletionContext) -> list[str]:
    """Group states of the typed robot, and its moving joints."""
    return [*dict.fromkeys(named("srdf", "group_state")(typed)), *joints(typed)]


def _elements(typed: CompletionContext, kind: str, *tags: str) -> Iterator[Element]:
    """Top-level elements in the URDF or SRDF file of the typed robot."""
    from tominpmp.description.files import find_robot
    from tominpmp.description.xml_reader import read_xml
    from tominpmp.exceptions import TominpmpError

    items = ((k, typed.get(k)) for k in ("robot", "scenario", kind))
    values = {k: item.raw for k, item in items if item is not None}
    # While an option lacks its values, Cyclopts cannot assign the arguments.
    bare = (word for word in sys.argv[3:] if not word.startswith("-"))
    robot = values.get("robot") or values.get("scenario") or next(bare, "")
    try:
        path = values.get(kind) or getattr(find_robot(robot), kind) or ""
        root = read_xml(Path(path))
    except (TominpmpError, OSError):
        return
    for tag in tags:
        yield from root.findall(tag)


#: Completers of the values of options, by the name of the option. Cyclopts completes
#: the words of a ``Literal`` by itself.
COMPLETIONS: dict[str, Completer] = {
    "group": named("srdf", "group"),
    "lock": joints,
    "start": positions,
    "goal": positions,
    "goal_position": named("urdf", "link", "joint"),
    "goal_pose": named("urdf", "link", "joint"),
    "robot": sources,
}


# Headings of the options in the help, in this order.
PANELS = "Arguments Motion Scene Robot Planning Output Page General".split()
GROUPS = {name: Group.create_ordered(name) for name in PANELS}
PER_JOINT = "VALUES"
# Metavariables of options that take one word or several.
SEVERAL = ("POSITIONS", PER_JOINT, "X Y Z")
# Metavariables of the fields of classes of the library, by type.
METAVARS: dict[Any, str] = {bool: "", int: "N", float: "NUMBER", str: "NAME"}
# The word for None, as in scenario files.
NONE = "none"

# An attribute in a docstring, with its metavariable in brackets.
ENTRY = re.compile(r"^    (\w+)(?: \((.*)\))?: (.*(?:\n(?:     .*|$))*)", re.MULTILINE)
# References to other parts of the documentation are of no use in a terminal.
REFERENCE = re.compile(r",? see :\w+:`[^`]*`|:\w+:`~?(?:\w+\.)*(\w+)`|``(.*?)``")

Record = TypeVar("Record")

# Precedes the help text of an option, after its metavariable: only from version 5 on
# does Cyclopts have a field for the metavariable.
SEPARATOR = "\x1f"


def attribute_texts(kind: type[Any]) -> dict[str, tuple[str, str]]:
    """Metavariables and descriptions of attributes in the docstring of a class.

    Returns:
        By the name of the attribute, the metavariable, which may be empty, and the
        description.
    """
    text = inspect.cleandoc(kind.__doc__ or "").partition("\nAttributes:\n")[2]
    return {
        name: (metavar, REFERENCE.sub(r"\1\2", " ".join(words.split())))
        for name, metavar, words in ENTRY.findall(text)
    }


@dataclass_transform(kw_only_default=True, field_specifiers=(field,))
def options(
    panel: str, texts: Mapping[str, tuple[str, str]] | None = None
) -> Callable[[type[Record]], type[Record]]:
    """Make a frozen dataclass with keywords: each field that it declares is an option.

    The metadata of a field may have ``alias``, another name of its option, and
    ``panel``, a heading that replaces the heading of the class. The default of a field
    is added to its help text.

    Args:
        panel: Heading of the options in the help.
        texts: By the names of the options, their metavariables and help texts; None
            takes them from the docstring.
    """

    def marked(kind: type[Record]) -> type[Record]:
        kind = dataclass(frozen=True, kw_only=True)(kind)
        declared = {item.name: item for item in fields(kind)}  # type: ignore[arg-type]
        described = attribute_texts(kind) if texts is None else texts
        for name, (metavar, text) in described.items():
            item = declared[name]
            text, hint = _with_default(text, item), _hint(kind, item)
            more, completer = item.metadata, COMPLETIONS.get(name)
            text = f"{metavar}{SEPARATOR}{text}" if metavar else text
            kind.__annotations__[name] = Annotated[
                hint,
                Parameter(
                    name=more.get("name"),
                    alias=more.get("alias"),
                    converter=_reader(hint, more),
                    allow_leading_hyphen=name == "output",  # - is standard output
                    help=text,
                    group=GROUPS[more.get("panel", panel)],
                    negative=() if item.default is False else None,
                    **supported(metavar=metavar or None, completer=completer),
                ),
            ]
        return Parameter(name="*")(kind)

    return marked


def _with_default(text: str, item: Field[Any]) -> str:
    """A help text with the default of a field, unless that is None or False."""
    stated = item.default not in (None, MISSING) and item.default is not False
    return f"{text} Default: {item.default}." if stated else text


def fields_of(
    kind: type[Any],
    panel: str,
    further: Mapping[str, tuple[dict[str, Any], str]] | None = None,
    ending: str = "",
    base: type[Any] = object,
) -> Any:
    """Make a dataclass of the fields of a class that can be typed as options.

    These are fields for a number, a word or a truth value, and for values per joint,
    which remain a text. :func:`typed_values` extracts the values that were typed.

    Args:
        kind: The class of the library.
        panel: Heading of the options in the help.
        further: By the names of fields, another ``name`` or an ``alias`` of the option,
            and a sentence about it that only the command line needs.
        ending: Suffix of the names of the fields; other fields are left out.
        base: Base class, whose fields are options, too.
    """
    described, texts = attribute_texts(kind), {}
    # Otherwise Cyclopts takes the class for a builtin.
    namespace: dict[str, Any] = {"__module__": __name__, "__annotations__": {}}
    for item in fields(kind):
        hint = _hint(kind, item)
        typed, metavar = _typed(hint)
        if typed is None or not item.name.endswith(ending):
            continue
        names, note = (further or {}).get(item.name, ({}, ""))
        text = described.get(item.name, ("", ""))[1].replace("None", NONE)
        texts[item.name] = metavar, f"{_with_default(text, item)} {note}".strip()
        also_none = NoneType in get_args(hint) and metavar not in ("", PER_JOINT)
        marks = {"also_none": also_none, "note": note}
        namespace["__annotations__"][item.name] = typed | None
        namespace[item.name] = field(default=None, metadata=marks | names)
    record = type(f"{kind.__name__}Fields", (base,), namespace)
    return options(panel, texts)(record)


def typed_values(record: Any) -> dict[str, Any]:
    """Values that were typed, by the names of the fields of the library's class."""
    typed = ((name, value) for name, value in vars(record).items() if value is not None)
    return {name: None if value == NONE else value for name, value in typed}


def number(word: str) -> float | None:
    """Read a number that was typed; None if the word is not a number.

    Digits may be grouped, 1_000, as in scenario files: TOML and Python agree on that.
    """
    try:
        return float(word)
    except ValueError:
        return None


def _hint(kind: type[Any], item: Field[Any]) -> Any:
    """Type of a field; ``object`` if only type checkers can resolve the annotation."""
    alone = SimpleNamespace(__annotations__={item.name: item.type})
    try:
        return get_type_hints(alone, vars(sys.modules[kind.__module__]))[item.name]
    except NameError:
        return object


def _kinds(hint: Any) -> list[Any]:
    """Types that a value may have, except None."""
    return [kind for kind in get_args(hint) or (hint,) if kind is not NoneType]


def _choices(hint: Any) -> tuple[Any, ...]:
    """The allowed words of a field; empty if they are not listed."""
    literal = next((k for k in (hint, *_kinds(hint)) if get_origin(k) is Literal), None)
    return get_args(literal)


def _typed(hint: Any) -> tuple[Any, str]:
    """How a field is typed on the command line.

    Returns:
        The type of the typed value, None if the field cannot be typed; and its
        metavariable.
    """
    if _choices(hint):
        return hint, METAVARS[str]
    kinds = _kinds(hint)
    if float in kinds and any(get_origin(kind) is Mapping for kind in kinds):
        return str, PER_JOINT
    kind = kinds[0] if len(kinds) == 1 and kinds[0] in METAVARS else None
    return kind, METAVARS.get(kind, "")


def _reader(hint: Any, marks: Mapping[str, Any]) -> Callable[..., Any] | None:
    """Converter for whole numbers, choices and values that may be "none"; else None.

    Args:
        hint: Type of the field.
        marks: Metadata of the field: ``also_none``, whether the value may be "none",
            and ``note``, a sentence that follows the message on a wrong value.
    """
    choices, also_none, note = _choices(hint), marks.get("also_none"), marks.get("note")
    kind = next((kind for kind in (int, float) if kind in _kinds(hint)), str)
    if not also_none and not choices and kind is not int:
        return None

    def read(_: Any, tokens: Collection[Token]) -> Any:
        (token,) = tokens
        word = token.value
        if also_none and word == NONE:
            return NONE
        with suppress(ValueError):
            if not choices or word in choices:
                return kind(word)
        expected = "a whole number" if kind is int else "a number"
        expected = f"one of: {', '.join(choices)}" if choices else expected
        expected += f" or {NONE}" if also_none else ""
        message = f"{token.keyword} is {word!r}, expected {expected}"
        raise OptionsError(f"{message}. {note}" if note else message, token.keyword)

    return read


@options("General")
class GeneralOptions:
    """Options of all commands.

    Attributes:
        debug: Show the traceback of an error too.
    """

    debug: bool = False
