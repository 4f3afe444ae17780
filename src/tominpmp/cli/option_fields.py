"""Options from dataclasses: each field is one, and the docstring has its text.

A command is a function. A parameter of it whose type is a dataclass that is marked with
:func:`options` stands for an option for each of its fields; :func:`fields_of` makes
such a dataclass of a class of the library. So an option is declared in one place.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, make_dataclass
from types import NoneType, SimpleNamespace
from typing import (
    Annotated,
    Any,
    Literal,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

from cyclopts import Group, Parameter, Token

from tominpmp.cli.completion import COMPLETIONS, supported, words
from tominpmp.exceptions import OptionsError

# What the options are listed under in the help, in this order.
PANELS = ("Arguments", "Motion", "Scene", "Robot", "Planning", "Output", "Page")
GROUPS = {
    name: Group(name, sort_key=place)
    for place, name in enumerate((*PANELS, "General"), start=1)
}
PER_JOINT = "VALUES"
# Options whose values are called so take one word, or several.
SEVERAL = ("POSITIONS", PER_JOINT, "X Y Z")
# How the values of fields of the library are called.
METAVARS: dict[Any, str] = {bool: "", int: "N", float: "NUMBER", str: "NAME"}
# What scenario files have for None.
NONE = "none"

# An attribute in a docstring, in brackets what its value is called.
ENTRY = re.compile(r"^    (\w+)(?: \((.*)\))?: (.*(?:\n(?:     .*|$))*)", re.MULTILINE)
# References to other parts of the documentation are of no use in a terminal.
REFERENCE = re.compile(r",? see :\w+:`[^`]*`|:\w+:`~?(?:\w+\.)*(\w+)`|``(.*?)``")

Record = TypeVar("Record")

# Stands between what a value is called and the text of its option.
BETWEEN = "\x1f"


def labelled(value: str, text: str) -> str:
    """A help text with what the value of an option is called, empty for a flag.

    Cyclopts has a place of its own for that from version 5 on only.
    """
    return f"{value}{BETWEEN}{text}" if value else text


def value_name(text: str) -> str:
    """What the value is called in a text of :func:`labelled`."""
    return text.partition(BETWEEN)[0] if BETWEEN in text else ""


def attribute_texts(kind: type[Any]) -> dict[str, tuple[str, str]]:
    """What the docstring of a class says of its attributes.

    Returns:
        How the value is called, empty if that is not said, and the text.
    """
    text = inspect.cleandoc(kind.__doc__ or "").partition("\nAttributes:\n")[2]
    return {
        name: (metavar, REFERENCE.sub(r"\1\2", " ".join(words.split())))
        for name, metavar, words in ENTRY.findall(text)
    }


def options(panel: str) -> Callable[[type[Record]], type[Record]]:
    """Mark a dataclass: each field that it declares is an option.

    The metadata of a field may have ``alias``, another name of its option, and
    ``panel``, what it is listed under instead.

    Args:
        panel: What the options are listed under.
    """

    def mark(kind: type[Record]) -> type[Record]:
        declared = {item.name: item for item in fields(kind)}  # type: ignore[arg-type]
        for name, (metavar, text) in attribute_texts(kind).items():
            item = declared[name]
            hint = _hint(kind, item)
            kind.__annotations__[name] = Annotated[
                hint,
                Parameter(
                    converter=_reader(hint),
                    allow_leading_hyphen=name == "output",  # - is standard output
                    alias=item.metadata.get("alias"),
                    help=labelled(metavar, text),
                    group=GROUPS[item.metadata.get("panel", panel)],
                    negative=() if item.default is False else None,
                    **supported(
                        metavar=metavar or None, completer=COMPLETIONS.get(name)
                    ),
                ),
            ]
        return Parameter(name="*")(kind)

    return mark


def fields_of(
    kind: type[Any],
    panel: str,
    further: Mapping[str, tuple[str, str]] | None = None,
    ending: str = "",
    renamed: Mapping[str, str] | None = None,
) -> Any:
    """Make a dataclass of the fields of a class of the library that can be typed.

    These are fields for a number, a word or a truth value, and for values per joint,
    which remain a text. :func:`given` has those that were typed.

    Args:
        kind: The class.
        panel: What the options are listed under.
        further: By the names of fields, another name of the option or an empty text,
            and a sentence about it that only commands need.
        ending: How the names of the fields end; others are left out.
        renamed: How options are called that would be called as those of another class.
    """
    texts, found = attribute_texts(kind), []
    for item in fields(kind):
        hint = _hint(kind, item)
        typed, metavar = _typed(hint)
        if typed is None or not item.name.endswith(ending):
            continue
        other, note = (further or {}).get(item.name, ("", ""))
        text = texts.get(item.name, ("", ""))[1].replace("None", NONE)
        if item.default not in (None, MISSING):
            text += f" Default: {item.default}."
        choices = _choices(hint)
        optional = NoneType in get_args(hint) and metavar not in ("", PER_JOINT)
        marks = Parameter(
            alias=other or None,
            help=labelled(metavar, f"{text} {note}".strip()),
            group=GROUPS[panel],
            converter=_reader(typed, optional),
            **supported(
                metavar=metavar or None,
                completer=words(*choices) if choices else None,
            ),
        )
        name = (renamed or {}).get(item.name, item.name)
        kept = field(default=None, metadata={"field": item.name})
        found.append((name, Annotated[typed | None, marks], kept))
    made = make_dataclass(
        f"{kind.__name__}Fields",
        found,
        namespace={"__module__": __name__},  # else it counts as one of Python's own
        frozen=True,
        kw_only=True,
    )
    return Parameter(name="*")(made)


def given(record: Any) -> dict[str, Any]:
    """Values that were typed, by the names of the fields of the library's class."""
    found = {f.metadata["field"]: getattr(record, f.name) for f in fields(record)}
    return {
        name: None if value == NONE else value
        for name, value in found.items()
        if value is not None
    }


def _hint(kind: type[Any], item: Field[Any]) -> Any:
    """Type of a field; any object where only type checkers know it."""
    alone = SimpleNamespace(__annotations__={item.name: item.type})
    try:
        return get_type_hints(alone, vars(sys.modules[kind.__module__]))[item.name]
    except NameError:
        return object


def _kinds(hint: Any) -> list[Any]:
    """What a value may be, beside None."""
    return [kind for kind in get_args(hint) or (hint,) if kind is not NoneType]


def _typed(hint: Any) -> tuple[Any, str]:
    """What is typed for a field, None if nothing can be; and how that is called."""
    kinds = _kinds(hint)
    if Literal in (get_origin(hint), get_origin(kinds[0])):
        return str, METAVARS[str]
    if float in kinds and any(get_origin(kind) is Mapping for kind in kinds):
        return str, PER_JOINT
    kind = kinds[0] if len(kinds) == 1 and kinds[0] in METAVARS else None
    return kind, METAVARS.get(kind, "")


def _choices(hint: Any) -> tuple[str, ...]:
    """The words that a field may be, where they are listed."""
    for kind in (hint, *get_args(hint)):
        if get_origin(kind) is Literal:
            return tuple(str(word) for word in get_args(kind))
    return ()


def _reader(hint: Any, also_none: bool = False) -> Callable[..., Any] | None:
    """Reader of an option for a number that is whole, or may also be none."""
    kind = next((kind for kind in (int, float, str) if kind in _kinds(hint)), str)
    if not also_none and kind is not int:
        return None

    def read(_: Any, tokens: Collection[Token]) -> Any:
        (token,) = tokens
        try:
            return NONE if also_none and token.value == NONE else kind(token.value)
        except ValueError as error:
            expected = "a whole number" if kind is int else "a number"
            said = f"neither {expected} nor {NONE}" if also_none else f"not {expected}"
            raise OptionsError(
                f"{token.keyword!r}: {token.value!r} is {said}"
            ) from error

    return read


@options("General")
@dataclass(frozen=True, kw_only=True)
class GeneralOptions:
    """What all commands know.

    Attributes:
        debug: Show the traceback of an error too.
    """

    debug: bool = False
