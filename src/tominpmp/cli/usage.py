"""How commands are parsed, and how their help and wrong usage are shown."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Sequence
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from tominpmp.cli.signals import SIGNALLED, heeded_signals
from tominpmp.cli.terminal import INTERRUPTED, flush_output, guarded

# What the options are listed under in the help, in this order.
PANELS = ("Motion", "Scene", "Robot", "Planning", "Output", "Page", "General")
# Where a context keeps the words of a command, as they were typed.
TYPED = "tominpmp.typed"
PER_JOINT = "VALUES"
# Options whose values are called so take one word, or several.
SEVERAL = ("POSITIONS", PER_JOINT, "X Y Z")


class Command(TyperCommand):
    """A command with options in groups, whose values may be several words."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join the words of such values, then parse as usual."""
        several = {
            flag
            for param in self.get_params(ctx)
            if getattr(param, "metavar", None) in SEVERAL
            for flag in param.opts
        }
        # For completion: with an option that lacks its value nothing is parsed.
        ctx.meta[TYPED] = tuple(args)
        return list(super().parse_args(ctx, join_lists(args, several)))

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Name the arguments as they are, without marks of any kind."""
        return [piece.strip("{}") for piece in super().collect_usage_pieces(ctx)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the options group by group."""
        rows: dict[str, list[tuple[str, str]]] = {"Arguments": []}
        rows.update((panel, []) for panel in PANELS)
        params: list[Any] = list(self.get_params(ctx))
        for param in params:
            record = param.get_help_record(ctx)
            if param.param_type_name == "argument":
                rows["Arguments"].append((param.metavar or "", param.help or ""))
            elif record is not None:
                panel = getattr(param, "rich_help_panel", None) or PANELS[-1]
                rows[panel].append(record)
        for panel, records in rows.items():
            if records:
                with formatter.section(panel):
                    formatter.write_dl(records, col_max=28)


def join_lists(args: Sequence[str], options: Collection[str]) -> list[str]:
    """Join ``--start 1 2 -3`` to ``--start 1,2,-3``, so that -3 is no option."""
    joined: list[str] = []
    for arg in args:
        if _takes_more(joined[-2:], options) and _is_value(arg):
            joined[-1] += f",{arg}"
        else:
            joined.append(arg)
    return joined


def _takes_more(words: Sequence[str], options: Collection[str]) -> bool:
    """Tell whether the last words are ``--start 1`` or ``--start=1``."""
    if len(words) == 2 and words[0] in options:
        return True
    option, equals, _ = words[-1].partition("=") if words else ("", "", "")
    return bool(equals) and option in options


def _is_value(word: str) -> bool:
    """Tell whether a word is ``JOINT=VALUE`` or a number, perhaps with a comma."""
    if "=" in word and not word.startswith("-"):
        return True
    try:
        float(word.rstrip(","))
    except ValueError:
        return False
    return True


class Commands(TyperGroup):
    """The group of commands; tells of wrong usage as of any other error."""

    def main(self, *args: Any, standalone_mode: bool = True, **kwargs: Any) -> Any:
        """Run and, if standalone, exit with the code of the command."""
        if "_TOMINPMP_COMPLETE" in os.environ:
            # A shell asks what might be typed, and that ends the program.
            kwargs["standalone_mode"] = standalone_mode
            return super().main(*args, **kwargs)
        try:
            with guarded(), heeded_signals() as signals:
                kwargs["standalone_mode"] = False
                code = int(super().main(*args, **kwargs) or 0)
        except typer.Exit as end:
            code = end.exit_code
        if code == INTERRUPTED and signals.number is not None:
            code = SIGNALLED + signals.number
        code = flush_output(code)
        if standalone_mode:
            sys.exit(code)
        return code
