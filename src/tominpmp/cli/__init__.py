"""The command line: ``tominpmp``, or ``python -m tominpmp``.

:mod:`~tominpmp.cli.front` has the list of the commands and :mod:`~tominpmp.cli.options`
what can be said to them. To show help or refuse an option, nothing is imported that
takes long: the robotics libraries are when a command runs, and NumPy is not even for
the list of the commands. Nothing at all is before signals are heeded: who ends the
program while it starts shall get its exit code, and no traceback.
"""

from __future__ import annotations

__all__ = ["main"]


def main() -> None:
    """Run the command line and leave with its exit code."""
    from tominpmp.cli.signals import end_at_once, take

    take(end_at_once)
    import sys

    from tominpmp.cli.app import run

    sys.exit(run(sys.argv[1:]))
