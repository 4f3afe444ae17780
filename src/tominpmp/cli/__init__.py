"""The command line: ``tominpmp``, or ``python -m tominpmp``.

Only :mod:`~tominpmp.cli.app`, :mod:`~tominpmp.cli.arguments` and
:mod:`~tominpmp.cli.terminal` are imported to show help or refuse an option. They import
nothing that takes long; the robotics libraries are imported when a command runs.
"""

from __future__ import annotations

from tominpmp.cli.app import app, main

__all__ = ["app", "main"]
