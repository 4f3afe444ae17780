"""Parses the words of a command line, calls the command and formats help."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

from cyclopts import App, CycloptsError, Parameter, UnusedCliTokensError
from cyclopts.help import PlainFormatter

from tominpmp.cli.front import COMMANDS, EXAMPLES, commands
from tominpmp.cli.option_fields import SEPARATOR, SEVERAL, number
from tominpmp.cli.terminal import BAD_INPUT, complain, say
from tominpmp.exceptions import OptionsError, brief

if TYPE_CHECKING:
    from cyclopts.help import HelpEntry, HelpPanel
    from rich.console import Console, ConsoleOptions

# Width of a help text, and length from which names stand on a separate line.
WIDEST, LONGEST = 100, 28


def dispatch(words: Sequence[str]) -> int:
    """Call the command that the words name, or show its help.

    Returns:
        The exit code.

    Raises:
        OptionsError: If the command belongs to an add-on that is not installed.
    """
    app = new_app()
    if words[0] in COMMANDS.keys() - commands().keys():
        add_on = COMMANDS[words[0]].split(".")[1]
        raise OptionsError(
            f"{words[0]} is a command of the add-on {add_on}, which is not installed",
            words[0],
        )
    if words[0] in commands():
        several = {
            flag
            for argument in app[words[0]].assemble_argument_collection()
            if (argument.parameter.help or "").rpartition(SEPARATOR)[0] in SEVERAL
            for flag in argument.names
        }
        words = join_lists(words, several)
    try:
        return int(app(words, exit_on_error=False, print_error=False) or 0)
    except CycloptsError as error:
        message = str(error)
        if isinstance(error, UnusedCliTokensError) and error.unused_tokens:
            unused = ", ".join(map(brief, error.unused_tokens))
            message = f"{unused}: neither an option nor a value of the preceding option"
        complain("error", message)
        chain = " ".join(("tominpmp", *(error.command_chain or ())))
        say(f"see {chain} --help", err=True)
        return BAD_INPUT


def new_app() -> App:
    """The application with the installed commands."""
    app = App(
        name="tominpmp",
        help_format="plaintext",
        help_formatter=_HelpFormatter(),
        version_flags=(),
        default_parameter=Parameter(negative_iterable=(), show_default=False),
        result_action="return_value",
        suppress_keyboard_interrupt=False,
    )
    for name, path in commands().items():
        app.command(path, name=name, help_epilogue=EXAMPLES if name == "plan" else "")
    app.register_install_completion_command(add_to_startup=True)
    app.command(lambda: say(app.generate_completion()), name="--show-completion")
    return app


def join_lists(args: Sequence[str], options: Collection[str]) -> list[str]:
    """Join ``--start -1 2 -3`` to ``--start=-1,2,-3``, so that -1 is not an option."""
    joined: list[str] = []
    for arg in args:
        option, equals, _ = joined[-1].partition("=") if joined else ("", "", "")
        if option in options and _is_value(arg):
            joined[-1] = f"{joined[-1].rstrip(',')}{',' if equals else '='}{arg}"
        else:
            joined.append(arg)
    return joined


def _is_value(word: str) -> bool:
    """Whether a word is ``JOINT=VALUE`` or begins with a number."""
    named = "=" in word and not word.startswith("-")
    return named or number(word.partition(",")[0]) is not None


def _labels(entry: HelpEntry, metavar: str) -> str:
    """Names of an argument, option or command, with its metavariable."""
    names = [*entry.positive_names, *entry.positive_shorts]
    if metavar and names:
        names[-1] += f" {metavar}"
    label = getattr(entry, "positional_label", None)  # a name in cyclopts 4
    first = [label] if label else []
    return ", ".join([*first, *names, *entry.negative_names])


class _HelpFormatter(PlainFormatter):
    """Writes the names on the left and the texts on the right.

    The help is written by :func:`~tominpmp.cli.terminal.say`, which reports that there
    is no standard output; Rich would write nothing, and say nothing.
    """

    def __call__(
        self, console: Console, options: ConsoleOptions, panel: HelpPanel
    ) -> None:
        """Write one group of arguments, options or commands."""
        rows = []
        for entry in panel.entries:
            text = _unwrapped(console, options, entry.description)
            metavar, _, text = text.rpartition(SEPARATOR)
            rows.append((_labels(entry, metavar), text))
        if not rows:
            return
        short = [len(names) for names, _ in rows if len(names) <= LONGEST]
        indent = max(short, default=LONGEST) + 4
        lines = [f"{panel.title}:"]
        for names, text in rows:
            label = f"  {names}"
            if len(names) > LONGEST:
                lines.append(label)
                label = ""
            lines += textwrap.wrap(
                f"{label:<{indent}}{text}",
                min(console.width, WIDEST) - 1,
                subsequent_indent=" " * indent,
                break_long_words=False,
                break_on_hyphens=False,
            )
        say("\n".join((*lines, "")))

    def render_description(
        self, console: Console, options: ConsoleOptions, description: Any
    ) -> None:
        """Write paragraphs; indented lines, such as exit codes, stay lines."""
        width = min(console.width, WIDEST) - 1
        for part in _unwrapped(console, options, description).rstrip().split("\n\n"):
            filled = textwrap.fill(part, width, break_on_hyphens=False)
            text = part if "\n " in part else filled
            say(f"{text}\n")


def _unwrapped(console: Console, options: ConsoleOptions, text: Any) -> str:
    """A text in lines as long as they are written."""
    shown = console.render(text, options.update(width=10_000))
    return "".join(part.text for part in shown)
