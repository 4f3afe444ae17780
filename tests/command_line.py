"""Running the command line within a test."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass

from tominpmp.cli.app import run


@dataclass(frozen=True)
class Outcome:
    """Output of a command line, and its exit code."""

    exit_code: int
    stdout: str
    stderr: str

    @property
    def output(self) -> str:
        """Text on a terminal: standard output, then standard error."""
        return self.stdout + self.stderr


def invoke(words: Sequence[object]) -> Outcome:
    """Run a command line with the given words."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run([str(word) for word in words])
    return Outcome(code, out.getvalue(), err.getvalue())
