"""How help is laid out: plain text, each option beside what is said of it."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from cyclopts.help import PlainFormatter

if TYPE_CHECKING:
    from cyclopts.help import HelpEntry, HelpPanel
    from rich.console import Console, ConsoleOptions

# Longer lines are hard to read, and longer names have a line of their own.
WIDEST, LONGEST = 100, 28
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


def _labels(entry: HelpEntry, value: str) -> str:
    """Names of an argument, option or command, with what its value is called."""
    names = [*entry.positive_names, *entry.positive_shorts]
    if value and names:
        names[-1] += f" {value}"
    label = getattr(entry, "positional_label", None)  # a name in cyclopts 4
    first = [label] if label else []
    return ", ".join([*first, *names, *entry.negative_names])


class HelpFormatter(PlainFormatter):
    """Writes the names on the left and the texts on the right."""

    def __call__(
        self, console: Console, options: ConsoleOptions, panel: HelpPanel
    ) -> None:
        """Write one group of arguments, options or commands."""
        wide = options.update(width=10_000)
        rows = []
        for entry in panel.entries:
            shown = console.render(entry.description, wide)
            text = "".join(part.text for part in shown)
            value = value_name(text)
            rows.append((_labels(entry, value), text[len(labelled(value, "")) :]))
        if not rows:
            return
        short = [len(names) for names, _ in rows if len(names) <= LONGEST]
        indent = max(short, default=LONGEST) + 4
        lines = [f"{panel.title}:"]
        for names, text in rows:
            label = f"  {names}".ljust(indent)
            if len(names) > LONGEST:
                lines.append(label)
                label = " " * indent
            width = min(console.width, WIDEST) - 1
            lines += textwrap.wrap(
                text,
                width,
                initial_indent=label,
                subsequent_indent=" " * indent,
                break_long_words=False,
                break_on_hyphens=False,
            ) or [label]
        console.print("\n".join(lines), "", sep="\n", soft_wrap=True, markup=False)
