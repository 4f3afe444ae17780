"""The command line: ``tominpmp``, or ``python -m tominpmp``.

:mod:`~tominpmp.cli.app` has the commands and :mod:`~tominpmp.cli.options` what can be
said to them. To show help or refuse an option, nothing is imported that takes long: the
robotics libraries are when a command runs.
"""

from __future__ import annotations

from tominpmp.cli.app import app, main

__all__ = ["app", "main"]
