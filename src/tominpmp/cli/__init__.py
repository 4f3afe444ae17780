"""The command line: ``tominpmp``, or ``python -m tominpmp``.

:mod:`~tominpmp.cli.app` has the commands and :mod:`~tominpmp.cli.options` what can be
said to them. To show help or refuse an option, nothing is imported that takes long: the
robotics libraries are when a command runs, and NumPy is not even for the list of the
commands, see :mod:`~tominpmp.cli.front`. Nothing at all is before signals are heeded:
who ends the program while it starts shall get its exit code, and no traceback.
"""

from __future__ import annotations

import os
import sys

TYPE_CHECKING = False  # typing takes long to import
if TYPE_CHECKING:
    from typing import Any

__all__ = ["app", "main"]


def main() -> None:
    """Run the command line and leave with its exit code."""
    from tominpmp.cli.signals import end_at_once, take

    take(end_at_once)
    from tominpmp.cli.front import LIGHT, front

    if sys.argv[1:] in LIGHT and "_TOMINPMP_COMPLETE" not in os.environ:
        front()(prog_name="tominpmp")
    else:
        from tominpmp.cli.app import main as run

        run()


def __getattr__(name: str) -> Any:
    """Import the commands when they are first asked for."""
    if name == "app":
        from importlib import import_module

        # A module of this name would take its place in this one.
        found = import_module("tominpmp.cli.app").app
        globals()["app"] = found
        return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
