"""Motions on the way, kept by whoever may have to do with less than the last one."""

from __future__ import annotations

from collections.abc import Callable

from tominpmp.solvers.iterate import Iterate
from tominpmp.transcription.base import Program

Keep = Callable[[Program, Iterate], None]


def keep_nothing(program: Program, iterate: Iterate) -> None:
    """Let a motion on the way go."""
