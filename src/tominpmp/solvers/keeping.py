"""Keeping the motions of a solver while it runs, as it may be stopped at any time."""

from __future__ import annotations

from collections.abc import Callable

from tominpmp.solvers.iterate import Iterate
from tominpmp.transcription.base import Program

Keep = Callable[[Program, Iterate], None]


def keep_nothing(program: Program, iterate: Iterate) -> None:
    """Let a motion on the way go."""
