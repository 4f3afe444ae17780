"""The command line: ``tominpmp``, or ``python -m tominpmp``.

:mod:`~tominpmp.cli.front` has the list of the commands and :mod:`~tominpmp.cli.options`
their options. Imports are lazy, so that help and errors about options appear at once:
the robotics libraries are imported when a command runs, and the list of the commands
does not even import NumPy. The signal handlers are installed before any other import:
a user who interrupts the program while it starts gets an exit code and no traceback.
"""

from __future__ import annotations

__all__ = ["main"]


def main() -> None:
    """Run the command line and leave with its exit code."""
    from tominpmp.cli.signals import end_at_once, take

    take(end_at_once)
    import sys

    from tominpmp.cli.app import run
    from tominpmp.cli.terminal import hold_streams

    hold_streams()
    sys.exit(run(sys.argv[1:]))
