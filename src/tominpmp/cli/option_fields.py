"""Options from dataclasses: each field is one, and the docstring has its text.

A command is a function. A parameter of it whose type is a dataclass stands for an
option for each of its fields; one annotated with :class:`FieldsOf` for the fields of a
class of the library. So an option is declared in one place.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from types import NoneType, SimpleNamespace
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    get_args,
    get_origin,
    get_type_hints,
)

import typer

from tominpmp.cli.completion import COMPLETIONS, words
from tominpmp.cli.terminal import guarded
from tominpmp.cli.usage import PER_JOINT, Command

# How the values of fields of the library are called.
METAVARS: dict[Any, str] = {bool: "", int: "N", float: "NUMBER", str: "NAME"}
# What scenario files have for None.
NONE = "none"

# An attribute in a docstring, in brackets what its value is called.
ENTRY = re.compile(r"^    (\w+)(?: \((.*)\))?: (.*(?:\n(?:     .*|$))*)", re.MULTILINE)
# References to other parts of the documentation are of no use in a terminal.
REFERENCE = re.compile(r",? see :\w+:`[^`]*`|:\w+:`~?(?:\w+\.)*(\w+)`|``(.*?)``")

Parameters = dict[str, inspect.Parameter]


@dataclass(frozen=True)
class FieldsOf:
    """Stands for an option for each field of a class of the library that can be typed.

    These are fields for a number, a word or a truth value, and for values per joint,
    which remain a text. The command gets a mapping with those that were given.

    Attributes:
        kind: The class.
        panel: What the options are listed under.
        further: By the names of fields, another name of the option or an empty text,
            and a sentence about it that only commands need.
        ending: How the names of the fields end; others are left out.
        renamed: How options are called that would be called as those of another class.
    """

    kind: type[Any]
    panel: str
    further: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    ending: str = ""
    renamed: Mapping[str, str] = field(default_factory=dict)

    def parameters(self) -> Parameters:
        """Parameters for Typer by the names of the fields."""
        texts, found = attribute_texts(self.kind), {}
        for item in fields(self.kind):
            hint = _hint(self.kind, item)
            kind, metavar = _typed(hint)
            if kind is None or not item.name.endswith(self.ending):
                continue
            text = texts.get(item.name, ("", ""))[1].replace("None", NONE)
            if item.default not in (None, MISSING):
                text += f" Default: {item.default}."
            name = self.renamed.get(item.name, item.name)
            flag = name.replace("_", "-")
            flags = [f"--{flag}/--no-{flag}" if kind is bool else f"--{flag}"]
            if item.name in self.further:
                other, note = self.further[item.name]
                flags[:0] = [other] if other else []
                text += f" {note}"
            choices = _choices(hint)
            optional = NoneType in get_args(hint) and metavar not in ("", PER_JOINT)
            option = typer.Option(
                *flags,
                metavar=metavar or None,
                help=text,
                parser=_or_none(kind) if optional else None,
                rich_help_panel=self.panel,
                show_default=False,
                autocompletion=words(*choices) if choices else None,
            )
            found[name] = _parameter(name, Annotated[kind | None, option])
        return found

    def field_names(self) -> Mapping[str, str]:
        """Names of fields by the names of their options, where they differ."""
        return {name: item for item, name in self.renamed.items()}


def _hint(kind: type[Any], item: Field[Any]) -> Any:
    """Type of a field; any object where only type checkers know it."""
    alone = SimpleNamespace(__annotations__={item.name: item.type})
    try:
        return get_type_hints(alone, vars(sys.modules[kind.__module__]))[item.name]
    except NameError:
        return object


def _typed(hint: Any) -> tuple[Any, str]:
    """What is typed for a field, None if nothing can be; and how that is called."""
    kinds = [kind for kind in get_args(hint) or (hint,) if kind is not NoneType]
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


def _or_none(kind: type[Any]) -> Callable[[str], Any]:
    """Reader of an option that may also be none."""

    def read(text: str) -> Any:
        try:
            return NONE if text == NONE else kind(text)
        except ValueError as error:
            expected = "a whole number" if kind is int else "a number"
            raise typer.BadParameter(
                f"{text!r} is neither {expected} nor {NONE}"
            ) from error

    return read


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


def _parameter(name: str, hint: Any, default: Any = None) -> inspect.Parameter:
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, annotation=hint, default=default
    )


def _record_parameters(kind: Any) -> Parameters:
    """Parameters for Typer for the fields of a record of options.

    The metadata of a field may have ``flags``, the names of its option, and ``panel``,
    what it is listed under; else that is the panel of the class that declares it.
    """
    hints, found = get_type_hints(kind), {}
    texts = {
        name: (base.panel, *text)
        for base in reversed(kind.__mro__)
        for name, text in attribute_texts(base).items()
    }
    for item in fields(kind):
        panel, metavar, text = texts[item.name]
        flags = item.metadata.get("flags", ())
        if item.default is False and not flags:
            flags = (f"--{item.name.replace('_', '-')}",)
        option = typer.Option(
            *flags,
            metavar=metavar or None,
            help=text,
            rich_help_panel=item.metadata.get("panel", panel),
            show_default=False,
            autocompletion=COMPLETIONS.get(item.name),
        )
        default = inspect.Parameter.empty if item.default is MISSING else item.default
        hint = hints[item.name]
        found[item.name] = _parameter(item.name, Annotated[hint, option], default)
    return found


@dataclass(frozen=True)
class GeneralOptions:
    """What all commands know.

    Attributes:
        debug: Show the traceback of an error too.
    """

    panel: ClassVar = "General"
    debug: bool = False


@dataclass(frozen=True)
class _Group:
    """The options that a parameter of a command stands for."""

    hint: Any
    parameters: Parameters
    renamed: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, own: inspect.Parameter, hint: Any) -> _Group:
        for mark in get_args(hint):
            if isinstance(mark, FieldsOf):
                return cls(hint, mark.parameters(), mark.field_names())
        if is_dataclass(hint):
            return cls(hint, _record_parameters(hint))
        return cls(None, {own.name: _parameter(own.name, hint, own.default)})

    def value(self, given: Mapping[str, Any]) -> Any:
        """The argument for the command, from those that Typer gives."""
        own = {name: given[name] for name in self.parameters}
        if self.hint is None:
            return next(iter(own.values()))
        if is_dataclass(self.hint):
            return self.hint(**own)  # type: ignore[operator]
        own = {
            self.renamed.get(name, name): value
            for name, value in own.items()
            if value is not None
        }
        return {name: None if value == NONE else value for name, value in own.items()}


def command(app: typer.Typer, **texts: Any) -> Callable[[Callable[..., Any]], None]:
    """Add a function as a command, with its options.

    Args:
        app: The commands.
        **texts: ``short_help``, and ``epilog`` for the end of the help, whose beginning
            is the docstring of the function. It returns an exit code, or None for 0.
    """

    def add(function: Callable[..., Any]) -> None:
        hints = get_type_hints(function, include_extras=True)
        groups = {
            name: _Group.of(own, hints[name])
            for name, own in inspect.signature(function).parameters.items()
        }
        general = _Group(GeneralOptions, _record_parameters(GeneralOptions))

        def run(**given: Any) -> int:
            with guarded(general.value(given).debug):
                values = {name: group.value(given) for name, group in groups.items()}
                return int(function(**values) or 0)

        parameters = [
            parameter
            for group in (*groups.values(), general)
            for parameter in group.parameters.values()
        ]
        run.__name__, run.__doc__ = function.__name__, function.__doc__
        run.__annotations__ = {p.name: p.annotation for p in parameters}
        setattr(run, "__signature__", inspect.Signature(parameters))  # noqa: B010
        app.command(cls=Command, **texts)(run)

    return add
