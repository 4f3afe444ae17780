"""How help is laid out: plain text, each option beside what is said of it."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from cyclopts.help import PlainFormatter

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel
    from rich.console import Console, ConsoleOptions

# Longer lines are hard to read, and longer names have a line of their own.
WIDEST, LONGEST = 100, 28


class HelpFormatter(PlainFormatter):
    """Writes the names on the left and the texts on the right."""

    def __call__(
        self, console: Console, options: ConsoleOptions, panel: HelpPanel
    ) -> None:
        """Write one group of arguments, options or commands."""
        wide = options.update(width=10_000)
        rows = [
            (
                ", ".join(entry.display_labels_with_metavar),
                "".join(part.text for part in console.render(entry.description, wide)),
            )
            for entry in panel.entries
        ]
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
