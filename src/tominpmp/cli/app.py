"""Runs a command line and determines its exit code."""

from __future__ import annotations

from collections.abc import Sequence

from tominpmp.cli.front import front_page
from tominpmp.cli.signals import SIGNALLED, heeded_signals
from tominpmp.cli.terminal import INTERRUPTED, guarded, say


def run(words: Sequence[str]) -> int:
    """Run a command line.

    Returns:
        The exit code.
    """
    try:
        with guarded(words), heeded_signals() as signals:
            code = _run(list(words))
    except SystemExit as end:
        code = int(end.code or 0)
    if code == INTERRUPTED and signals.number is not None:
        code = SIGNALLED + signals.number
    return code


def _run(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help"):
        say(front_page())
        return 0
    if words == ["--version"]:
        from importlib.metadata import version

        say(f"tominpmp {version('tominpmp')}")
        return 0
    from tominpmp.cli.parser import dispatch

    return dispatch(words)
